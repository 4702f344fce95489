"""Decisions about rows after a look: targets that are lost, and those that are found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from bayesnet_track.adapt.rule_columns import STATUSES, RuleColumns
from bayesnet_track.adapt.rule_inputs import GroupMeasures, Measures, RuleInputs
from bayesnet_track.adapt.rules import decide
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.rows.advancing import FilteredGaussians
from bayesnet_track.engine.rows.columns import GIVEN, Columns, Rows
from bayesnet_track.engine.rows.row_metrics import RowMeasures
from bayesnet_track.journal.net.net import Decision
from bayesnet_track.numerics.arrays import AREA, FIT, NATS, UD, Floats


@dataclass(frozen=True, eq=False)
class JudgedRows:
    """The second half of the frame of rows.

    Attributes:
        before: the rows before the frame.
        columns: what is known of them after it.
        measured: what was measured.
        decisions: those that are taken.
    """

    before: Rows
    columns: Columns
    measured: RowMeasures
    decisions: tuple[Decision, ...]

    def table(self, time: float, nets: Mapping[str, Any]) -> Rows:
        """The rows after the frame, with the live nets after its decisions."""
        return self.before.with_columns(self.columns, time).with_nets(nets)


def judge_rows(work: FrameWork, filtered: FilteredGaussians) -> JudgedRows:
    """The memory of the rules with one frame more, what was measured, and the decisions that are taken."""
    rows, updated, numbers = filtered.before, filtered.columns, filtered.numbers
    started, before, rule = work.engine.clock(), rows.columns, rows.rule
    plate, is_lost = rule.compiled.plate, before.is_lost
    measures = GroupMeasures(
        uds={rule.root: numbers[:, UD].copy()},
        areas=numbers[:, AREA].copy(),
        fits=numbers[:, FIT].copy(),
        agents=(rule.agent,),
        nats=numbers[:, NATS, None],
        of=partial(_measures_of, rows, updated, numbers),
    )
    now = RuleColumns(
        plate=plate,
        active=rule.active,
        statuses=is_lost * STATUSES.index("lost"),
        measures=measures,
        see=partial(_see, work, rows, updated, numbers),
        existence=None if rule.crowd is None else updated.existence,
    )
    made, memory = decide(now, before.memory)
    decisions = tuple(decision for of in made.values() for decision in of)
    if decisions:
        is_lost = is_lost.copy()
        is_lost[[*made]] = ~is_lost[[*made]]
    after = updated.changed(memory=memory, is_lost=is_lost)
    work.charge("measure", started)
    return JudgedRows(rows, after, RowMeasures(numbers, memory.levels_px2(rule.root, rule.active)), decisions)


def _measures_of(rows: Rows, after: Columns, numbers: Floats, row: int) -> Measures:
    """All that is measured of one target."""
    ud, fit, area = numbers[row, [UD, FIT, AREA]].tolist()
    silent = () if after.given[row] == GIVEN else (rows.rule.agent,)
    return Measures({rows.rule.root: ud}, {}, {}, {}, {}, fit, area, silent)


def _see(work: FrameWork, rows: Rows, after: Columns, numbers: Floats, row: int) -> RuleInputs:
    """Inputs of the rules of one target."""
    rule, target = rows.rule, rows.ids[row]
    existence = None if rule.crowd is None else float(after.existence[row])
    compiled, net = rule.compiled, work.net.targets[target]
    return RuleInputs(
        work.frame.index,
        target,
        compiled.plate,
        net,
        _measures_of(rows, after, numbers, row),
        compiled.costs_ms,
        compiled.adaptable,
        existence=existence,
    )
