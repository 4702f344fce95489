"""Whole nets at work elsewhere: the frame of targets that depend on no other one, in other processes.

A target's frame is a function of its state and the pictures, so that it may be computed anywhere. The engine
keeps every state; who works for it is told those that it does not hold already.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from bayesnet_track.engine.compiled import Engine
from bayesnet_track.engine.outside import Outside
from bayesnet_track.engine.state import TargetState
from bayesnet_track.engine.target import Concluded, conclude, weigh
from bayesnet_track.journal.net.net import Net
from bayesnet_track.observation.planes import FramePair, PlaneCache


@dataclass(frozen=True, eq=False)
class Advanced:
    """What one frame gave for one target, and how long its parts took.

    Attributes:
        done: its state, measurements and decisions.
        seconds: agent (or planes, belief, measure, learn) -> seconds.
    """

    done: Concluded
    seconds: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Elsewhere:
    """Targets that are advanced elsewhere.

    Attributes:
        targets: their ids.
        awaited: waits for what their frame gave; those that nobody advanced are missing.
    """

    targets: frozenset[str] = frozenset()
    awaited: Callable[[], Mapping[str, Advanced]] = dict


def send_off(
    engine: Engine, net: Net, targets: Mapping[str, TargetState], frames: FramePair, given: Outside
) -> Elsewhere:
    """Hand over the targets that the engine's crew takes: those for which nothing came from outside."""
    crew = engine.crew
    if crew is None:
        return Elsewhere()
    concerned = given.by_hand.keys() | {target for target, _, _ in given.absent.known}
    own = {
        target: state
        for target, state in targets.items()
        if net.targets[target].template in crew.plates and target not in concerned
    }
    return Elsewhere(frozenset(own), crew.start(net, own, frames)) if own else Elsewhere()


def advance(engine: Engine, net: Net, target: str, before: TargetState, cache: PlaneCache) -> Advanced:
    """One frame of a target that depends on no other, and for which nothing came from outside."""
    seconds: dict[str, float] = {}
    frame = cache.frames.current
    weighed = weigh(engine, net, before, target, frame, cache, seconds)
    return Advanced(conclude(engine, net, weighed, frame, cache, seconds), seconds)
