"""What is decided of rows after a look: who is lost, and who is found, by levels and streaks."""

from __future__ import annotations

import numpy as np

from bayesnet_track.adapt.measures import Measures
from bayesnet_track.adapt.memory import QUIET_MINIMUM
from bayesnet_track.adapt.situation import Situation
from bayesnet_track.adapt.status import judge_status
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.rows.columns import GIVEN, Columns, Rows
from bayesnet_track.engine.rows.row_metrics import RowMeasures
from bayesnet_track.journal.net.net import Decision
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.kernels.row_columns import AREA, FIT, NATS, UD
from bayesnet_track.numerics.records import changed


def judge_rows(
    work: FrameWork, rows: Rows, updated: Columns, numbers: Floats
) -> tuple[Columns, RowMeasures, list[Decision]]:
    """Baselines and streaks with one frame more, what was measured, and the decisions that are taken."""
    from bayesnet_track.numerics.kernels.judging_kernels import append_streaks, read_levels
    from bayesnet_track.numerics.kernels.row_kernels import append_medians

    started = work.engine.clock()
    rule, before = rows.rule, rows.columns
    ud = numbers[:, UD].copy()
    quiet, quiet_count, medians = append_medians(
        before.quiet, before.quiet_count, ud, ~before.is_lost, QUIET_MINIMUM
    )
    level, exists = rule.lost.above, rule.lost.existence_below
    if exists is None:
        scale = medians if level.kind == "ud_baseline" else numbers[:, AREA].copy()
        if level.kind == "ud_px2":
            scale = np.ones(len(ud))
        value, lost_value, unfit_value, looks_lost, looks_found = read_levels(
            ud, numbers[:, FIT].copy(), scale, float(level.settings), rule.lost.fit_below
        )
    else:
        value = lost_value = unfit_value = updated.existence
        looks_lost, looks_found = value < exists, value >= exists
    lost_count, lost_values, unfit_values = append_streaks(
        before.lost_count, before.lost_values, before.unfit_values, looks_lost, lost_value, unfit_value
    )
    found, found_values = before.found_count, before.found_values
    found_count, found_values, _ = append_streaks(
        found, found_values, found_values, looks_found, value, value
    )
    after = updated.changed(
        nats=before.nats + numbers[:, NATS],
        nat_frames=before.nat_frames + 1,
        quiet=quiet,
        quiet_count=quiet_count,
        lost_count=lost_count,
        lost_values=lost_values,
        unfit_values=unfit_values,
        found_count=found_count,
        found_values=found_values,
    )
    measured = RowMeasures(numbers, medians)
    count = np.where(before.is_lost, after.found_count, after.lost_count)
    turning = (count >= rule.lost.frames).nonzero()[0]
    decisions: list[Decision] = []
    counted = rows.with_columns(after, work.frame.time)
    for row in turning.tolist():
        decisions += _decide_status(work, rows, counted, measured, row)
    if len(turning):
        is_lost = before.is_lost.copy()
        is_lost[turning] = ~is_lost[turning]
        after = after.changed(is_lost=is_lost)
    work.charge("measure", started)
    return after, measured, decisions


def _decide_status(
    work: FrameWork, before: Rows, after: Rows, measured: RowMeasures, row: int
) -> list[Decision]:
    """The decision about a target's status, as `judge_status` takes it of one."""
    rule, target = before.rule, before.ids[row]
    ud, fit, area = (float(column[row]) for column in (measured.ud, measured.fit, measured.area))
    silent = () if after.columns.given[row] == GIVEN else (rule.agent,)
    measures = Measures({rule.root: ud}, {}, {}, {}, {}, fit, area, silent)
    now = Situation(
        work.frame.index,
        target,
        rule.compiled.plate,
        work.net.targets[target],
        measures,
        rule.compiled.costs_ms,
        rule.compiled.adaptable,
        existence=None if rule.crowd is None else float(after.columns.existence[row]),
    )
    decisions: list[Decision] = []
    judge_status(now, changed(before.streaks(row), quiet=after.quiet(row)), decisions)
    return decisions
