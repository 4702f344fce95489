"""Whole nets at work elsewhere: the frame of targets that depend on no other one, in other processes.

A target's frame is a function of its state and the pictures, so that it may be computed anywhere. The engine
keeps every state; who works for it is told those that it does not hold already.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from bayesnet_track.engine.filtering import filter_target
from bayesnet_track.engine.findings import TargetResult
from bayesnet_track.engine.finishing import finish_target
from bayesnet_track.engine.frame_metrics import Made
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.state import TargetState


@dataclass(frozen=True, eq=False)
class Advanced:
    """What one frame gave for one target, and how long its parts took.

    Attributes:
        done: its state, measurements and decisions.
        seconds: agent (or planes, belief, measure, learn) -> seconds.
    """

    done: TargetResult
    seconds: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Elsewhere:
    """Targets that are advanced elsewhere.

    Attributes:
        targets: their ids.
        collect: waits for what their frame gave; those that nobody advanced are missing.
    """

    targets: frozenset[str] = frozenset()
    collect: Callable[[], Mapping[str, Advanced]] = dict


def start_elsewhere(work: FrameWork, targets: Mapping[str, TargetState]) -> Elsewhere:
    """Hand over the targets that another executor takes: those for which nothing came from outside."""
    target_executor, net = work.engine.target_executor, work.net
    if target_executor is None:
        return Elsewhere()
    concerned = work.by_hand.keys() | {target for target, _, _ in work.availability.known}
    own = {
        target: state
        for target, state in targets.items()
        if net.targets[target].template in target_executor.plates and target not in concerned
    }
    return (
        Elsewhere(frozenset(own), target_executor.start(net, own, work.cache.frames)) if own else Elsewhere()
    )


def advance(work: FrameWork, target: str, before: TargetState) -> Advanced:
    """One frame of a target that depends on no other, and for which nothing came from outside."""
    own = replace(work, seconds={})
    done = finish_target(own, filter_target(own, target, before))
    made = replace(done, line=Made(done.line()), covariance=Made(done.covariance()), heard=Made(done.heard()))
    return Advanced(made, own.seconds)


def collect_elsewhere(
    work: FrameWork, elsewhere: Elsewhere, before: Mapping[str, TargetState]
) -> dict[str, TargetResult]:
    """What the frame gave for the targets at work elsewhere; those that nobody advanced are advanced here."""
    advanced = elsewhere.collect()
    results: dict[str, TargetResult] = {}
    for target in sorted(elsewhere.targets):
        one = advanced.get(target) or advance(work, target, before[target])
        results[target] = one.done
        for part, spent in one.seconds.items():
            work.seconds[part] = work.seconds.get(part, 0.0) + spent
    return results
