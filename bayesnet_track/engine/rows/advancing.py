"""One frame of all rows of a table: predict, share detections out, update, measure, judge.

What `association`, `filtering` and `finishing` do for a target at a time. Objects are made of decisions that
are taken; metrics are columns until somebody asks for a target's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.assign import assign_pairs
from bayesnet_track.adapt.association import NOBODY
from bayesnet_track.adapt.measures import Measures
from bayesnet_track.adapt.memory import QUIET_MINIMUM
from bayesnet_track.adapt.situation import Situation
from bayesnet_track.adapt.status import judge_status
from bayesnet_track.belief.motion.models import KinematicMotion, linear_gaussian
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.lifecycle.association import Associated
from bayesnet_track.engine.lifecycle.detecting import Found, look
from bayesnet_track.engine.outcome import Outcome, State
from bayesnet_track.engine.rows.columns import GIVEN, GIVEN_NONE, Columns, RowRecords, Rows, RowStates
from bayesnet_track.engine.rows.fitting import RowRule
from bayesnet_track.engine.rows.row_metrics import RowMeasures, RowMetrics
from bayesnet_track.engine.state import apply_decisions
from bayesnet_track.journal.net.net import Decision
from bayesnet_track.numerics.gaussian import ALONE, chi_square_quantile
from bayesnet_track.numerics.kernels.row_columns import AREA, FIT, HYPOTHESES, NATS, UD

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Predicted:
    """Where the targets are expected.

    Attributes:
        mean: (T, D).
        covariance: (T, D, D).
        image: (2,) width and height of the frame.
    """

    mean: Floats
    covariance: Floats
    image: Floats


def advance_rows(work: FrameWork, state: State, rows: Rows) -> tuple[Outcome, Associated]:
    """What the frame gives for all targets, and whose the detections are."""
    from bayesnet_track.numerics.kernels.row_kernels import update_rows

    rule, frame, before = rows.rule, work.frame, rows.columns
    started = work.engine.clock()
    predicted = predict_all(work, rows)
    found, history, failures = look(
        work,
        state.history,
        lambda names: predicted.mean[[rows.index[name] for name in names], :4],
        lambda plate: held_rows(rows, plate),
    )
    seen = found.get(rule.plate, Found(np.empty((0, 4)), np.empty(0)))
    owner = share_out(rule, predicted, seen)
    whose: list[str | None] = [None] * len(seen.boxes)
    is_given = owner != NOBODY
    for row in np.flatnonzero(is_given).tolist():
        whose[owner[row]] = rows.ids[row]
    own = np.zeros((len(rows.ids), 5))
    own[is_given, :4], own[is_given, 4] = seen.boxes[owner[is_given]], seen.scores[owner[is_given]]
    started = work.charge("life", started)

    variances = rule.association.variances(own[:, :4]) * rule.temperature
    variances[~is_given] = 1.0
    boxes = np.ascontiguousarray(own[:, :4])
    mean, covariance = predicted.mean, predicted.covariance
    numbers = update_rows(
        mean, covariance, boxes, is_given, variances, rule.floor, predicted.image, rule.counts, ALONE
    )
    work.charge("belief", started)

    updated = before.changed(
        mean=mean,
        covariance=covariance,
        size=numbers[:, HYPOTHESES].astype(np.int64),
        own=own,
        given=np.where(is_given, GIVEN, GIVEN_NONE),
    )
    after, measured, decisions = judge_rows(work, rows, updated, numbers)
    net = apply_decisions(work.net, decisions)
    table = rows.with_columns(after, frame.time).with_nets(net.targets)
    outcome = Outcome(
        replace(
            state,
            net=net,
            targets=RowStates(table),
            previous=frame,
            history=replace(state.history, records=RowRecords(table)),
        ),
        RowMetrics(table, measured, work.engine.streams, frame, before.is_lost),
        tuple(decisions),
        dict(zip(rows.ids, covariance, strict=True)),
        work.seconds,
    )
    owners = {rule.plate: tuple(whose)} if rule.plate in found else {}
    return outcome, Associated(found, owners, {}, history, failures)


def predict_all(work: FrameWork, rows: Rows) -> Predicted:
    """Every target's prediction."""
    from bayesnet_track.numerics.kernels.row_kernels import predict_rows

    image = np.array([work.frame.width, work.frame.height], dtype=np.float64)
    move, noise = _moves(rows.rule.motion, work.frame.time - rows.time)
    mean, covariance = predict_rows(rows.columns.mean, rows.columns.covariance, move, noise, image)
    return Predicted(mean, covariance, image)


@lru_cache(maxsize=64)
def _moves(motion: KinematicMotion, dt: float) -> tuple[Floats, Floats]:
    return linear_gaussian(motion, dt)


def held_rows(rows: Rows, plate: str) -> list[str]:
    """The targets of a plate that are not lost."""
    if plate != rows.rule.plate:
        return []
    return [
        target for target, is_lost in zip(rows.ids, rows.columns.is_lost.tolist(), strict=True) if not is_lost
    ]


def share_out(rule: RowRule, predicted: Predicted, seen: Found) -> Ints:
    """(T,) the detection of each target, or `NOBODY`; see `adapt.assign`."""
    from bayesnet_track.numerics.kernels.pair_kernels import gate_rows

    mean, covariance, boxes = predicted.mean, predicted.covariance, np.ascontiguousarray(seen.boxes)
    if not len(boxes):
        return np.full(len(mean), NOBODY, dtype=np.int64)
    variances = rule.association.variances(boxes)
    limit, min_overlap = chi_square_quantile(rule.association.gate, 4), rule.association.min_overlap
    reach = np.sqrt(limit * (covariance[:, 0, 0] + variances[:, 0].max())) * (1 + 1e-9)
    if min_overlap > 0.0:  # then they touch
        reach = np.minimum(reach, (mean[:, 2] + boxes[:, 2].max()) / 2)
    order = np.argsort(boxes[:, 0], kind="stable")
    places = boxes[order, 0]
    starts = np.searchsorted(places, mean[:, 0] - reach)
    ends = np.searchsorted(places, mean[:, 0] + reach, side="right")
    pairs = gate_rows(mean, covariance, boxes, variances, order, starts, ends, limit, min_overlap)
    return assign_pairs(*pairs, len(mean), len(boxes))


def judge_rows(
    work: FrameWork, rows: Rows, updated: Columns, numbers: Floats
) -> tuple[Columns, RowMeasures, list[Decision]]:
    """Baselines and streaks with one frame more, what was measured, and the decisions that are taken."""
    from bayesnet_track.numerics.kernels.row_kernels import append_medians

    started = work.engine.clock()
    rule, before = rows.rule, rows.columns
    ud, fit, area = numbers[:, UD].copy(), numbers[:, FIT], numbers[:, AREA]
    quiet, quiet_count, medians = append_medians(
        before.quiet, before.quiet_count, ud, ~before.is_lost, QUIET_MINIMUM
    )
    level = rule.lost.above
    scale = {"ud_px2": np.ones(len(ud)), "ud_box": area, "ud_baseline": medians}[level.kind]
    is_known = scale > 0.0  # not where the baseline is unknown
    value = np.where(is_known, ud / np.where(is_known, scale, 1.0), 0.0)
    is_wide, fits = is_known & (value > level.settings), fit >= rule.lost.fit_below
    looks_lost, looks_found = is_wide | ~fits, fits & ~is_wide
    after = updated.changed(
        nats=before.nats + numbers[:, NATS],
        nat_frames=before.nat_frames + 1,
        quiet=quiet,
        quiet_count=quiet_count,
        lost_count=np.where(looks_lost, before.lost_count + 1, 0),
        lost_values=_append(before.lost_values, np.where(fits, value, np.inf)),
        unfit_values=_append(before.unfit_values, np.where(is_wide, -np.inf, fit)),
        found_count=np.where(looks_found, before.found_count + 1, 0),
        found_values=_append(before.found_values, value),
    )
    measured = RowMeasures(numbers, medians)
    count = np.where(before.is_lost, after.found_count, after.lost_count)
    turning = (count >= rule.lost.frames).nonzero()[0]
    decisions: list[Decision] = []
    for row in turning.tolist():
        decisions += _decide_status(work, rows, rows.with_columns(after, work.frame.time), measured, row)
    if len(turning):
        is_lost = before.is_lost.copy()
        is_lost[turning] = ~is_lost[turning]
        after = after.changed(is_lost=is_lost)
    work.charge("measure", started)
    return after, measured, decisions


def _append(values: Floats, new: Floats) -> Floats:
    return np.concatenate([values[:, 1:], new[:, None]], axis=1)


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
    )
    decisions: list[Decision] = []
    judge_status(now, replace(before.memory(row), quiet=after.memory(row).quiet), decisions)
    return decisions
