"""The second half of the frame of many targets held by particles that do the usual, as arrays.

They are of a flat net whose rules judge nothing but the status, nothing is decided about them, and their
agents learn of several targets at once. What the next frame needs is found here; what describes a target is
found when its line is asked for. All others go one by one, to the same bytes (`finishing.finish_targets`).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

from bayesnet_track.adapt.measures import Measures
from bayesnet_track.adapt.memory import Memory
from bayesnet_track.adapt.plain_rules import has_plain_rules, remember_plainly
from bayesnet_track.adapt.situation import Situation, quiet_level
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.findings import Decided, Learnt, Measured, TargetResult, heard
from bayesnet_track.engine.frame_metrics import frame_metrics
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.learning import follow_all, plate_learns
from bayesnet_track.engine.summaries import Found, Summary
from bayesnet_track.inference.executor import Serial
from bayesnet_track.inference.guard import judge_nothing
from bayesnet_track.inference.learn import learning_rate
from bayesnet_track.inference.measure_rows import is_flat, is_plain, measure_rows
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import changed
from bayesnet_track.observation.cue import ANGLE, Reference


@dataclass(frozen=True, eq=False)
class Described:
    """The lines of a frame as they are made later.

    Attributes:
        work: the frame, without planes.
        spreads: target -> covariance of its belief.
        summaries: target -> its belief in a few numbers.
    """

    work: FrameWork
    spreads: Found[Floats]
    summaries: Found[Summary]


@dataclass(frozen=True, eq=False)
class _Finished:
    """What was found of one target; see `Measured`, `Decided` and `Learnt`."""

    filtered: Filtered
    state: Floats
    box: Floats
    measures: Callable[[], Measures]
    memory: Memory
    rate: float
    references: Mapping[str, Reference]

    def line(self, described: Described) -> FrameMetrics:
        """What is written down of it."""
        work, one, memory = described.work, self.filtered, self.memory
        plate, net, watched = (
            work.plate_of(one.target).plate,
            work.net.targets[one.target],
            one.before.watched,
        )
        measured = Measured(self.state, self.box, net, self.measures(), one.before.scored)
        decided = Decided((), memory, quiet_level(plate, net, memory, plate.root), _see_nothing)
        learnt = Learnt(self.references, watched, judge_nothing(watched), (), 0.0, self.rate)
        return frame_metrics(work, one, measured, decided, learnt, described.summaries[one.target])

    def result(self, described: Described, time: float) -> TargetResult:
        """The state for the next frame, at `time`, and what is found when it is asked for."""
        one = self.filtered
        after = changed(
            one.before, belief=one.step.posterior, references=self.references, memory=self.memory, time=time
        )
        line, spread = partial(self.line, described), partial(described.spreads.__getitem__, one.target)
        said = partial(heard, one.step, one.plan.active)
        return TargetResult(after, self.box, line, (), (), spread, said)


def _see_nothing() -> Situation:
    raise AssertionError("nothing was decided")


def finish_rows(
    work: FrameWork,
    filtered: Mapping[str, Filtered],
    states: Mapping[str, Floats],
    boxes: Mapping[str, Floats],
    described: Described,
) -> dict[str, TargetResult]:
    """What the frame gave for those of the targets that fit; `states` (D,) and `boxes` (4,) are estimates."""
    if work.by_hand or work.availability.known or not isinstance(work.engine.executor, Serial):
        return {}
    alike: dict[Hashable, list[Filtered]] = {}
    for one in filtered.values():
        if _fits(work, one):
            key = work.net.targets[one.target].template, one.plan.active, len(one.step.prior)
            alike.setdefault(key, []).append(one)
    found: dict[str, TargetResult] = {}
    for group in alike.values():
        if len(group) > 1:  # arrays of one row take longer
            for done in _finish(work, group, states, boxes):
                found[done.filtered.target] = done.result(described, work.frame.time)
    return found


def _fits(work: FrameWork, one: Filtered) -> bool:
    compiled, step, before = work.plate_of(one.target), one.step, one.before
    return (
        plate_is_plain(compiled)
        and is_plain(one.plan, step)
        and not work.net.targets[one.target].sampled
        and not (one.faults or one.missed or one.flaws or one.undefined or before.flawed)
        and not (step.reports or step.degenerate)
        and before.references.keys() == compiled.cues.keys()
    )


@lru_cache(maxsize=64)
def plate_is_plain(compiled: CompiledPlate) -> bool:
    """Whether all that the targets of a plate do after they were weighed can be done of many at once."""
    return (
        is_flat(compiled.plate)
        and has_plain_rules(compiled.plate)
        and plate_learns(compiled)
        and compiled.moving is None
        and compiled.modes is None
        and ANGLE not in compiled.motion.fields
    )


def _finish(
    work: FrameWork, group: Sequence[Filtered], states: Mapping[str, Floats], boxes: Mapping[str, Floats]
) -> list[_Finished]:
    """Those of targets of a plate about which nothing is decided; of none where an agent cannot learn."""
    started, compiled = work.engine.clock(), work.plate_of(group[0].target)
    plate, plan = compiled.plate, group[0].plan
    areas = [w * h for _, _, w, h in (boxes[one.target].tolist() for one in group)]
    measures = measure_rows(plate, plan, [one.step for one in group], areas)
    nets = [work.net.targets[one.target] for one in group]
    before = [one.before.memory for one in group]
    memories = remember_plainly(plate, nets, measures, before, [one.hidden for one in group])
    started = work.charge("measure", started)
    rule, known = plate.inference(plate.root).learn, zip(group, nets, memories, strict=True)
    plain = {k: (one, net, memory) for k, (one, net, memory) in enumerate(known) if memory is not None}
    rates = {}
    for k, (one, net, memory) in plain.items():
        quiet = quiet_level(plate, net, memory, plate.root)
        rate = learning_rate(rule, measures.uds[k], areas[k], quiet)
        rates[one.target] = rate * max(1.0 - 2.0 * one.hidden, 0.0)
    learnt = follow_all(
        work,
        {one.target: one.before.references for one, _, _ in plain.values()},
        boxes,
        {
            target: {agent: rate * largest for agent, largest in compiled.rate_max.items()}
            for target, rate in rates.items()
        },
    )
    work.charge("learn", started)
    if not learnt:
        return []
    return [
        _Finished(one, states[name], boxes[name], partial(measures.of, k), memory, rates[name], learnt[name])
        for k, (one, _, memory) in plain.items()
        if (name := one.target)
    ]
