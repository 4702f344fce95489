"""Second half of a frame: beliefs are measured, decided on, learnt from and described, in groups of targets.

Between the two halves (`filtering` and this one) the beliefs of several targets can be joined. Both are
functions of the targets' states and the frame; time is read for the timings only.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any

from bayesnet_track.belief.contract import Step
from bayesnet_track.belief.particles.belief import find_maps
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.groups import FilteredEach, LiveGroup
from bayesnet_track.engine.judging import JudgedGroup, judge_group
from bayesnet_track.engine.learning import LearntGroup, learn_group
from bayesnet_track.engine.metrics import (
    Heard,
    Measured,
    Summary,
    find_covariances,
    find_summaries,
    frame_metrics,
)
from bayesnet_track.engine.modes import with_modes
from bayesnet_track.engine.rows.filtered_rows import FilteredRows, Together
from bayesnet_track.engine.rows.particle_table import ParticleTable
from bayesnet_track.engine.scoring.outcome import ScoreOutcome
from bayesnet_track.engine.state import TargetState
from bayesnet_track.inference.executor import is_elsewhere
from bayesnet_track.inference.guard import changes
from bayesnet_track.inference.measure_rows import StepArrays
from bayesnet_track.journal.events.beliefs import DegenerateBelief
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.faults import FactorFlawed, FlawEnded, MotionFlawed
from bayesnet_track.journal.events.statuses import DistractorSeen
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net.net import Decision, apply_decisions
from bayesnet_track.journal.net.target_net import TargetNet
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import Found, changed
from bayesnet_track.observation.cue import Reference
from bayesnet_track.observation.planes import FramePair, PlaneCache


@dataclass(frozen=True, eq=False)
class FinishedGroup:
    """Outcome of a frame for the targets of a group.

    Attributes:
        work: the frame, without planes: lines may be asked for much later.
        judged: measures and decisions.
        learnt: what the agents learnt.
        summaries: target -> its belief in a few numbers.
        table: the targets of which columns say all that is known of them after the frame; None without any.
        singles: row -> its target, of all others.
    """

    work: FrameWork
    judged: JudgedGroup
    learnt: LearntGroup
    summaries: Mapping[str, Summary]
    table: ParticleTable | None
    singles: Mapping[int, str]

    @property
    def ids(self) -> Sequence[str]:
        """The targets."""
        return self.judged.filtered.ids

    @property
    def boxes(self) -> Floats:
        """(T, 4) estimates, centre boxes in px."""
        return self.judged.boxes

    def state(self, row: int) -> TargetState:
        """The state of one target after the frame, still with the plan that the frame began with."""
        judged, one = self.judged, self.judged.filtered.of(row)
        before, outcome, measures = one.before, judged.score(row), judged.measures
        ud_px2, area_px2 = float(measures.uds[one.plan.root][row]), float(measures.areas[row])
        baseline_px2, beside = judged.baselines_px2[row], self.learnt.beside.get(row)
        return TargetState(
            one.step.posterior,
            self._references(row) if beside is None else beside.references,
            judged.memory if len(judged.memory) == 1 else judged.memory.take([row]),
            before.plan,
            self.work.frame.time,
            before.watched if beside is None else beside.watched,
            one.predicted.after(ud_px2, area_px2, baseline_px2, judged.held(row)),
            outcome.scored,
            frozenset({*one.flaws, *one.undefined}),
            before.existence,
            before.started,
        )

    def _references(self, row: int) -> Mapping[str, Reference]:
        return {agent: of[row] for agent, of in self.learnt.references.items()}

    def decisions(self, row: int) -> tuple[Decision, ...]:
        """Decisions about one target, in order; they take effect on the next frame."""
        one, beside = self.judged.filtered.beside(row), self.learnt.beside.get(row)
        faults = () if one is None else one.faults
        by_hand = self.work.by_hand.get(self.ids[row], ())
        return (*faults, *by_hand, *(() if beside is None else beside.decisions))

    def events(self, row: int) -> tuple[Event, ...]:
        """Events of one target besides its decisions."""
        one, frame, target = self.judged.filtered.of(row), self.work.frame.index, self.ids[row]
        before, stepped, outcome = one.before, one.step, self.judged.score(row)
        mode = None if one.modes is None else one.modes.change(frame, target)
        events: list[Event] = [
            *one.predicted.events,
            *(() if mode is None else (mode,)),
            *(report(frame, target) for report in stepped.reports),
        ]
        events += _report_flaws(self.judged, row, frame)
        if stepped.degenerate is not None:
            events.append(DegenerateBelief(frame, target, stepped.degenerate))
        if outcome.distractor is not None and outcome.scored.doubt > 0 and not before.scored.doubt:
            events.append(_with_level(outcome.distractor, outcome))
        events += outcome.notices
        beside, rule = self.learnt.beside.get(row), self.judged.filtered.compiled.guard
        if beside is not None:
            events += changes(frame, target, before.watched, beside.watched, beside.judged, rule)
        return tuple(events)

    def line(self, row: int) -> FrameMetrics:
        """Line of metrics of one target."""
        judged, one, outcome = self.judged, self.judged.filtered.of(row), self.judged.score(row)
        measured = Measured(
            judged.boxes[row], judged.measures.of(row), outcome.scored, outcome.score, outcome.bound
        )
        learnt = self.learnt.rates[row], self.learnt.angle(row)
        baseline_px2, summary = judged.baselines_px2[row], self.summaries[one.target]
        line = frame_metrics(self.work, one, measured, baseline_px2, learnt, summary)
        return with_modes(line, one.modes, outcome.score is not None)

    def heard(self, row: int) -> Heard:
        """Answers of the agents of one target."""
        one = self.judged.filtered.of(row)
        return _heard(one.step, one.plan.active)


@dataclass(frozen=True, eq=False)
class Results:
    """Outcome of a frame for all targets, by groups.

    Attributes:
        groups: of targets that were finished together.
        order: all targets.
        covariances: target -> (D, D) of its belief.
    """

    groups: Sequence[FinishedGroup]
    order: Sequence[str]
    covariances: Mapping[str, Floats]

    @cached_property
    def places(self) -> Mapping[str, tuple[FinishedGroup, int]]:
        """Target -> its group, and its row there, in the order of the targets."""
        found = {target: (group, row) for group in self.groups for row, target in enumerate(group.ids)}
        return {target: found[target] for target in self.order}

    @property
    def singles(self) -> Mapping[str, tuple[FinishedGroup, int]]:
        """The same of the targets that are in no table."""
        found = {target: (group, row) for group in self.groups for row, target in group.singles.items()}
        return {target: found[target] for target in self.order if target in found} if found else {}

    @property
    def lines(self) -> list[Callable[[], FrameMetrics]]:
        """Makers of the lines, one a target."""
        return [partial(group.line, row) for group, row in self.places.values()]

    @property
    def boxes(self) -> dict[str, Floats]:
        """Target -> its box (4,)."""
        return {target: group.boxes[row] for target, (group, row) in self.places.items()}

    @property
    def heard(self) -> Mapping[str, Heard]:
        """Target -> what its agents said."""
        return Found(
            self.order,
            lambda: {target: group.heard(row) for target, (group, row) in self.places.items()},
        )


def finish_targets(work: FrameWork, filtered: Together) -> Results:
    """Measure the beliefs, decide what changes, let the agents learn, and describe them.

    One thing after the other for all targets: the code that a processor keeps at hand then serves them all.
    """
    started = work.engine.clock()
    groups = _groups_of(work, filtered)
    started = work.charge("belief", started)
    bare = changed(work, cache=PlaneCache(FramePair(work.frame, None)))
    covariances = find_covariances(filtered)
    summaries = find_summaries(bare, filtered, covariances)
    judged = [judge_group(work, group) for group in groups]
    started = work.charge("measure", started)
    learnt = [learn_group(work, group) for group in judged]
    work.charge("learn", started)
    done = [_finished(bare, group, found, summaries) for group, found in zip(judged, learnt, strict=True)]
    return Results(done, [*filtered], covariances)


def _finished(
    work: FrameWork, judged: JudgedGroup, learnt: LearntGroup, summaries: Mapping[str, Summary]
) -> FinishedGroup:
    filtered = judged.filtered
    kept: list[int] = []
    if isinstance(filtered, FilteredRows) and columns_say_all(filtered.compiled):
        kept = [row for row in range(len(judged.nets)) if row not in learnt.beside]
    if not kept:
        return FinishedGroup(work, judged, learnt, summaries, None, dict(enumerate(filtered.ids)))
    assert isinstance(filtered, FilteredRows)
    table = filtered.before.then(
        work.frame.time, filtered.clouds, learnt.references, judged.memory, work.net.targets
    )
    singles = {row: filtered.ids[row] for row in learnt.beside}
    return FinishedGroup(work, judged, learnt, summaries, table.take(kept) if singles else table, singles)


@lru_cache(maxsize=64)
def columns_say_all(compiled: CompiledPlate) -> bool:
    """True where belief, references and rule memory are a target's state while nothing is decided."""
    root = compiled.plate.inference(compiled.plate.root)
    return (
        root.score is None
        and compiled.guard is None
        and compiled.moving is None
        and compiled.modes is None
        and not any(is_elsewhere(cue) for cue in compiled.cues.values())
    )


def _with_level(seen: DistractorSeen, outcome: ScoreOutcome) -> DistractorSeen:
    """With the largest level that would not have raised this doubt: all of its frames count."""
    encounter = outcome.scored.encounter
    return seen if encounter is None else changed(seen, turning_nats=encounter.behind_nats)


def _report_flaws(judged: JudgedGroup, row: int, frame: int) -> list[Event]:
    """Events of expressions that begin to have no value in this frame, and of those that end to."""
    one = judged.filtered.of(row)
    target, before, after = one.target, one.before.flawed, {*one.flaws, *one.undefined}
    return [
        *(
            FactorFlawed(frame, target, factor, flaw.undefined, flaw.hypotheses, flaw.ignored)
            for factor, flaw in one.flaws.items()
            if factor not in before
        ),
        *(
            MotionFlawed(frame, target, part, undefined.states, undefined.asked)
            for part, undefined in one.undefined.items()
            if part not in before
        ),
        *(FlawEnded(frame, target, part) for part in sorted(before - after)),
    ]


def _heard(step: Step[Any], agents: frozenset[str]) -> Heard:
    """Answers of the active `agents` in a step, for the hypotheses that are still the belief's."""
    evidence = step.evidence
    is_aligned = isinstance(step.posterior, ParticleSet) and step.support is step.posterior
    messages = {name: evidence.messages[name] for name in evidence.messages if is_aligned and name in agents}
    measured = {
        name: one
        for name, one in evidence.gaussians.items()
        if name in agents and one.seen is None and not one.choices
    }
    return Heard(messages, measured)


# ------------------------------------------------------------------------------------ groups


def _groups_of(work: FrameWork, filtered: Together) -> list[LiveGroup]:
    """All targets of a frame; those that were filtered as arrays first, with their MAP states found."""
    groups: list[LiveGroup] = []
    others = [*filtered.others.values()]
    for group in filtered.groups:
        group.find_maps()
        fits = [row for row in range(len(group)) if _fits(work, group, row)]
        if len(fits) < len(group):
            others += [group[target] for row, target in enumerate(group.ids) if row not in fits]
            group = group.take(fits)
        if fits:
            groups.append(LiveGroup(group, [work.net.targets[target] for target in group.ids]))
    find_maps(one.step for one in others)
    alike: dict[Hashable, list[Filtered]] = {}
    nets: dict[str, TargetNet] = {}
    for one in others:
        nets[one.target] = net = _live_net(work, one)
        alike.setdefault(_key(one, net), []).append(one)
    for targets in alike.values():
        each = FilteredEach(work.plate_of(targets[0].target), targets)
        groups.append(LiveGroup(each, [nets[target] for target in each.ids]))
    return groups


def _fits(work: FrameWork, group: FilteredRows, row: int) -> bool:
    """True where columns hold all that is known of a target of an array."""
    table, target = group.before, group.ids[row]
    if target in work.by_hand:
        return False
    if row < len(table.nets):
        return True
    net, state = work.net.targets[target], table.base[row]
    is_usual = net.active == group.plan.active and not net.sampled and not state.flawed
    return is_usual and table.references.keys() == table.compiled.cues.keys() == state.references.keys()


def _live_net(work: FrameWork, filtered: Filtered) -> TargetNet:
    """The live net as a person switched it, without agents that failed or gave no answer."""
    by_hand = work.by_hand.get(filtered.target, ())
    if not filtered.faults and not by_hand:
        net = work.net.targets[filtered.target]
    else:
        net = apply_decisions(work.net, (*filtered.faults, *by_hand)).targets[filtered.target]
    out = filtered.missed.keys() | filtered.resting
    return changed(net, active=net.active - out) if out else net


def _key(filtered: Filtered, net: TargetNet) -> Hashable:
    """Equal for targets that make columns together."""
    step, before = filtered.step, filtered.before
    hiding = filtered.modes is None or filtered.modes.hiding is None
    known = before.existence is None, hiding, bool(step.evidence.latent), (*before.references,)
    return net.template, net.active, StepArrays.key(filtered.plan, step), known
