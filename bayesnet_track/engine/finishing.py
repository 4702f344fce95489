"""Second half of a frame: beliefs are measured, decided on, learnt from and described, in groups of targets.

Between the two halves (`filtering` and this one) the beliefs of several targets can be joined. Both are
functions of the targets' states and the frame; time is read for the timings only.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import chain
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.rule_columns import STATUSES
from bayesnet_track.belief.particles.belief import find_map_states
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.groups import AgentMessages, FilteredEach, FilteredGroup, LiveGroup
from bayesnet_track.engine.judging import JudgedGroup, judge_group
from bayesnet_track.engine.learning import LearntGroup, learn_group
from bayesnet_track.engine.lines import Lines
from bayesnet_track.engine.metrics import (
    BeliefSummary,
    Measured,
    find_covariances,
    frame_metrics,
    summarise,
)
from bayesnet_track.engine.modes import with_modes
from bayesnet_track.engine.rows.advancing import FilteredGaussians
from bayesnet_track.engine.rows.columns import Rows
from bayesnet_track.engine.rows.filtered_rows import FilteredRows, FilteredTargets
from bayesnet_track.engine.scoring.outcome import ScoreOutcome
from bayesnet_track.engine.state import TargetState
from bayesnet_track.engine.targets import ParticleTable
from bayesnet_track.inference.learn import changes
from bayesnet_track.inference.measure import StepArrays
from bayesnet_track.journal.events.beliefs import DegenerateBelief
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.faults import FactorFlawed, FlawEnded, MotionFlawed
from bayesnet_track.journal.events.statuses import DistractorSeen
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net import Decision, apply_decisions
from bayesnet_track.journal.target_net import TargetNet
from bayesnet_track.numerics.arrays import Bools, Floats
from bayesnet_track.numerics.records import LazyRecords, evolve
from bayesnet_track.observation.cue import Reference
from bayesnet_track.observation.planes import FramePair, PlaneCache, read_only

NO_IMAGE = read_only(np.zeros((0, 0, 3), dtype=np.uint8))

Table = TypeVar("Table", covariant=True)


@dataclass(frozen=True, eq=False)
class FinishedGroup(Generic[Table]):
    """Outcome of a frame for the targets of a group.

    Attributes:
        work: the frame, without image and planes: lines may be asked for much later.
        filtered: the first half of the frame.
        judged: measures and decisions.
        learnt: what the agents learnt.
        singles: row -> target, of those that are an object each after the frame.
        summaries: (whether with hypotheses) -> target -> its belief in a few numbers.
    """

    work: FrameContext
    filtered: FilteredGroup[Table]
    judged: JudgedGroup
    learnt: LearntGroup
    singles: Mapping[int, str]
    summaries: Callable[[bool], Mapping[str, BeliefSummary]]

    @property
    def ids(self) -> Sequence[str]:
        """The targets."""
        return self.filtered.ids

    @property
    def boxes(self) -> Floats:
        """(T, 4) estimates, centre boxes in px."""
        return self.judged.boxes

    @property
    def is_lost(self) -> Bools:
        """(T,) whether the status was lost in the frame."""
        return np.asarray(self.judged.statuses == STATUSES.index("lost"))

    @property
    def holds_frame(self) -> bool:
        """True where the frame and its planes are held."""
        return self.filtered.holds_frame

    def table(self, nets: Mapping[str, TargetNet]) -> Table | None:
        """The targets of which columns say all that is known of them after the frame; None without any."""
        decided = self.judged.chosen.keys() | self.learnt.beside.keys()
        time, memory = self.work.frame.time, self.judged.memory
        return self.filtered.then(time, self.learnt.references, memory, decided, nets)

    @property
    def decided(self) -> tuple[Decision, ...]:
        """Decisions about the targets of the table, in order."""
        if not (self.filtered.keeps_status and (self.judged.chosen or self.learnt.beside)):
            return ()
        return tuple(chain(*(self._decided_on(row) for row in self._rows_decided_on())))

    def _rows_decided_on(self) -> Sequence[int]:
        return sorted(self.judged.chosen.keys() | self.learnt.beside.keys())

    def _decided_on(self, row: int) -> tuple[Decision, ...]:
        """Decisions about one target that stand."""
        beside = self.learnt.beside.get(row)
        return self.judged.chosen.get(row, ()) if beside is None else beside.decisions

    @property
    def table_events(self) -> tuple[Event, ...]:
        """Events of the targets of the table, with their decisions, in order."""
        reports = self.filtered.reports(self.work.frame.index)
        if not reports:
            return self.decided
        rows = sorted({*reports, *self._rows_decided_on()})
        return tuple(chain(*((*reports.get(row, ()), *self._decided_on(row)) for row in rows)))

    def state(self, row: int) -> TargetState:
        """The state of one target after the frame, still with the plan that the frame began with."""
        judged, filtered = self.judged, self.judged.filtered.of(row)
        previous, outcome, measures = filtered.before, judged.score(row), judged.measures
        ud_px2, area_px2 = float(measures.uds[filtered.plan.root][row]), float(measures.areas[row])
        baseline_px2, beside = judged.baselines_px2[row], self.learnt.beside.get(row)
        return TargetState(
            filtered.step.posterior,
            self._references(row) if beside is None else beside.references,
            judged.memory if len(judged.memory) == 1 else judged.memory.take([row]),
            previous.plan,
            self.work.frame.time,
            previous.watched if beside is None else beside.watched,
            filtered.predicted.after(ud_px2, area_px2, baseline_px2, judged.held(row)),
            outcome.scored,
            frozenset({*filtered.flaws, *filtered.undefined}),
            previous.existence,
            previous.started,
        )

    def _references(self, row: int) -> Mapping[str, Reference]:
        return {agent: rows[row] for agent, rows in self.learnt.references.items()}

    def decisions(self, row: int) -> tuple[Decision, ...]:
        """Decisions about one target, in order; they take effect on the next frame."""
        filtered, beside = self.judged.filtered.beside, self.learnt.beside.get(row)
        faults = () if filtered is None else filtered[row].faults
        by_hand = self.work.by_hand.get(self.ids[row], ())
        return (*faults, *by_hand, *(() if beside is None else beside.decisions))

    def events(self, row: int) -> tuple[Event, ...]:
        """Events of one target besides its decisions."""
        filtered, frame, target = self.judged.filtered.of(row), self.work.frame.index, self.ids[row]
        previous, stepped, outcome = filtered.before, filtered.step, self.judged.score(row)
        events: list[Event] = [
            *filtered.predicted.events,
            *(() if filtered.modes is None else filtered.modes.changes(frame, target)),
            *(report(frame, target) for report in stepped.reports),
        ]
        events += _report_flaws(self.judged, row, frame)
        if stepped.degenerate is not None:
            events.append(DegenerateBelief(frame, target, stepped.degenerate))
        if outcome.distractor is not None and outcome.scored.doubt > 0 and not previous.scored.doubt:
            events.append(_with_level(outcome.distractor, outcome))
        events += outcome.notices
        beside, rule = self.learnt.beside.get(row), self.judged.filtered.compiled.guard
        if beside is not None:
            events += changes(frame, target, previous.watched, beside.watched, beside.judged, rule)
        return tuple(events)

    def lines(self, hypotheses: bool) -> list[FrameMetrics]:
        """Lines of metrics of all; without `hypotheses` those may be left out."""
        summaries = self.summaries(hypotheses)
        return [self._line(row, summaries[target]) for row, target in enumerate(self.ids)]

    def _line(self, row: int, summary: BeliefSummary) -> FrameMetrics:
        judged, outcome, existence = self.judged, self.judged.score(row), self.filtered.existence
        measured = Measured(
            judged.boxes[row],
            judged.measures.of(row),
            outcome.scored,
            outcome.score,
            outcome.bound,
            None if existence is None else float(existence[row]),
        )
        learnt = self.learnt.rates[row], self.learnt.angle(row)
        line = frame_metrics(self.work, self.ids[row], measured, judged.baselines_px2[row], learnt, summary)
        beside = self.filtered.beside
        modes = None if beside is None else beside[row].modes
        return with_modes(line, modes, outcome.score is not None)

    def columns(self) -> Mapping[str, NDArray[Any]] | None:
        """The columns of their lines without hypotheses; None where lines have to be made."""
        judged = self.judged
        return self.filtered.line_columns(
            self.work, judged.boxes, self.is_lost, judged.levels_px2, self.learnt.rates
        )


@dataclass(frozen=True, eq=False)
class Results:
    """Outcome of a frame for all targets, by groups.

    Attributes:
        gaussians: of tables of Gaussian beliefs, one a plate.
        groups: of other targets that were finished together.
        others: the targets of these.
        find_covariances: () -> target -> (D, D) of its belief.
    """

    gaussians: Sequence[FinishedGroup[Rows]] = ()
    groups: Sequence[FinishedGroup[ParticleTable]] = ()
    others: Sequence[str] = ()
    find_covariances: Callable[[], Mapping[str, Floats]] = dict

    @cached_property
    def order(self) -> Sequence[str]:
        """All targets."""
        if not self.gaussians:
            return self.others
        ids = [group.ids for group in self.gaussians]
        return ids[0] if len(ids) == 1 and not self.others else [*chain(*ids, self.others)]

    @property
    def singles(self) -> Mapping[str, tuple[FinishedGroup[ParticleTable], int]]:
        """Target -> its group, and its row there, of those that are in no table."""
        places = {target: (group, row) for group in self.groups for row, target in group.singles.items()}
        return {target: places[target] for target in self.others if target in places} if places else {}

    @property
    def lines(self) -> Lines:
        """Lines of metrics."""
        return Lines((*self.gaussians, *self.groups), self.order)

    @property
    def covariances(self) -> Mapping[str, Floats]:
        """Target -> (D, D) covariance of its belief."""
        return LazyRecords(self.order, self.find_covariances)

    @property
    def heard(self) -> Mapping[str, AgentMessages]:
        """Target -> what its agents said."""
        return LazyRecords(self.order, self._find_heard)

    def _find_heard(self) -> dict[str, AgentMessages]:
        groups: Iterable[FinishedGroup[Any]] = (*self.gaussians, *self.groups)
        return {target: group.filtered.heard(row) for group in groups for row, target in enumerate(group.ids)}


def finish_targets(
    work: FrameContext, filtered: FilteredTargets, gaussians: Sequence[FilteredGaussians] = ()
) -> Results:
    """Measure the beliefs, decide what changes, let the agents learn, and describe them.

    One thing after the other for all targets: the code that a processor keeps at hand then serves them all.
    """
    start, objects = work.engine.clock(), [*filtered] if len(filtered) else []
    groups = [LiveGroup(rows, rows.nets(work.net.targets)) for rows in gaussians]
    if objects:
        groups += _groups_of(work, filtered)
        start = work.charge("belief", start)
    judged = [judge_group(work, group) for group in groups]
    start = work.charge("measure", start)
    learnt = [learn_group(work, group) for group in judged]
    work.charge("learn", start)
    bare = evolve(work, cache=PlaneCache(FramePair(evolve(work.frame, image=NO_IMAGE, depth=None), None)))
    tables = [
        FinishedGroup(
            bare, rows_of_table, judged_group, learnt_group, {}, partial(rows_of_table.summaries, bare)
        )
        for rows_of_table, judged_group, learnt_group in zip(gaussians, judged, learnt, strict=False)
    ]
    results = Results(tables, (), objects, partial(_covariances, gaussians, filtered))
    if not objects:
        return results
    summaries = LazyRecords(objects, partial(summarise, bare, filtered, results.covariances))
    count = len(gaussians)
    finished = [
        FinishedGroup(
            bare,
            judged_group.filtered,
            judged_group,
            learnt_group,
            judged_group.filtered.apart(learnt_group.beside),
            lambda hypotheses: summaries,
        )
        for judged_group, learnt_group in zip(judged[count:], learnt[count:], strict=True)
    ]
    return evolve(results, groups=finished)


def _covariances(gaussians: Sequence[FilteredGaussians], filtered: FilteredTargets) -> dict[str, Floats]:
    """Target -> (D, D) covariance of its belief."""
    rows = (zip(group.ids, group.columns.covariance, strict=True) for group in gaussians)
    return {**dict(chain(*rows)), **find_covariances(filtered)}


def _with_level(event: DistractorSeen, outcome: ScoreOutcome) -> DistractorSeen:
    """With the largest level that would not have raised this doubt: all of its frames count."""
    encounter = outcome.scored.encounter
    return event if encounter is None else evolve(event, turning_nats=encounter.behind_nats)


def _report_flaws(judged: JudgedGroup, row: int, frame: int) -> list[Event]:
    """Events of expressions that begin to have no value in this frame, and of those that end to."""
    filtered = judged.filtered.of(row)
    target, previous, current = (
        filtered.target,
        filtered.before.flawed,
        {*filtered.flaws, *filtered.undefined},
    )
    return [
        *(
            FactorFlawed(frame, target, factor, flaw.undefined, flaw.hypotheses, flaw.ignored)
            for factor, flaw in filtered.flaws.items()
            if factor not in previous
        ),
        *(
            MotionFlawed(frame, target, part, undefined.states, undefined.asked)
            for part, undefined in filtered.undefined.items()
            if part not in previous
        ),
        *(FlawEnded(frame, target, part) for part in sorted(previous - current)),
    ]


# ------------------------------------------------------------------------------------ groups


def _groups_of(work: FrameContext, filtered: FilteredTargets) -> list[LiveGroup]:
    """All targets of a frame; those that were filtered as arrays first, with their MAP states found."""
    groups: list[LiveGroup] = []
    objects = [*filtered.others.values()]
    for group in filtered.groups:
        group.find_maps()
        if work.by_hand or len(group.before.nets) < len(group):  # else all were rows before
            fits = [row for row in range(len(group)) if _fits(work, group, row)]
            if len(fits) < len(group):
                objects += [group[target] for row, target in enumerate(group.ids) if row not in fits]
                group = group.take(fits)
        if len(group):
            groups.append(LiveGroup(group, [work.net.targets[target] for target in group.ids]))
    return groups + _groups_of_each(work, objects) if objects else groups


def _groups_of_each(work: FrameContext, objects: Sequence[Filtered]) -> list[LiveGroup]:
    """Targets that no array holds, with their MAP states found."""
    groups: list[LiveGroup] = []
    find_map_states(target.step for target in objects)
    by_key: dict[Hashable, list[Filtered]] = {}
    nets: dict[str, TargetNet] = {}
    for target_step in objects:
        nets[target_step.target] = net = _live_net(work, target_step)
        by_key.setdefault(_key(target_step, net), []).append(target_step)
    for targets in by_key.values():
        each = FilteredEach(work.plate_of(targets[0].target), targets)
        groups.append(LiveGroup(each, [nets[target] for target in each.ids]))
    return groups


def _fits(work: FrameContext, group: FilteredRows, row: int) -> bool:
    """True where columns hold all that is known of a target of an array."""
    table, target = group.before, group.ids[row]
    if target in work.by_hand:
        return False
    if row < len(table.nets):
        return True
    net, state = work.net.targets[target], table.base[row]
    is_usual = net.active == group.plan.active and not net.sampled and not state.flawed
    return is_usual and table.references.keys() == table.compiled.cues.keys() == state.references.keys()


def _live_net(work: FrameContext, filtered: Filtered) -> TargetNet:
    """The live net as a person switched it, without agents that failed or gave no answer."""
    by_hand = work.by_hand.get(filtered.target, ())
    if not filtered.faults and not by_hand:
        net = work.net.targets[filtered.target]
    else:
        net = apply_decisions(work.net, (*filtered.faults, *by_hand)).targets[filtered.target]
    absent = filtered.missed.keys() | filtered.resting
    return evolve(net, active=net.active - absent) if absent else net


def _key(filtered: Filtered, net: TargetNet) -> Hashable:
    """Equal for targets that make columns together."""
    step, previous = filtered.step, filtered.before
    hiding = filtered.modes is None or filtered.modes.hiding is None
    kinds = previous.existence is None, hiding, bool(step.evidence.latent), (*previous.references,)
    return net.template, net.active, StepArrays.key(filtered.plan, step), kinds
