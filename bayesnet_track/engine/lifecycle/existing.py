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
from bayesnet_track.adapt.existence import DetectionModel, Expected, Pairs, Shared, UnconfirmedTracks, share
from bayesnet_track.adapt.joins import detection_of, expect_hidden, learn_hidden, share_hidden
from bayesnet_track.belief.gaussian.expected import ExpectedInModes
from bayesnet_track.engine.lifecycle.detecting import Found
from bayesnet_track.engine.lifecycle.unconfirmed import (
    CrowdRule,
    advance_unconfirmed,
    begin_unconfirmed,
    predict_unconfirmed,
    prune,
    with_fast,
)
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.gaussian import chi_square_quantile
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import AssociationRule
from bayesnet_track.observation.planes import FramePair

COVERED = 0.5
"""A target counts as covered when another one covers this share of its box."""

LOG_TURN = math.log(2.0 * math.pi)


@dataclass(frozen=True, eq=False)
class Crowd:
    """T targets before a look.

    Attributes:
        mean: (T, 4) boxes as they are expected.
        covariance: (T, 4, 4).
        existence: (T,) probability that each exists, as of the last frame.
        names: of the targets.
        log_looks: row, boxes (M, 4) -> (M,) log-likelihood by what the target looks like.
        modes: row -> what is expected of a target in each of its modes.
    """

    mean: Floats
    covariance: Floats
    existence: Floats
    names: Sequence[str]
    log_looks: Callable[[int, Floats], Floats] | None = None
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


def associate_marginal(
    rule: CrowdRule,
    frames: FramePair,
    crowd: Crowd,
    detection_model: DetectionModel | None,
    found: Found | None,
) -> MarginalAssociation:
    """Share of each target in what was `found` (None: nobody looked), and the unconfirmed tracks after it."""
    frame, last = frames.current, frames.previous
    dt = 1.0 if last is None else frame.time - last.time
    if detection_model is None:
        detection_model = DetectionModel(UnconfirmedTracks.none(len(rule.motion.fields)))
    size, before = (frame.width, frame.height), detection_model.unconfirmed
    unconfirmed = predict_unconfirmed(before, rule.motion, dt, size)
    if found is not None:
        fast = with_fast(rule, before, unconfirmed, found.boxes, dt)
        unconfirmed = unconfirmed.extend(predict_unconfirmed(fast, rule.motion, dt, size))
    survival = rule.existence.survival**dt
    count, existence = len(crowd.mean), survival * np.concatenate([crowd.existence, unconfirmed.existence])
    if found is None:
        unconfirmed = evolve(unconfirmed, existence=existence[count:])
        nothing = np.empty(0, np.int64)
        return MarginalAssociation(
            existence[:count],
            np.zeros(count + 1, np.int64),
            nothing,
            np.empty(0),
            np.ones(count),
            np.full(count, UNASSIGNED, dtype=np.int64),
            evolve(detection_model, unconfirmed=unconfirmed),
        )
    detection_model = detection_model.with_sizes(found.boxes)
    all_of = evolve(
        crowd,
        mean=np.concatenate([crowd.mean, unconfirmed.mean[:, :4]]),
        covariance=np.concatenate([crowd.covariance, unconfirmed.covariance[:, :4, :4]]),
        existence=existence,
    )
    area = float(frame.width * frame.height)
    cover = _cover(all_of)
    hidden = _expect_hidden(rule, crowd.names, cover, detection_model)
    most = detection_model.detection(rule.existence)
    detection = detection_of(most, cover, hidden)
    for row, expected in crowd.modes.items():
        detection[row] *= expected.visible
    shared = _share(rule, all_of, detection, detection_model, found.boxes, area)
    pairs = shared.pairs if rule.is_marginal else _assigned(shared, len(found.boxes))
    unconfirmed = advance_unconfirmed(rule, unconfirmed, pairs, shared, found)
    unconfirmed = unconfirmed.extend(begin_unconfirmed(rule, detection_model, found, shared.free, frame))
    detection_model = _learn(rule, detection_model, shared, crowd, (cover, hidden))
    return _of_targets(
        pairs, shared, count, evolve(detection_model, unconfirmed=prune(rule, detection_model, unconfirmed))
    )


def _cover(crowd: Crowd) -> Floats:
    """(T,) how probable it is that another target covers each."""
    from bayesnet_track.numerics.kernels.pair_kernels import cover_rows

    order = np.argsort(crowd.mean[:, 0] - crowd.mean[:, 2] / 2, kind="stable")
    return np.asarray(cover_rows(np.ascontiguousarray(crowd.mean), crowd.existence, order, COVERED))


def _share(
    rule: CrowdRule,
    crowd: Crowd,
    detection: Floats,
    detection_model: DetectionModel,
    boxes: Floats,
    area_px2: float,
) -> Shared:
    """Whose the detections (N, 4) are, of targets and unconfirmed tracks that are detected so surely (T,)."""
    settings = rule.existence
    rate = detection_model.clutter_rate(settings) + settings.births
    log_nobody = detection_model.log_density(boxes, area_px2) + math.log(rate)
    pairs = gate(rule.association, crowd.mean, crowd.covariance, boxes)
    if crowd.modes:
        pairs = _in_modes(rule.association, pairs, crowd.modes, boxes)
    if crowd.log_looks is not None and rule.association.appearance > 0:
        pairs = with_looks(rule.association, pairs, crowd.log_looks, boxes)
    likelihoods = evolve(pairs, values=pairs.values - 2.0 * LOG_TURN)
    return share(Expected(crowd.existence, detection), likelihoods, log_nobody)


def gate(rule: AssociationRule, mean: Floats, covariance: Floats, boxes: Floats) -> Pairs:
    """The detections (N, 4) that may be whose, with -d^2 / 2 - log det S / 2; means (T, D), and (T, D, D)."""
    from bayesnet_track.numerics.kernels.pair_kernels import gate_rows

    nothing = np.empty(0, np.int64)
    if not len(boxes) or not len(mean):
        return Pairs(nothing, nothing, np.empty(0))
    boxes, variances = np.ascontiguousarray(boxes), rule.variances(boxes)
    limit, min_overlap = chi_square_quantile(rule.gate, 4), rule.min_overlap
    reach = np.sqrt(limit * (covariance[:, 0, 0] + variances[:, 0].max())) * (1 + 1e-9)
    if min_overlap > 0.0:  # then they touch
        reach = np.minimum(reach, (mean[:, 2] + boxes[:, 2].max()) / 2)
    order = np.argsort(boxes[:, 0], kind="stable")
    places = boxes[order, 0]
    starts = np.searchsorted(places, mean[:, 0] - reach)
    ends = np.searchsorted(places, mean[:, 0] + reach, side="right")
    return Pairs(*gate_rows(mean, covariance, boxes, variances, order, starts, ends, limit, min_overlap))


def _in_modes(
    rule: AssociationRule, pairs: Pairs, modes: Mapping[int, ExpectedInModes], boxes: Floats
) -> Pairs:
    """The pairs with the density of a mixture, a Gaussian for each mode, of targets that have modes."""
    values, variances = pairs.values.copy(), rule.variances(boxes)
    for number, (row, column) in enumerate(zip(pairs.rows.tolist(), pairs.columns.tolist(), strict=True)):
        if row in modes:
            expected = modes[row]
            spread = expected.covariances[:, :4, :4] + np.diag(variances[column])
            away = boxes[column] - expected.means[:, :4]
            d2 = np.einsum("mi,mi->m", away, np.linalg.solve(spread, away[:, :, None])[:, :, 0])
            with np.errstate(divide="ignore"):
                log = np.log(expected.shares) - 0.5 * (d2 + np.linalg.slogdet(spread)[1])
            values[number] = np.logaddexp.reduce(log)
    return evolve(pairs, values=values)


def with_looks(
    rule: AssociationRule, pairs: Pairs, log_looks: Callable[[int, Floats], Floats], boxes: Floats
) -> Pairs:
    """The pairs with what their targets look like: their values and appearance log L."""
    values = pairs.values.copy()
    for row in np.unique(pairs.rows).tolist():
        own = pairs.rows == row
        values[own] += rule.appearance * log_looks(row, boxes[pairs.columns[own]])
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
