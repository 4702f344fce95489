"""One frame of all rows of a table: predict, share detections out, update, measure, judge.

What `association`, `filtering` and `finishing` do for a target at a time. Objects are made of decisions that
are taken; metrics are columns until somebody asks for a target's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.association import (
    NOBODY,
    Owners,
    Pass,
    assign_pairs,
    share_by_overlap,
    share_in_passes,
)
from bayesnet_track.adapt.existence import Population
from bayesnet_track.adapt.lifecycle import Candidate
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.engine.frame_metrics import WhenAsked
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.lifecycle.assigning import advance_tentative, name_owners, tentative_tracks
from bayesnet_track.engine.lifecycle.association import Associated
from bayesnet_track.engine.lifecycle.detecting import Found, look
from bayesnet_track.engine.lifecycle.existing import Crowd, divide, gate
from bayesnet_track.engine.lifecycle.sharing import Predict, Tracks, follow, own_detections
from bayesnet_track.engine.outcome import Outcome, State
from bayesnet_track.engine.rows.columns import GIVEN, GIVEN_NONE, RowRecords, Rows, RowStates
from bayesnet_track.engine.rows.fitting import RowRule
from bayesnet_track.engine.rows.judging import judge_rows
from bayesnet_track.engine.rows.row_heard import RowHeard
from bayesnet_track.engine.rows.row_metrics import RowMetrics
from bayesnet_track.journal.net.net import apply_decisions
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import ALONE
from bayesnet_track.numerics.kernels.row_columns import HYPOTHESES
from bayesnet_track.numerics.records import changed


@dataclass(frozen=True, eq=False)
class Predicted:
    """Where the targets are expected.

    Attributes:
        mean: (T, D).
        covariance: (T, D, D).
        image: (2,) width and height that they are confined to.
    """

    mean: Floats
    covariance: Floats
    image: Floats


@dataclass(frozen=True, eq=False)
class Given:
    """What T rows are given of a look's N detections.

    Attributes:
        whose: (N,) the target that each detection is given to.
        own: (T, 5) the detection of each, and its score.
        is_given: (T,) whether there is one that may be its own.
        numbers: (T, 8) what was measured, in the columns of `numerics.kernels.row_columns`.
        existence: (T,) probability that each exists.
        observed: (T, H) what is remembered of the detections of each.
        population: what was learnt of all detections, where targets exist with a probability.
        candidates: the tentative tracks after the frame; None where there were none.
    """

    whose: tuple[str | None, ...]
    own: Floats
    is_given: NDArray[np.bool_]
    numbers: Floats
    existence: Floats
    observed: Floats
    population: Population | None = None
    candidates: tuple[Candidate, ...] | None = None


def advance_rows(work: FrameWork, state: State, rows: Rows) -> tuple[Outcome, Associated]:
    """What the frame gives for all targets, and whose the detections are."""
    rule, frame, before = rows.rule, work.frame, rows.columns
    predicted = predict_all(work, rows)
    found, history, failures = look(
        work,
        state.history,
        lambda names: predicted.mean[[rows.index[name] for name in names], :4],
        lambda plate: held_rows(rows, plate),
    )
    if rule.crowd is None:
        waiting = tentative_tracks(rule.compiled, history)
        given = assign_rows(work, rows, predicted, waiting, found.get(rule.plate))
        if given.candidates is not None:
            history = changed(history, candidates={**history.candidates, rule.plate: given.candidates})
    else:
        population = history.populations.get(rule.plate)
        given = divide_rows(work, rows, predicted, population, found.get(rule.plate))
        assert given.population is not None
        history = changed(history, populations={**history.populations, rule.plate: given.population})
    mean, covariance = predicted.mean, predicted.covariance

    updated = before.changed(
        mean=mean,
        covariance=covariance,
        size=given.numbers[:, HYPOTHESES].astype(np.int64),
        own=given.own,
        given=np.where(given.is_given, GIVEN, GIVEN_NONE),
        existence=given.existence,
        observed=given.observed,
    )
    after, measured, decisions = judge_rows(work, rows, updated, given.numbers)
    net = apply_decisions(work.net, decisions)
    table = rows.with_columns(after, frame.time).with_nets(net.targets)
    outcome = Outcome(
        changed(
            state,
            net=net,
            targets=RowStates(table),
            previous=frame,
            history=changed(state.history, records=RowRecords(table)),
        ),
        RowMetrics(table, measured, work, before.is_lost),
        tuple(decisions),
        WhenAsked(rows.ids, lambda target: covariance[rows.index[target]]),
        work.seconds,
        heard=RowHeard(table),
    )
    owners = {rule.plate: given.whose} if rule.plate in found else {}
    return outcome, Associated(found, owners, {}, history, failures)


def assign_rows(
    work: FrameWork, rows: Rows, predicted: Predicted, waiting: Sequence[Candidate], found: Found | None
) -> Given:
    """The best assignment, and the rows updated in place by what each is assigned.

    Tentative tracks, those `waiting`, take part in it, and are updated, too.
    """
    from bayesnet_track.numerics.kernels.row_kernels import update_rows

    rule, started, live = rows.rule, work.engine.clock(), slice(len(rows.ids))
    seen = Found.none() if found is None else found
    now, predict = rows.columns, predictor(work, rows)
    before = Tracks(now.mean, now.covariance, now.observed).and_tentative(waiting)
    expected = Tracks(predicted.mean, predicted.covariance, before.observed)
    if waiting:
        expected = Tracks(*predict(before.mean, before.covariance), before.observed)
    owner = share_out(rule, expected, seen)
    own = own_detections(owner, seen.boxes, seen.scores)
    followed, _ = follow(rule.association, before, expected, owner, own, predict)
    left = advance_tentative(rule.compiled, waiting, followed, own, found is not None) if waiting else None
    if waiting:
        predicted.mean[:], predicted.covariance[:] = followed.mean[live], followed.covariance[live]
    own, is_given = own[live], owner[live] != NOBODY
    started = work.charge("life", started)
    variances = rule.association.variances(own[:, :4]) * rule.temperature
    variances[~is_given] = 1.0
    boxes = np.ascontiguousarray(own[:, :4])
    mean, covariance = predicted.mean, predicted.covariance
    numbers = update_rows(
        mean, covariance, boxes, is_given, variances, rule.floor, predicted.image, rule.counts, ALONE
    )
    work.charge("belief", started)
    whose = name_owners(owner, rows.ids, len(seen.boxes))
    return Given(whose, own, is_given, numbers, now.existence, followed.observed[live], candidates=left)


def divide_rows(
    work: FrameWork, rows: Rows, predicted: Predicted, population: Population | None, found: Found | None
) -> Given:
    """What is shared by probability, and the rows updated in place by the mixtures."""
    from bayesnet_track.numerics.kernels.mixing_kernels import measure_and_mix_rows

    rule, started = rows.rule, work.engine.clock()
    assert rule.crowd is not None
    mean, covariance = predicted.mean, predicted.covariance
    crowd = Crowd(
        np.ascontiguousarray(mean[:, :4]),
        np.ascontiguousarray(covariance[:, :4, :4]),
        rows.columns.existence,
        rows.ids,
    )
    done = divide(rule.crowd, work.cache.frames, crowd, population, found)
    started = work.charge("life", started)
    seen = Found.none() if found is None else found
    boxes = np.ascontiguousarray(seen.boxes[done.columns])
    numbers = measure_and_mix_rows(
        mean,
        covariance,
        done.starts,
        boxes,
        rule.association.variances(boxes) * rule.temperature,
        done.weights,
        done.missed,
        rule.floor,
        predicted.image,
        rule.counts,
        ALONE,
    )
    work.charge("belief", started)
    is_given = np.diff(done.starts) > 0
    whose = name_owners(done.owner, rows.ids, len(seen.boxes))
    own = own_detections(done.owner, seen.boxes, seen.scores)
    return Given(
        whose, own, is_given, numbers, done.existence, rows.columns.observed, population=done.population
    )


def predict_all(work: FrameWork, rows: Rows) -> Predicted:
    """Every target's prediction."""
    mean, covariance = predictor(work, rows)(rows.columns.mean, rows.columns.covariance)
    return Predicted(mean, covariance, image_of(work, rows.rule))


def predictor(work: FrameWork, rows: Rows) -> Predict:
    """The prediction of beliefs from the last frame to this one."""
    from bayesnet_track.numerics.kernels.row_kernels import predict_rows

    image = image_of(work, rows.rule)
    return Predict(
        work.frame.time - rows.time,
        lambda mean, covariance, dt: predict_rows(mean, covariance, *_moves(rows.rule, dt), image),
    )


def image_of(work: FrameWork, rule: RowRule) -> Floats:
    """(2,) width and height that targets are confined to."""
    return _extent(rule, work.frame.width, work.frame.height)


# Rules are told apart by identity: to hash a motion takes as long as to predict a crowd.
@lru_cache(maxsize=64)
def _extent(rule: RowRule, width: int, height: int) -> Floats:
    return Confined(rule.motion, width, height).extent


@lru_cache(maxsize=64)
def _moves(rule: RowRule, dt: float) -> tuple[Floats, Floats]:
    return rule.motion.linearise(np.ones(len(rule.motion.fields)), dt)


def held_rows(rows: Rows, plate: str) -> list[str]:
    """The targets of a plate that are not lost."""
    if plate != rows.rule.plate:
        return []
    return [
        target for target, is_lost in zip(rows.ids, rows.columns.is_lost.tolist(), strict=True) if not is_lost
    ]


def share_out(rule: RowRule, expected: Tracks, seen: Found) -> Owners:
    """(T,) the detection of each target, or `NOBODY`; see `adapt.association` and `adapt.association`."""
    mean, covariance, boxes = expected.mean, expected.covariance, np.ascontiguousarray(seen.boxes)
    if rule.association.similarity == "iou":
        return share_by_overlap(rule.association, mean[:, :4], expected.observed, boxes, seen.scores)
    if rule.association.first_score <= 0.0:
        return _share_by_density(rule, mean, covariance, boxes)

    def ask(by: Pass, left: Owners, columns: Owners) -> Owners:
        return _share_by_density(rule, mean[left], covariance[left], boxes[columns])

    return share_in_passes(rule.association, seen.scores, len(mean), ask)


def _share_by_density(rule: RowRule, mean: Floats, covariance: Floats, boxes: Floats) -> Owners:
    pairs = gate(rule.association, mean, covariance, boxes)
    return assign_pairs(pairs.rows, pairs.columns, pairs.values, len(mean), len(boxes))
