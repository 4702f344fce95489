"""Unconfirmed tracks, which may exist and are no targets yet: begun, moved, updated, confirmed or dropped."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bayesnet_track.adapt.existence import DetectionModel, Pairs, Shared, UnconfirmedTracks
from bayesnet_track.adapt.lifecycle import FOLLOW_BOX, Candidate
from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.gaussian.belief import predict
from bayesnet_track.belief.motion.borders import confined
from bayesnet_track.belief.motion.models import KinematicMotion, linear_gaussian
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.lifecycle.detecting import Found
from bayesnet_track.engine.lifecycle.initiating import fast_covariance, is_moving, velocity
from bayesnet_track.graph.settings.lifecycle import Existence
from bayesnet_track.graph.spec import Gaussian
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import chi_square_quantile
from bayesnet_track.numerics.records import evolve
from bayesnet_track.numerics.streams import birth_key
from bayesnet_track.observation.cue import AssociationRule
from bayesnet_track.observation.planes import Frame

HOPELESS = 0.02
"""A prospect is dropped when it exists with less than this share of a new one's probability."""

LEAST_FREE = 0.2
"""A detection that is free with less probability starts no prospect."""

FAST_SHARE = 0.1
"""Prior probability that a new target is faster than the graph's start velocities say."""

PROSPECTS = 4
"""Unconfirmed tracks that are kept, in multiples of `birth.max_targets`."""


@dataclass(frozen=True, eq=False)
class CrowdRule:
    """What a plate says of existence and association.

    Attributes:
        association: which detections may be a target's, and how far off they are.
        existence: the settings.
        is_marginal: whether targets use all detections that may be theirs, or those assigned to them.
        motion: how targets move.
        most: unconfirmed tracks that are kept.
    """

    association: AssociationRule
    existence: Existence
    is_marginal: bool
    motion: MotionModel
    most: int

    @classmethod
    def of(cls, compiled: CompiledPlate) -> CrowdRule | None:
        """That of a plate; None where it has no existence."""
        life = compiled.lifecycle
        if life is None or life.existence is None or life.birth is None or not compiled.association_rules:
            return None
        association = next(iter(compiled.association_rules.values()))
        is_marginal = compiled.plate.spec.associate == "marginal"
        most = max(PROSPECTS * life.birth.max_targets, 32)
        return cls(association, life.existence, is_marginal, compiled.moments, most)


def first_population(rule: CrowdRule, found: Found, frame: Frame) -> DetectionModel:
    """That of a first frame, in which free detections were `found`."""
    detection_model = DetectionModel(UnconfirmedTracks.none(len(rule.motion.fields))).with_sizes(found.boxes)
    free = np.ones(len(found.boxes))
    detection_model = detection_model.after_look(
        float(free.sum()) * (1.0 - detection_model.new_share(rule.existence))
    )
    return evolve(detection_model, unconfirmed=begin_unconfirmed(rule, detection_model, found, free, frame))


def confirmed(
    rule: CrowdRule, unconfirmed: UnconfirmedTracks, plate: str, time: float
) -> dict[int, Candidate]:
    """Rows of a plate's unconfirmed tracks that exist probably enough at `time`, the most probable first."""
    ready = np.flatnonzero(unconfirmed.existence >= rule.existence.confirm)
    ready = ready[np.argsort(-unconfirmed.existence[ready], kind="stable")]
    return {row: _candidate(rule.motion, unconfirmed, row, plate, time) for row in ready.tolist()}


def _candidate(
    motion: MotionModel, unconfirmed: UnconfirmedTracks, row: int, plate: str, time: float
) -> Candidate:
    seen, looks = max(int(unconfirmed.seen[row]), 1), max(int(unconfirmed.looks[row]), 1)
    mean, born = unconfirmed.mean[row], float(unconfirmed.born[row])
    first = mean[:4].copy()
    first[:2] -= velocity(motion, mean) * (time - born)
    scores = (float(unconfirmed.score[row]) / seen,) * seen
    return Candidate(
        mean[:4],
        np.zeros(2),
        ((None,) * max(looks - seen, 0) + scores),
        int(unconfirmed.first[row]),
        birth_key(born, plate, int(unconfirmed.number[row])),
        mean,
        unconfirmed.covariance[row],
        float(unconfirmed.existence[row]),
        track=((born, first),),
    )


def predict_unconfirmed(
    unconfirmed: UnconfirmedTracks, motion: MotionModel, dt: float, size: tuple[int, int]
) -> UnconfirmedTracks:
    """The unconfirmed tracks as they are expected after `dt` frame intervals; `size` is that of the image."""
    if not len(unconfirmed):
        return unconfirmed
    if isinstance(motion, KinematicMotion) and (linear := _moves(motion, dt)) is not None:
        from bayesnet_track.numerics.kernels.row_kernels import predict_rows

        mean, covariance = predict_rows(
            unconfirmed.mean, unconfirmed.covariance, *linear, np.array(size, float)
        )
    else:
        moves = confined(motion, *size)
        several = [
            predict(mean, covariance, moves, dt, Gaussian(filter="extended"))
            for mean, covariance in zip(unconfirmed.mean, unconfirmed.covariance, strict=True)
        ]
        mean, covariance = np.array([one[0] for one in several]), np.array([one[1] for one in several])
    return evolve(unconfirmed, mean=mean, covariance=covariance)


@lru_cache(maxsize=64)
def _moves(motion: KinematicMotion, dt: float) -> tuple[Floats, Floats] | None:
    """F and Q of a motion that is linear with noise in px; else None."""
    try:
        return linear_gaussian(motion, dt)
    except ValueError:
        return None


def with_fast(
    rule: CrowdRule, before: UnconfirmedTracks, expected: UnconfirmedTracks, boxes: Floats, dt: float
) -> UnconfirmedTracks:
    """Second hypotheses of tracks seen once: faster than the graph's start velocities say.

    A track has one if none of the detections (N, 4) is inside its gate where it is `expected`, and one is
    within `FOLLOW_BOX` of its sides a frame interval of where it was `before`: its velocity is known by that
    reach only, and it is as much less probable as `FAST_SHARE` says. All others would have none of a chance.
    """
    motion = rule.motion
    once = np.flatnonzero(before.looks == 1)
    if not len(once) or not len(boxes) or not is_moving(motion):
        return before.take(np.empty(0, np.int64))
    sides = np.sqrt(before.mean[once, 2] * before.mean[once, 3])
    away = boxes[None, :, :2] - before.mean[once, None, :2]
    is_reached = np.hypot(away[..., 0], away[..., 1]) <= (FOLLOW_BOX * dt * sides)[:, None]
    spread = expected.covariance[once][:, (0, 1), (0, 1)][:, None] + rule.association.variances(boxes)[:, :2]
    away = boxes[None, :, :2] - expected.mean[once, None, :2]
    is_near = (away**2 / spread).sum(axis=2) <= chi_square_quantile(rule.association.gate, 4)
    fast = before.take(once[is_reached.any(axis=1) & ~is_near.any(axis=1)])
    covariance = [fast_covariance(motion, *one) for one in zip(fast.covariance, fast.mean, strict=True)]
    return evolve(
        fast,
        covariance=np.array(covariance).reshape(fast.covariance.shape),
        existence=FAST_SHARE * fast.existence,
    )


def advance_unconfirmed(
    rule: CrowdRule, unconfirmed: UnconfirmedTracks, pairs: Pairs, shared: Shared, found: Found
) -> UnconfirmedTracks:
    """The unconfirmed tracks after the look."""
    from bayesnet_track.numerics.kernels.pair_kernels import mix_rows

    if not len(unconfirmed):
        return unconfirmed
    first = len(shared.existence) - len(unconfirmed)
    own = pairs.rows >= first
    rows, columns, weights = pairs.rows[own] - first, pairs.columns[own], pairs.values[own]
    starts = np.searchsorted(rows, np.arange(len(unconfirmed) + 1))
    mean, covariance = unconfirmed.mean.copy(), unconfirmed.covariance.copy()
    boxes = np.ascontiguousarray(found.boxes[columns])
    missed = np.clip(1.0 - np.bincount(rows, weights, minlength=len(unconfirmed)), 0.0, 1.0)
    mix_rows(mean, covariance, starts, boxes, rule.association.variances(boxes), weights, missed)
    is_seen = shared.seen[first:] >= 0.5
    scores = np.bincount(rows, weights * found.scores[columns], minlength=len(unconfirmed))
    return UnconfirmedTracks(
        mean,
        covariance,
        shared.existence[first:],
        unconfirmed.first,
        unconfirmed.born,
        unconfirmed.number,
        unconfirmed.seen + is_seen,
        unconfirmed.looks + 1,
        unconfirmed.score + np.where(is_seen, scores, 0.0),
    )


def begin_unconfirmed(
    rule: CrowdRule, detection_model: DetectionModel, found: Found, free: Floats, frame: Frame
) -> UnconfirmedTracks:
    """A prospect for each detection that may be nobody's, as far as it is `free` (N,)."""
    new = np.flatnonzero(free >= LEAST_FREE)
    count, boxes = len(new), found.boxes[new]
    if not count:
        return UnconfirmedTracks.none(len(rule.motion.fields))
    mean, covariance = _start_moments(rule.motion, boxes)
    diagonal = np.arange(4)
    covariance[:, diagonal, diagonal] += rule.association.variances(boxes)
    ones = np.ones(count, dtype=np.int64)
    return UnconfirmedTracks(
        mean,
        covariance,
        free[new] * detection_model.new_share(rule.existence),
        frame.index * ones,
        np.full(count, frame.time),
        found.numbers[new],
        ones,
        ones,
        found.scores[new].astype(np.float64),
    )


def _start_moments(motion: MotionModel, boxes: Floats) -> tuple[Floats, Floats]:
    """(N, D) means and (N, D, D) covariances of targets first seen in boxes (N, 4), at least one."""
    if isinstance(motion, KinematicMotion):  # every box the same but for its place and size
        mean, spread = motion.start_moments(boxes[0])
        means = np.tile(mean, (len(boxes), 1))
        means[:, :4] = boxes
        return means, np.tile(spread, (len(boxes), 1, 1))
    moments = [motion.start_moments(box) for box in boxes]
    return np.array([mean for mean, _ in moments]), np.array([spread for _, spread in moments])


def prune(
    rule: CrowdRule, detection_model: DetectionModel, unconfirmed: UnconfirmedTracks
) -> UnconfirmedTracks:
    """Those that may still become targets, the most probable."""
    kept = np.flatnonzero(unconfirmed.existence >= HOPELESS * detection_model.new_share(rule.existence))
    if len(kept) > rule.most:
        best = np.argsort(-unconfirmed.existence[kept], kind="stable")[: rule.most]
        kept = np.sort(kept[best])
    return unconfirmed.take(kept)
