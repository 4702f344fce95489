"""The second half of the frame of many targets held by particles that do the usual, as arrays.

They are of a flat net whose rules judge nothing but the status, and nothing is decided about them. What the
next frame needs is found here; what describes a target is found when its line is asked for. All others go one
by one, to the same bytes (`finishing.finish_targets`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from bayesnet_track.adapt.memory import USUAL, RuleMemory
from bayesnet_track.adapt.rule_columns import RuleColumns, remember
from bayesnet_track.adapt.rule_inputs import Situation
from bayesnet_track.belief.contract import estimate
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.findings import Heard, Learnt, Measured, TargetResult, heard
from bayesnet_track.engine.frame_metrics import frame_metrics
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.learning import plate_learns
from bayesnet_track.engine.rows.filtered_rows import FilteredRows
from bayesnet_track.engine.rows.particle_table import ParticleTable
from bayesnet_track.engine.rows.row_learning import follow_rows
from bayesnet_track.engine.state import inside_frame_all
from bayesnet_track.engine.summaries import Summary
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.inference.guard import judge_nothing
from bayesnet_track.inference.learn import frames_between, learning_rate
from bayesnet_track.inference.measure_rows import RowMeasures, is_flat, measure_rows
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import Found
from bayesnet_track.observation.cue import ANGLE


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
class FinishedRows(Mapping[str, TargetResult]):
    """What the frame gave for targets about which nothing is decided: each made when it is asked for.

    Attributes:
        group: the first half of their frame.
        after: what is known of them from now on.
        states: (T, D) estimates.
        boxes: (T, 4) their centre boxes.
        measures: what was measured.
        rates: shares of the largest learning rate.
        described: their lines as they are made later.
        rows: target -> its row; without those about which something may be decided.
    """

    group: FilteredRows
    after: ParticleTable
    states: Floats
    boxes: Floats
    measures: RowMeasures
    rates: Sequence[float]
    described: Described
    rows: Mapping[str, int]

    @property
    def table(self) -> ParticleTable:
        """The targets from now on."""
        is_whole = len(self.rows) == len(self.after.ids)
        return self.after if is_whole else self.after.take(list(self.rows.values()))

    def line(self, row: int) -> FrameMetrics:
        """What is written down of one."""
        work, one, after = self.described.work, self.group[self.after.ids[row]], self.after.state(row)
        assert self.after.memories is not None
        net, watched = work.net.targets[one.target], one.before.watched
        measured = Measured(self.states[row], self.boxes[row], net, self.measures.of(row), one.before.scored)
        active = self.group.plan.active
        level = _levels(self.after.memories, self.after.compiled.plate, active)[row]
        learnt = Learnt(after.references, watched, judge_nothing(watched), (), 0.0, self.rates[row])
        return frame_metrics(work, one, measured, level, learnt, self.described.summaries[one.target])

    def heard(self, row: int) -> Heard:
        """What its agents said."""
        one = self.group[self.after.ids[row]]
        return heard(one.step, one.plan.active)

    def __getitem__(self, target: str) -> TargetResult:
        row = self.rows[target]
        spread = partial(self.described.spreads.__getitem__, target)
        line, said = partial(self.line, row), partial(self.heard, row)
        return TargetResult(self.after.state(row), self.boxes[row], line, (), (), spread, said)

    def __iter__(self) -> Iterator[str]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)


class Results(Mapping[str, TargetResult]):
    """What the frame gave for all targets: those that were finished together, and others.

    Args:
        groups: targets about which nothing is decided.
        others: target -> what it gave.
        order: all targets.
    """

    def __init__(
        self, groups: Sequence[FinishedRows], others: Mapping[str, TargetResult], order: Sequence[str]
    ) -> None:
        self.groups, self.others, self.order = groups, others, order
        self._group: dict[str, FinishedRows] = {}
        for group in groups:
            self._group |= dict.fromkeys(group.rows, group)

    def __getitem__(self, target: str) -> TargetResult:
        return self._group.get(target, self.others)[target]

    def __iter__(self) -> Iterator[str]:
        return iter(self.order)

    def __len__(self) -> int:
        return len(self.order)

    @property
    def lines(self) -> list[Callable[[], FrameMetrics]]:
        """What makes the line of each."""
        known = self._group
        return [
            partial(known[target].line, known[target].rows[target])
            if target in known
            else self.others[target].line
            for target in self.order
        ]

    @property
    def boxes(self) -> dict[str, Floats]:
        """Target -> its box (4,)."""
        known = self._group
        return {
            target: known[target].boxes[known[target].rows[target]]
            if target in known
            else self.others[target].box
            for target in self.order
        }


def _levels(memory: RuleMemory, plate: CheckedTarget, active: frozenset[str]) -> list[float | None]:
    """The baseline of each target's UD, px^2; None while unknown."""
    levels = memory.levels_px2(plate.root, plate.below[plate.root] & active).tolist()
    return [None if level != level else level for level in levels]


def _see_nothing(row: int) -> Situation:
    raise AssertionError("what is to be decided is decided of each target by itself")


def finish_rows(work: FrameWork, group: FilteredRows, described: Described) -> FinishedRows | None:
    """What the frame gave for those of the targets that fit; None where none do."""
    if work.by_hand or work.availability.known:
        return None
    plan = group.plan
    if plan.draws or group.messages.keys() != plan.active or not plate_is_plain(group.before.compiled):
        return None
    held = len(group.before.nets)
    rows = [row for row in range(len(group)) if row < held or _fits(work, group, row)]
    if not rows:
        return None
    return _finish(work, group if len(rows) == len(group) else group.take(rows), described)


def _fits(work: FrameWork, group: FilteredRows, row: int) -> bool:
    table = group.before
    net, state = work.net.targets[table.ids[row]], table.base[row]
    return (
        net.status == "tracking"
        and len(net.active) > 0
        and net.active == group.plan.active
        and not (net.quarantined or net.sampled)
        and not state.flawed
        and table.references.keys() == table.compiled.cues.keys() == state.references.keys()
    )


@lru_cache(maxsize=64)
def plate_is_plain(compiled: CompiledPlate) -> bool:
    """Whether all that the targets of a plate do after they were weighed can be done of many at once."""
    return (
        is_flat(compiled.plate)
        and _has_plain_rules(compiled.plate)
        and plate_learns(compiled)
        and compiled.moving is None
        and compiled.modes is None
        and ANGLE not in compiled.motion.fields
    )


def _has_plain_rules(plate: CheckedTarget) -> bool:
    """Whether all that a plate's rules decide, while its agents work, is its status by UD and fit."""
    root = plate.inference(plate.root)
    return (
        root.score is None
        and (root.lost or USUAL).existence_below is None
        and len(plate.children) == 1
        and root.adapt is None
        and all(plate.agent(agent).self_check is None for agent in plate.agents)
    )


def _finish(work: FrameWork, group: FilteredRows, described: Described) -> FinishedRows | None:
    """Those about which nothing is decided; None where there are none, or an agent cannot learn."""
    started, table, plan = work.engine.clock(), group.before, group.plan
    plate = table.compiled.plate
    states = estimate_rows(work, group)
    boxes = inside_frame_all(states[:, :4], work.frame)
    areas = (boxes[:, 2] * boxes[:, 3]).tolist()
    measures, hidden = measure_rows(plate, plan, group.arrays, areas), group.hidden
    seen = RuleColumns(
        plate,
        plan.active,
        np.zeros(len(areas), dtype=np.int64),
        {plate.root: np.array(measures.uds)},
        np.array(areas),
        np.array(measures.fits),
        measures.agents,
        measures.nats,
        _see_nothing,
        np.array(hidden),
    )
    memories, is_due = remember(seen, table.columns())
    levels, stays = _levels(memories, plate, plan.active), ~is_due
    started = work.charge("measure", started)
    rule = plate.inference(plate.root).learn
    rests = work.frame.ordinal % frames_between(rule, {}) > 0
    rates = [
        learning_rate(rule, ud, area, level) * max(1.0 - 2.0 * share, 0.0) if stay and not rests else 0.0
        for ud, area, share, stay, level in zip(
            measures.uds, areas, hidden, stays.tolist(), levels, strict=True
        )
    ]
    references, failed = follow_rows(work, table, boxes, rates)
    work.charge("learn", started)
    stays[list(failed)] = False
    if not stays.any():
        return None
    after = table.then(work.frame.time, group.clouds, references, memories, work.net.targets)
    rows = after.index if stays.all() else {table.ids[row]: row for row in np.flatnonzero(stays).tolist()}
    return FinishedRows(group, after, states, boxes, measures, rates, described, rows)


def estimate_rows(work: FrameWork, group: FilteredRows) -> Floats:
    """(T, D) the states that stand for the beliefs."""
    plate = group.before.compiled.plate
    chosen = plate.inference(plate.root).estimate
    if chosen is None or chosen.kind == "map":
        return group.best
    return np.array([estimate(chosen, group[target].step) for target in group.ids])
