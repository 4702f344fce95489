"""Share detections out among targets that exist with a probability, and what may become a target.

The targets of a plate and its unconfirmed tracks (detected, and no targets yet) are weighed together
(`adapt.existence`): one detection each at most, each detection once at most. How targets use what they are
given is up to their beliefs; unconfirmed tracks are Gaussian beliefs that move as the plate does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayesnet_track.adapt.association import UNASSIGNED, assign_pairs
from bayesnet_track.adapt.existence import (
    Begins,
    DetectionModel,
    Expected,
    Pairs,
    Shared,
    share,
)
from bayesnet_track.adapt.presence import (
    Known,
    Presence,
    Weights,
    expect_cover,
    pass_time,
)
from bayesnet_track.belief.gaussian.expected import ExpectedInModes
from bayesnet_track.belief.motion.borders import framed
from bayesnet_track.engine.lifecycle.sensing import Found, Mixed, Sensor, with_looks
from bayesnet_track.engine.lifecycle.unconfirmed import (
    CrowdRule,
    advance_unconfirmed,
    begin_unconfirmed,
    predict_unconfirmed,
    prune,
    with_fast,
)
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.planes import Frame, FramePair


@dataclass(frozen=True, eq=False)
class Crowd:
    """T targets before a look.

    Attributes:
        mean: (T, D) as they are expected.
        covariance: (T, D, D).
        existence: (T,) probability that each exists, as of the last frame.
        names: of the targets.
        log_looks: rows (M,) in order, boxes (M, 4) -> (M,) log-likelihoods by what the targets look like.
        modes: row -> what is expected of a target in each of its modes.
        values: (U, V) probabilities of what the last U of them are, of which labels are evidence on it.
    """

    mean: Floats
    covariance: Floats
    existence: Floats
    names: Sequence[str]
    log_looks: Callable[[Ints, Floats], Floats] | None = None
    modes: Mapping[int, ExpectedInModes] = field(default_factory=dict)
    values: Floats | None = None

    @property
    def moments(self) -> tuple[Floats, Floats]:
        """Means and covariances."""
        return self.mean, self.covariance


@dataclass(frozen=True, eq=False)
class MarginalAssociation:
    """The shares of N detections that T targets are given.

    Attributes:
        existence: (T,) probability that each exists.
        starts: (T + 1,) where the detections of each begin in the next two.
        columns: (P,) which detection.
        weights: (P,) the probability that it is the target's, given that this exists.
        missed: (T,) that none is.
        owner: (T,) the detection that is the target's more probably than not, or `UNASSIGNED`.
        detection_model: what was learnt, and the unconfirmed tracks.
    """

    existence: Floats
    starts: Ints
    columns: Ints
    weights: Floats
    missed: Floats
    owner: Ints
    detection_model: DetectionModel

    @property
    def mixed(self) -> Mixed:
        """The same, for an update."""
        return Mixed(self.starts, self.columns, self.weights, self.missed)


def expect_crowd(
    rule: CrowdRule,
    frames: FramePair,
    crowd: Crowd,
    detection_model: DetectionModel,
    detections: Found | None,
) -> tuple[Crowd, DetectionModel]:
    """The crowd and its unconfirmed tracks before the first look of a frame.

    They are those that survive, and are predicted; the means and covariances of the crowd are so already.
    """
    frame, previous = frames.current, frames.previous
    dt = 1.0 if previous is None else frame.time - previous.time
    survival = rule.existence.survival**dt
    size, tracks_before = (frame.width, frame.height), detection_model.unconfirmed
    motion = framed(rule.motion, size, frames.names)
    unconfirmed = predict_unconfirmed(tracks_before, motion, dt, size)
    if detections is not None and rule.sensor.has_extent:
        fast = with_fast(rule, tracks_before, unconfirmed, detections.boxes, dt)
        unconfirmed = unconfirmed.extend(predict_unconfirmed(fast, motion, dt, size))
    chain = detection_model.chain(rule.existence)
    unconfirmed = evolve(
        unconfirmed,
        existence=survival * unconfirmed.existence,
        presence=pass_time(unconfirmed.presence, chain, dt),
    )
    names, presences = tuple(crowd.names), detection_model.known
    live = set(names)
    over = np.array([name not in live for name in presences.names], dtype=np.bool_)
    model = detection_model.after_over(presences.presence.take(over), rule.existence)
    model = evolve(model, unconfirmed=unconfirmed, known=_later(model, rule, names, dt))
    further_models = {
        sensor: evolve(sensor_model, known=_later(sensor_model, rule, names, dt))
        for sensor, sensor_model in model.further.items()
    }
    return evolve(crowd, existence=survival * crowd.existence), evolve(model, further=further_models)


def _later(model: DetectionModel, rule: CrowdRule, names: tuple[str, ...], dt: float) -> Known:
    """The presence of targets as a sensor expects it, `dt` frame intervals later."""
    return Known(names, pass_time(model.known.of(names), model.chain(rule.existence), dt))


def given_nothing(crowd: Crowd, detection_model: DetectionModel) -> MarginalAssociation:
    """The share each target is given where nobody looked."""
    count = len(crowd.mean)
    return MarginalAssociation(
        crowd.existence,
        np.zeros(count + 1, np.int64),
        np.empty(0, np.int64),
        np.empty(0),
        np.ones(count),
        np.full(count, UNASSIGNED, dtype=np.int64),
        detection_model,
    )


def associate_marginal(
    rule: CrowdRule, frame: Frame, crowd: Crowd, detection_model: DetectionModel, detections: Found
) -> MarginalAssociation:
    """Shares of a sensor's detections that each target is given, and the unconfirmed tracks after it."""
    detection_model, unconfirmed = rule.sensor.learn(detection_model, detections), detection_model.unconfirmed
    all_of, weights, cover = expect_detections(rule, crowd, detection_model)
    image = frame.of(rule.camera) or frame
    settings, area = rule.existence, float(image.width * image.height)
    nearness = rule.sensor.near(crowd.mean, crowd.existence, detections, area)
    begins = detection_model.begin(settings, *nearness)
    if not rule.is_first:
        nothing = np.zeros(len(detections.values))
        begins = evolve(begins, spot=nothing, double=nothing)
    log_nobody = rule.sensor.log_density(detection_model, detections, area) + np.log(begins.density)
    shared = _share(rule, all_of, weights, detections, log_nobody)
    existence, presence = weights.after(shared.seen)
    shared = evolve(shared, existence=existence)
    pairs = shared.pairs if rule.is_marginal else _assigned(shared, len(detections.values))
    count = len(crowd.mean)
    detection_model = _learn(rule, detection_model, shared, crowd, (cover, begins))
    open_seen = shared.seen[:count] * (1.0 - cover[:count])
    presences = Known(tuple(crowd.names), evolve(presence.take(slice(count)), open_seen=open_seen))
    waiting = _seen_by(rule, unconfirmed.presence, presence.take(slice(count, None)))
    unconfirmed = evolve(unconfirmed, presence=waiting)
    unconfirmed = advance_unconfirmed(rule, unconfirmed, pairs, shared, detections)
    unconfirmed = unconfirmed.extend(begin_unconfirmed(rule, begins, detections, shared.free, frame))
    model = evolve(detection_model, unconfirmed=unconfirmed, known=presences)
    return _of_targets(pairs, shared, count, prune(rule, model))


def expect_detections(
    rule: CrowdRule, crowd: Crowd, detection_model: DetectionModel
) -> tuple[Crowd, Weights, Floats]:
    """Targets and unconfirmed tracks before a sensor looks.

    They come together as one crowd of N, with the weights of their states and detections, and how probable it
    is that another one covers each, (N,).
    """
    unconfirmed, settings = detection_model.unconfirmed, rule.existence
    all_of = evolve(
        crowd,
        mean=np.concatenate([crowd.mean, unconfirmed.mean]),
        covariance=np.concatenate([crowd.covariance, unconfirmed.covariance]),
        existence=np.concatenate([crowd.existence, unconfirmed.existence]),
        values=unconfirmed.values,
    )
    presence = detection_model.known.presence.extend(_as_seen_by(rule, unconfirmed.presence))
    chain, cover = detection_model.chain(settings), rule.sensor.cover(all_of.mean, all_of.existence)
    presence = expect_cover(presence, cover, detection_model.share_hidden(settings))
    visible = rule.sensor.in_image(all_of.mean, all_of.covariance)
    for row, expected in crowd.modes.items():
        visible[row] *= expected.visible
    weights = Weights.of(all_of.existence, presence, chain, visible)
    if not rule.is_first:  # a false alarm is one of the first sensor
        weights.detection[:, 3:] = 0.0
    return all_of, weights, cover


def _as_seen_by(rule: CrowdRule, presence: Presence) -> Presence:
    """Presence of unconfirmed tracks; what makes them blind or hidden is of the first sensor alone."""
    if rule.is_first:
        return presence
    nothing = np.zeros(len(presence))
    return evolve(presence, blind=nothing, hidden=nothing)


def _seen_by(rule: CrowdRule, prior: Presence, posterior: Presence) -> Presence:
    return posterior if rule.is_first else evolve(posterior, blind=prior.blind, hidden=prior.hidden)


def after_look(rule: CrowdRule, crowd: Crowd, detections: Found, association: MarginalAssociation) -> Crowd:
    """The crowd as a further sensor expects it in the same frame."""
    mean, covariance = crowd.mean.copy(), crowd.covariance.copy()
    rule.sensor.mix(mean, covariance, detections, association.mixed)
    return evolve(crowd, mean=mean, covariance=covariance)


def _share(rule: CrowdRule, crowd: Crowd, weights: Weights, detections: Found, log_nobody: Floats) -> Shared:
    """Probabilities of whose the detections are, of targets and unconfirmed tracks of these weights."""
    sensor = rule.sensor
    pairs = sensor.gate(crowd.mean, crowd.covariance, detections)
    if crowd.modes:
        pairs = _in_modes(sensor, pairs, crowd.modes, detections)
    if (
        (label_rule := sensor.association.label) is not None
        and crowd.values is not None
        and len(crowd.values)
    ):
        log_gains = np.log(crowd.values @ np.exp(label_rule.log_gains(detections.labels)).T)
        first = len(crowd.mean) - len(crowd.values)
        is_unconfirmed = pairs.rows >= first
        values = pairs.values.copy()
        values[is_unconfirmed] += log_gains[pairs.rows[is_unconfirmed] - first, pairs.columns[is_unconfirmed]]
        pairs = evolve(pairs, values=values)
    if crowd.log_looks is not None and sensor.association.appearance > 0:
        pairs = with_looks(sensor.association, pairs, crowd.log_looks, detections.boxes)
    likelihoods = evolve(pairs, values=pairs.values + sensor.log_scale)
    return share(Expected(weights.total, weights.mean_detection), likelihoods, log_nobody)


def _in_modes(sensor: Sensor, pairs: Pairs, modes: Mapping[int, ExpectedInModes], detections: Found) -> Pairs:
    """The pairs with the density of a mixture, a Gaussian for each mode, of targets that have modes."""
    values = pairs.values.copy()
    for row, expected in modes.items():
        indices = np.flatnonzero(pairs.rows == row)
        if len(indices):
            gated = detections.only(pairs.columns[indices])
            logs = sensor.log_gains(expected.means, expected.covariances, gated)
            logs = logs + expected.log_gains(sensor.association, gated.labels)
            with np.errstate(divide="ignore"):
                values[indices] = np.logaddexp.reduce(np.log(expected.shares)[:, None] + logs, axis=0)
    return evolve(pairs, values=values)


def _assigned(shared: Shared, detection_count: int) -> Pairs:
    """The best assignment of detections that are likelier a target's than nobody's, with weight 1."""
    gains, count = shared.gains, len(shared.existence)
    likely = gains.values > 0.0
    owner = assign_pairs(
        gains.rows[likely], gains.columns[likely], gains.values[likely], count, detection_count
    )
    rows = np.flatnonzero(owner != UNASSIGNED)
    return Pairs(rows, owner[rows].astype(np.int64), np.ones(len(rows)))


def _learn(
    rule: CrowdRule,
    detection_model: DetectionModel,
    shared: Shared,
    crowd: Crowd,
    places: tuple[Floats, Begins],
) -> DetectionModel:
    """The estimates after the look; `places`: how probably targets are covered, and what detections begin."""
    count, (cover, begins) = len(crowd.names), places
    cover, seen_shares, existence = cover[:count], shared.seen[:count], shared.existence[:count]
    false, chances = shared.free * (1.0 - begins.target), existence.copy()
    detection = detection_model.chain(rule.existence).detection
    for row, expected in crowd.modes.items():  # one that its mode hides was not missed
        missed = expected.visible * (1.0 - detection)
        chances[row] -= (existence[row] - seen_shares[row]) * (
            1.0 - missed / (missed + 1.0 - expected.visible + 1e-300)
        )
    model = detection_model.after_look(float(false @ (1.0 - begins.near)), float(false @ begins.near))
    open_before = detection_model.known.presence.open_seen
    return model.after_chances(cover, np.minimum(seen_shares, existence), chances, open_before)


def _of_targets(
    pairs: Pairs, shared: Shared, count: int, detection_model: DetectionModel
) -> MarginalAssociation:
    is_target = pairs.rows < count
    rows, columns, weights = pairs.rows[is_target], pairs.columns[is_target], pairs.values[is_target]
    likely = np.flatnonzero(weights >= 0.5)
    owner = np.full(count, UNASSIGNED, dtype=np.int64)
    owner[rows[likely]] = columns[likely]
    missed = np.clip(1.0 - np.bincount(rows, weights, minlength=count), 0.0, 1.0)
    missed[missed < 1e-12] = 0.0
    starts = np.searchsorted(rows, np.arange(count + 1))
    return MarginalAssociation(
        shared.existence[:count], starts, columns, weights, missed, owner, detection_model
    )
