"""Unconfirmed tracks, which may exist and are no targets yet: begun, moved, updated, confirmed or dropped.

With them is the first belief of a target from all detections of its candidate.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bayesnet_track.adapt.existence import Begins, DetectionModel, Pairs, Shared, UnconfirmedTracks
from bayesnet_track.adapt.lifecycle import FOLLOW_BOX, Candidate
from bayesnet_track.adapt.presence import Presence
from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.gaussian.belief import predict
from bayesnet_track.belief.motion.borders import confined
from bayesnet_track.belief.motion.models import KinematicMotion, linear_moves
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.lifecycle.sensing import Found, Mixed, Sensor
from bayesnet_track.graph.settings.lifecycle import Existence
from bayesnet_track.graph.spec import Gaussian
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import plain
from bayesnet_track.numerics.gaussian import chi_square_quantile
from bayesnet_track.numerics.records import evolve
from bayesnet_track.numerics.streams import birth_key
from bayesnet_track.observation.cue import AssociationRule
from bayesnet_track.observation.planes import Frame, for_reading

HOPELESS = 0.02
"""A prospect is dropped when it exists with less than this share of a new one's probability."""

LEAST_FREE = 0.2
"""A detection that is free with less probability starts no prospect."""

FAST_SHARE = 0.1
"""Prior probability that a new target is faster than the graph's start velocities say."""

LASTING = 0.05
"""A lasting false alarm of so much probability is kept, so that its detections are no births."""

PRESENT = 0.9
"""Targets detected in a first frame for each false detection, up to one: they are there, and not new."""

PROSPECTS = 4
"""Unconfirmed tracks that are kept, in multiples of `birth.max_targets`."""


@dataclass(frozen=True, eq=False)
class CrowdRule:
    """Settings of a plate for existence and association.

    Attributes:
        sensor: how detections measure targets, and which may be a target's.
        existence: the settings.
        is_marginal: whether targets use all detections that may be theirs, or those assigned to them.
        motion: how targets move.
        most: unconfirmed tracks that are kept.
        is_first: whether the sensor is the plate's first.
        camera: whose image detections are in; "" where there is one image.
    """

    sensor: Sensor
    existence: Existence
    is_marginal: bool
    motion: MotionModel
    most: int
    is_first: bool = True
    camera: str = ""

    @classmethod
    def of(cls, compiled: CompiledPlate, agent: str | None = None) -> CrowdRule | None:
        """Rule of a plate, by its first sensor unless it is named; None where it has no existence."""
        life = compiled.lifecycle
        if life is None or life.existence is None or life.birth is None or not compiled.sensors:
            return None
        first = next(iter(compiled.sensors))
        agent = agent or first
        is_marginal = compiled.plate.spec.associate == "marginal"
        max_tracks = max(PROSPECTS * life.birth.max_targets, 32)
        sensor, camera = compiled.sensors[agent], compiled.cameras[agent]
        return cls(sensor, life.existence, is_marginal, compiled.moments, max_tracks, agent == first, camera)


def first_population(rule: CrowdRule, detections: Found, frame: Frame) -> DetectionModel:
    """The detection model after a first frame with these free detections."""
    detection_model = rule.sensor.learn(
        DetectionModel(UnconfirmedTracks.none(len(rule.motion.fields))), detections
    )
    free, settings = np.ones(len(detections.values)), rule.existence
    present = max(settings.births, PRESENT * min(detection_model.clutter_rate(settings), 1.0))
    first_settings = settings.model_copy(update={"births": present})
    if_all_false = detection_model.after_look(float(len(free)))
    begins = if_all_false.begin(first_settings, np.zeros(len(free)), 1.0)
    detection_model = detection_model.after_look(float(free @ (1.0 - begins.target)))
    return evolve(detection_model, unconfirmed=begin_unconfirmed(rule, begins, detections, free, frame))


def confirmed(
    rule: CrowdRule, unconfirmed: UnconfirmedTracks, plate: str, time: float
) -> dict[int, Candidate]:
    """Rows of a plate's unconfirmed tracks that exist probably enough at `time`, the most probable first."""
    ready = np.flatnonzero(unconfirmed.existence >= rule.existence.confirm)
    ready = ready[np.argsort(-unconfirmed.existence[ready], kind="stable")]
    return {row: _candidate(rule, unconfirmed, row, plate, time) for row in ready.tolist()}


def _candidate(
    rule: CrowdRule, unconfirmed: UnconfirmedTracks, row: int, plate: str, time: float
) -> Candidate:
    label_rule = rule.sensor.association.label
    sightings, looks = max(int(unconfirmed.seen[row]), 1), max(int(unconfirmed.looks[row]), 1)
    mean, born = unconfirmed.mean[row], float(unconfirmed.born[row])
    first = mean.copy()
    first[:2] -= velocities(rule.motion, mean[None])[0] * (time - born)
    box, first_box = rule.sensor.boxes(np.array([mean, first]))
    scores = (float(unconfirmed.score[row]) / sightings,) * sightings
    return Candidate(
        box,
        np.zeros(2),
        ((None,) * max(looks - sightings, 0) + scores),
        int(unconfirmed.first[row]),
        birth_key(born, plate, int(unconfirmed.number[row])),
        mean,
        unconfirmed.covariance[row],
        float(unconfirmed.existence[row]),
        track=((born, first_box),),
        labels=None if label_rule is None else np.log(unconfirmed.values[row]) - np.log(label_rule.prior),
    )


def predict_unconfirmed(
    unconfirmed: UnconfirmedTracks, motion: MotionModel, dt: float, size: tuple[int, int]
) -> UnconfirmedTracks:
    """The unconfirmed tracks as they are expected after `dt` frame intervals; `size` is that of the image."""
    if not len(unconfirmed):
        return unconfirmed
    if isinstance(motion, KinematicMotion) and (linear := linear_moves(motion, dt)) is not None:
        from bayesnet_track.numerics.kernels.row_kernels import predict_rows

        image = confined(motion, *size).extent
        mean, covariance = predict_rows(unconfirmed.mean, unconfirmed.covariance, *linear, image)
    else:
        moves = confined(motion, *size)
        moments = [
            predict(mean, covariance, moves, dt, Gaussian(filter="extended"))
            for mean, covariance in zip(unconfirmed.mean, unconfirmed.covariance, strict=True)
        ]
        mean, covariance = (
            np.array([moment[0] for moment in moments]),
            np.array([moment[1] for moment in moments]),
        )
    return evolve(unconfirmed, mean=mean, covariance=covariance)


def with_fast(
    rule: CrowdRule, previous: UnconfirmedTracks, expected: UnconfirmedTracks, boxes: Floats, dt: float
) -> UnconfirmedTracks:
    """Second hypotheses of tracks seen once: faster than the graph's start velocities say.

    A track has one if none of the detections (N, 4) is inside its gate where it is `expected`, and only
    one is within `FOLLOW_BOX` of its sides a frame interval of its place in `previous`, and near no other
    such track. Its velocity is known by that reach only; it is as much less probable as `FAST_SHARE` says.
    """
    motion, once = rule.motion, np.flatnonzero(previous.looks == 1)
    if not len(once) or not len(boxes) or not _is_moving(motion):
        return previous.take(np.empty(0, np.int64))
    means, places = previous.mean[once], boxes[:, :2].T[:, None]
    x, y = places - means.T[:2, :, None]
    reach = FOLLOW_BOX * dt * np.sqrt(means[:, 2] * means[:, 3])
    is_reached = x * x + y * y <= (reach * reach)[:, None]
    is_reached &= (is_reached.sum(axis=1) == 1)[:, None] & (is_reached.sum(axis=0) == 1)
    rows, columns = np.nonzero(is_reached)
    once, followers = once[rows], boxes[columns]
    spread = (
        expected.covariance[once][:, (0, 1), (0, 1)] + rule.sensor.association.variances(followers)[:, :2]
    )
    d2 = ((followers[:, :2] - expected.mean[once, :2]) ** 2 / spread).sum(axis=1)
    fast = previous.take(once[d2 > chi_square_quantile(rule.sensor.association.gate, 4)])
    covariance = _fast_covariance(motion, fast.covariance, fast.mean)
    presence = Presence.sure(len(fast))  # a false alarm that lasts does not move so fast
    return evolve(fast, covariance=covariance, existence=FAST_SHARE * fast.existence, presence=presence)


def advance_unconfirmed(
    rule: CrowdRule, unconfirmed: UnconfirmedTracks, pairs: Pairs, shared: Shared, detections: Found
) -> UnconfirmedTracks:
    """The unconfirmed tracks after the look."""
    if not len(unconfirmed):
        return unconfirmed
    first = len(shared.existence) - len(unconfirmed)
    is_track = pairs.rows >= first
    rows, columns = pairs.rows[is_track] - first, pairs.columns[is_track]
    weights = pairs.values[is_track]
    starts = np.searchsorted(rows, np.arange(len(unconfirmed) + 1))
    mean, covariance = unconfirmed.mean.copy(), unconfirmed.covariance.copy()
    missed = np.clip(1.0 - np.bincount(rows, weights, minlength=len(unconfirmed)), 0.0, 1.0)
    rule.sensor.mix(mean, covariance, detections, Mixed(starts, columns, weights, missed))
    is_seen = shared.seen[first:] >= 0.5
    scores = np.bincount(rows, weights * detections.scores[columns], minlength=len(unconfirmed))
    values = unconfirmed.values
    if (rule_of_labels := rule.sensor.association.label) is not None:
        likelihoods = np.exp(rule_of_labels.log(detections.labels))[columns]
        values = np.array(
            [
                rule_of_labels.learnt(prior, likelihoods[low:high], weights[low:high], float(missed[row]))
                for row, (prior, low, high) in enumerate(zip(values, starts[:-1], starts[1:], strict=True))
            ]
        )
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
        values,
        unconfirmed.presence,
    )


def begin_unconfirmed(
    rule: CrowdRule, begins: Begins, detections: Found, free: Floats, frame: Frame
) -> UnconfirmedTracks:
    """A prospect for each detection that may be nobody's, as far as it is `free` (N,)."""
    indices = np.flatnonzero(free >= LEAST_FREE)
    if not len(indices):
        return UnconfirmedTracks.none(len(rule.motion.fields))
    start = rule.sensor.begin(rule.motion, detections.only(indices))
    indices, count = indices[start.which], len(start.which)
    ones, begun = np.ones(count, dtype=np.int64), free[indices]
    lasting = {"spot": begun * begins.spot[indices], "double": begun * begins.double[indices]}
    presence = evolve(Presence.sure(count), **lasting, begun=begun, near=begins.near[indices])
    return UnconfirmedTracks(
        start.mean,
        start.covariance,
        begun * begins.target[indices],
        frame.index * ones,
        np.full(count, frame.time),
        detections.numbers[indices],
        ones,
        ones,
        detections.scores[indices].astype(np.float64),
        first_values(rule, detections)[indices],
        presence,
    )


def first_values(rule: CrowdRule, detections: Found) -> Floats:
    """(N, V) probabilities of what something is of which each detection is the first."""
    label_rule = rule.sensor.association.label
    if label_rule is None:
        return np.empty((len(detections.values), 0))
    joint = np.array(label_rule.prior) * np.exp(label_rule.log(detections.labels))
    return np.asarray(joint / joint.sum(axis=1, keepdims=True))


def prune(rule: CrowdRule, detection_model: DetectionModel) -> DetectionModel:
    """With those tracks that may still become targets, the most probable, or whose detections are no births.

    Of those that are dropped it is learnt how many false detections last.
    """
    unconfirmed = detection_model.unconfirmed
    may_be = unconfirmed.existence >= HOPELESS * detection_model.new_share(rule.existence)
    is_kept = may_be | (unconfirmed.presence.false >= LASTING)
    if rule.is_first:
        over = unconfirmed.presence.take(~is_kept)
        detection_model = detection_model.after_over(over, rule.existence)
    indices = np.flatnonzero(is_kept)
    if len(indices) > rule.most:
        ranked = np.argsort(-unconfirmed.existence[indices], kind="stable")[: rule.most]
        indices = np.sort(indices[ranked])
    return evolve(detection_model, unconfirmed=unconfirmed.take(indices))


VELOCITY = ("vx", "vy")


MIN_DETECTIONS = 3
"""Of two detections each velocity is the way of one object."""


ROUTE = 0.999
"""Detections are one object's way if none is farther from its prediction than this share of right ones."""


def initiate(compiled: CompiledPlate, candidate: Candidate) -> Candidate:
    """A candidate with the moments of its state if it moves faster than the graph's start velocities say.

    The filter runs from the first detection on, with the start velocity of the graph. If a detection is
    outside its gate, it runs again with a velocity that is known only by how far a candidate is followed
    (`FOLLOW_BOX` sides a frame). If all further detections are inside then, they tell the velocity; else they
    are no way of one object, and the target starts in the last detection, as one does that fits at once.
    """
    if candidate.mean is not None or len(candidate.track) < MIN_DETECTIONS or not has_way(compiled):
        return candidate
    rule = next(iter(compiled.association_rules.values()))
    mean, covariance = compiled.moments.start_moments(candidate.track[0][1])
    limit = chi_square_quantile(ROUTE, 4)
    if _follow(compiled.moments, rule, candidate, (mean, covariance))[2] <= limit:
        return candidate
    fast = _fast_covariance(compiled.moments, covariance, mean)
    mean, covariance, d2 = _follow(compiled.moments, rule, candidate, (mean, fast))
    return candidate if d2 > limit else evolve(candidate, mean=mean, covariance=covariance)


def has_way(compiled: CompiledPlate) -> bool:
    """True if the detections of a plate tell the velocity of a target: by their density, where it has one."""
    is_dense = any(rule.similarity == "density" for rule in compiled.association_rules.values())
    return is_dense and _is_moving(compiled.moments)


def _is_moving(motion: MotionModel) -> bool:
    """True if a target has a velocity."""
    return all(name in motion.fields for name in VELOCITY)


def velocities(motion: MotionModel, means: Floats) -> Floats:
    """(T, 2) velocities of states (T, D), px a frame interval; 0 of a motion without one."""
    if not _is_moving(motion):
        return np.zeros((len(means), 2))
    return means[:, [motion.fields.index(name) for name in VELOCITY]]


def _fast_covariance(motion: MotionModel, covariance: Floats, mean: Floats) -> Floats:
    """(..., D, D) covariances of starts at (..., D) with a velocity of sd `FOLLOW_BOX` sides a frame."""
    fast, sides2 = covariance.copy(), mean[..., 2] * mean[..., 3]
    for index in (motion.fields.index(name) for name in VELOCITY):
        fast[..., index, index] = np.maximum(fast[..., index, index], FOLLOW_BOX**2 * sides2)
    return fast


def _follow(
    motion: MotionModel, rule: AssociationRule, candidate: Candidate, moments: tuple[Floats, Floats]
) -> tuple[Floats, Floats, float]:
    """Mean (D,) and covariance (D, D) after a candidate's detections, and the largest d^2 of one.

    d is its distance from its prediction, in sds. `moments` are those of a start in the first detection as if
    that had no errors.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.row_kernels import follow_row

    mean, covariance, largest = *(np.array(part) for part in moments), 0.0
    boxes = np.array([box for _, box in candidate.track])
    variances, shift = np.ascontiguousarray(rule.variances(boxes)), np.zeros(len(mean))
    covariance[range(4), range(4)] += variances[0]
    for row, ((start, _), (end, _)) in enumerate(pairwise(candidate.track), 1):
        transition, noise = motion.linearise(mean, end - start)
        if not isinstance(motion, KinematicMotion):
            shift = motion.drift(mean[None], end - start)[0] - transition @ mean
        move = for_reading(transition), plain(noise), shift
        largest = max(largest, follow_row(mean, covariance, move, boxes[row], variances[row]))
    return mean, covariance, largest
