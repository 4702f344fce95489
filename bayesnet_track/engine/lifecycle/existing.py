"""Share detections out among targets that exist with a probability, and what may become a target.

The targets of a plate and its unconfirmed tracks (detected, and no targets yet) are weighed together
(`adapt.existence`): one detection each at most, each detection once at most. How targets use what they are
given is up to their beliefs; unconfirmed tracks are Gaussian beliefs that move as the plate does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayesnet_track.adapt.association import UNASSIGNED, assign_pairs
from bayesnet_track.adapt.existence import DetectionModel, Expected, Pairs, Shared, share
from bayesnet_track.adapt.joins import detection_of, expect_hidden, learn_hidden, share_hidden
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
    """

    mean: Floats
    covariance: Floats
    existence: Floats
    names: Sequence[str]
    log_looks: Callable[[Ints, Floats], Floats] | None = None
    modes: Mapping[int, ExpectedInModes] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class MarginalAssociation:
    """What T targets are given of N detections.

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


def expect_crowd(
    rule: CrowdRule, frames: FramePair, crowd: Crowd, detection_model: DetectionModel, found: Found | None
) -> tuple[Crowd, DetectionModel]:
    """The crowd and its unconfirmed tracks before the first look of a frame, which `found` something.

    They are those that survive, and are predicted; the means and covariances of the crowd are so already.
    """
    frame, last = frames.current, frames.previous
    dt = 1.0 if last is None else frame.time - last.time
    survival = rule.existence.survival**dt
    size, before = (frame.width, frame.height), detection_model.unconfirmed
    motion = framed(rule.motion, size, frames.names)
    unconfirmed = predict_unconfirmed(before, motion, dt, size)
    if found is not None and rule.sensor.has_extent:
        fast = with_fast(rule, before, unconfirmed, found.boxes, dt)
        unconfirmed = unconfirmed.extend(predict_unconfirmed(fast, motion, dt, size))
    unconfirmed = evolve(unconfirmed, existence=survival * unconfirmed.existence)
    return evolve(crowd, existence=survival * crowd.existence), evolve(
        detection_model, unconfirmed=unconfirmed
    )


def given_nothing(crowd: Crowd, detection_model: DetectionModel) -> MarginalAssociation:
    """What each target is given where nobody looked."""
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
    rule: CrowdRule, frame: Frame, crowd: Crowd, detection_model: DetectionModel, found: Found
) -> MarginalAssociation:
    """What each target is given of what a sensor `found`, and the unconfirmed tracks after it."""
    detection_model, unconfirmed = rule.sensor.learn(detection_model, found), detection_model.unconfirmed
    all_of = evolve(
        crowd,
        mean=np.concatenate([crowd.mean, unconfirmed.mean]),
        covariance=np.concatenate([crowd.covariance, unconfirmed.covariance]),
        existence=np.concatenate([crowd.existence, unconfirmed.existence]),
    )
    cover = rule.sensor.cover(all_of.mean, all_of.existence)
    hidden = _expect_hidden(rule, crowd.names, cover, detection_model)
    most = detection_model.detection(rule.existence)
    detection = detection_of(most, cover, hidden)
    for row, expected in crowd.modes.items():
        detection[row] *= expected.visible
    area = float(frame.width * frame.height)
    shared = _share(rule, all_of, detection, detection_model, found, area)
    pairs = shared.pairs if rule.is_marginal else _assigned(shared, len(found.values))
    unconfirmed = advance_unconfirmed(rule, unconfirmed, pairs, shared, found)
    unconfirmed = unconfirmed.extend(begin_unconfirmed(rule, detection_model, found, shared.free, frame))
    detection_model = _learn(rule, detection_model, shared, crowd, (cover, hidden))
    kept = evolve(detection_model, unconfirmed=prune(rule, detection_model, unconfirmed))
    return _of_targets(pairs, shared, len(crowd.mean), kept)


def after_look(rule: CrowdRule, crowd: Crowd, found: Found, done: MarginalAssociation) -> Crowd:
    """The crowd as a further sensor expects it in the same frame."""
    mean, covariance = crowd.mean.copy(), crowd.covariance.copy()
    rule.sensor.mix(mean, covariance, found, Mixed(done.starts, done.columns, done.weights, done.missed))
    return evolve(crowd, mean=mean, covariance=covariance)


def _share(
    rule: CrowdRule,
    crowd: Crowd,
    detection: Floats,
    detection_model: DetectionModel,
    found: Found,
    area_px2: float,
) -> Shared:
    """Whose the detections are, of targets and unconfirmed tracks that are detected so surely (T,)."""
    settings, sensor = rule.existence, rule.sensor
    rate = detection_model.clutter_rate(settings) + settings.births
    log_nobody = sensor.log_density(detection_model, found, area_px2) + math.log(rate)
    pairs = sensor.gate(crowd.mean, crowd.covariance, found)
    if crowd.modes:
        pairs = _in_modes(sensor, pairs, crowd.modes, found)
    if crowd.log_looks is not None and sensor.association.appearance > 0:
        pairs = with_looks(sensor.association, pairs, crowd.log_looks, found.boxes)
    likelihoods = evolve(pairs, values=pairs.values + sensor.log_scale)
    return share(Expected(crowd.existence, detection), likelihoods, log_nobody)


def _in_modes(sensor: Sensor, pairs: Pairs, modes: Mapping[int, ExpectedInModes], found: Found) -> Pairs:
    """The pairs with the density of a mixture, a Gaussian for each mode, of targets that have modes."""
    values = pairs.values.copy()
    for row, expected in modes.items():
        own = np.flatnonzero(pairs.rows == row)
        if len(own):
            logs = sensor.log_gains(expected.means, expected.covariances, found.only(pairs.columns[own]))
            with np.errstate(divide="ignore"):
                values[own] = np.logaddexp.reduce(np.log(expected.shares)[:, None] + logs, axis=0)
    return evolve(pairs, values=values)


def _assigned(shared: Shared, found: int) -> Pairs:
    """The best assignment of detections that are likelier a target's than nobody's, with weight 1."""
    gains, count = shared.gains, len(shared.existence)
    likely = gains.values > 0.0
    owner = assign_pairs(gains.rows[likely], gains.columns[likely], gains.values[likely], count, found)
    rows = np.flatnonzero(owner != UNASSIGNED)
    return Pairs(rows, owner[rows].astype(np.int64), np.ones(len(rows)))


def _expect_hidden(
    rule: CrowdRule, names: Sequence[str], cover: Floats, detection_model: DetectionModel
) -> Floats:
    """(T,) how probable it is that each target and prospect is hidden, if another covers it."""
    share = share_hidden(detection_model.detection(rule.existence), detection_model.covered(rule.existence))
    before = np.full(len(cover), share)
    if detection_model.hidden:
        known = detection_model.hidden
        before[: len(names)] = [known.get(name, share) for name in names]
    return expect_hidden(before, cover, share)


def _learn(
    rule: CrowdRule,
    detection_model: DetectionModel,
    shared: Shared,
    crowd: Crowd,
    covers: tuple[Floats, Floats],
) -> DetectionModel:
    """The estimates after the look; `covers` are how probably each is covered, and hidden if it is."""
    names, count = crowd.names, len(crowd.names)
    cover, hidden = (one[:count] for one in covers)
    seen, existence = shared.seen[:count], shared.existence[:count]
    false = float(shared.free.sum()) * (1.0 - detection_model.new_share(rule.existence))
    rows = np.flatnonzero(cover > 0.0)
    given = np.minimum(seen[rows] / np.maximum(existence[rows], 1e-300), 1.0)
    after = learn_hidden(hidden[rows], given, detection_model.detection(rule.existence))
    now = {names[row]: value for row, value in zip(rows.tolist(), after.tolist(), strict=True)}
    chances = existence.copy()
    for row, expected in crowd.modes.items():  # one that its mode hides was not missed
        missed = expected.visible * (1.0 - detection_model.detection(rule.existence))
        chances[row] -= (existence[row] - seen[row]) * (
            1.0 - missed / (missed + 1.0 - expected.visible + 1e-300)
        )
    return evolve(detection_model.after_look(false).after_chances(cover, seen, chances), hidden=now)


def _of_targets(
    pairs: Pairs, shared: Shared, count: int, detection_model: DetectionModel
) -> MarginalAssociation:
    own = pairs.rows < count
    rows, columns, weights = pairs.rows[own], pairs.columns[own], pairs.values[own]
    best = np.flatnonzero(weights >= 0.5)
    owner = np.full(count, UNASSIGNED, dtype=np.int64)
    owner[rows[best]] = columns[best]
    missed = np.clip(1.0 - np.bincount(rows, weights, minlength=count), 0.0, 1.0)
    missed[missed < 1e-12] = 0.0
    starts = np.searchsorted(rows, np.arange(count + 1))
    return MarginalAssociation(
        shared.existence[:count], starts, columns, weights, missed, owner, detection_model
    )
