"""Posterior over who is who, of targets that come close and part again.

While targets of a plate are close, a detection may be of one or of another. A `Meeting` holds the joint
hypotheses of which detection was of which member, each with a Kalman filter per member that starts with the
belief before they met:

    p(h_t) = c p(h_{t-1}) prod_i [pd N(z_a(i); H m_i, s^2 S_i) L_i(z_a(i))^a  or  1 - pd] prod_left lambda(z)

for every assignment a of members to detections, exactly. Hypotheses with the same last `RECENT` detections of
every member differ by what is long past: they become one, with the moments of their mixture. S_i has the
errors that the graph names; s is how much larger innovations really are, measured where nobody is doubtful,
for x, y and w, h apart and by the frames since the last detection. L_i is what member i looked like before.

Who came out as whom is asked of the tracks afterwards (`place_tracks`): each hypothesis says which of its
members is where. Meetings one after the other are composed (`adapt.identities`).

Reid 1979, "An algorithm for tracking multiple targets"; Salmond 1990 for the moments.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import Reference

MOST_MEMBERS = 4
"""Members of a meeting: their permutations are summed over exactly."""
MOST_DETECTIONS = 6
"""Detections of a frame that a meeting looks at."""
MOST_HYPOTHESES = 128
"""Hypotheses of a meeting that are kept: the most probable ones."""
RECENT = 4
"""Detections of each member by which hypotheses are told apart."""
LEAST = 1e-6
"""Hypotheses less probable than this, beside the most probable one, are dropped."""
FAR_D2 = 36.0
"""A detection so far from a member, in squared sds of x, y, is not its own."""
MISSED = 0
"""In place of the number of a detection: there was none."""
GAPS = (1, 2, 4, 8)
"""Classes of frames since a target's last detection: from so many frames on."""
LAPSE = 0.01
"""Share of meetings in which what happened is nothing that the motion expects: nobody is surer than that."""
NEW = "new"
"""Identity of what is none of those that are known."""
SHARED_SD = 0.3
"""Sd of the place of each of two targets in one box around both, in sides of the box."""


@dataclass(frozen=True, eq=False)
class SensorRates:
    """Measures of a plate's detections where it is plain whose they are.

    Attributes:
        d2: (G, 2) sums of d^2 / 2 of x, y and of w, h by `GAPS`: the mean is 1 if errors are those named.
        count: (G,) number of them.
        seen: frames of targets with a detection, and of all.
        clutter: detections of nobody, and frames.
    """

    d2: Floats = field(default_factory=lambda: np.diag([4.0, 0.0, 0.0, 0.0])[:, [0, 0]])
    count: Floats = field(default_factory=lambda: np.array([4.0, 0.0, 0.0, 0.0]))
    seen: tuple[float, float] = (9.0, 10.0)
    clutter: tuple[float, float] = (0.1, 1.0)

    @property
    def scale2(self) -> Floats:
        """(G, 2) s^2; a class with few detections borrows from the one before."""
        scales, previous = np.empty_like(self.d2), np.ones(2)
        for place in range(len(GAPS)):
            weight = 0.0 if place == 0 else 8.0
            previous = (self.d2[place] + weight * previous) / (self.count[place] + weight)
            scales[place] = previous
        return np.clip(scales, 1e-3, 1e3)

    @property
    def detection(self) -> float:
        """Probability of a detection of a target that had one in the frame before."""
        return min(max(self.seen[0] / self.seen[1], 0.05), 0.99)

    def learn(
        self, d2: Floats, unseen: Ints, seen: tuple[int, int], free: int, fade: float = 0.998
    ) -> SensorRates:
        """The rates after a frame: halves of d^2 (T, 2) of detections `unseen` (T,) frames after the last."""
        place = gap_class(unseen)
        sums, count = self.d2 * fade, self.count * fade
        np.add.at(sums, place, np.minimum(d2, 12.0))
        np.add.at(count, place, 1.0)
        first, clutter = self.seen, self.clutter
        return SensorRates(
            sums,
            count,
            (first[0] * fade + seen[0], first[1] * fade + seen[1]),
            (clutter[0] * fade + free, clutter[1] * fade + 1.0),
        )


@dataclass(frozen=True, eq=False)
class Meeting:
    """Members that are close or were a short while ago: K hypotheses of n members.

    Attributes:
        members: the tracks that met.
        since: frame in which they did.
        last_near: the last frame in which two of them were close.
        mean: (K, n, D) of each member under each hypothesis.
        covariance: (K, n, D, D).
        log_weight: (K,) log probabilities, normalised.
        looks: (K,) what appearance has told of it, nats.
        recent: (K, n, RECENT) numbers of the last detections of each member, the last one last.
        unseen: (K, n) frame intervals since the last one.
        references: of each member, agent -> what it remembered before they met.
        count: detections so far.
    """

    members: tuple[str, ...]
    since: int
    last_near: int
    mean: Floats
    covariance: Floats
    log_weight: Floats
    looks: Floats
    recent: Ints
    unseen: Ints
    references: tuple[Mapping[str, Reference], ...] = ()
    count: int = 0

    @property
    def weights(self) -> Floats:
        """(K,) probabilities."""
        return np.asarray(np.exp(self.log_weight))


@dataclass(frozen=True, eq=False)
class MeetingDetections:
    """The detections of a frame that a meeting looks at.

    Attributes:
        boxes: (M, 4) centre boxes.
        variances: (M, 4) of their errors.
        looks: (n, M) log-likelihoods of what each member looked like.
        log_else: (M,) log density of a detection that is of no member.
    """

    boxes: Floats
    variances: Floats
    looks: Floats
    log_else: Floats


def gap_class(unseen: Ints) -> Ints:
    """The class of `GAPS` of frames since the last detection, from 1.

    >>> gap_class(np.array([1, 3, 30])).tolist()
    [0, 1, 3]
    """
    return np.asarray(np.searchsorted(GAPS, np.maximum(unseen, 1), side="right") - 1)


def open_meeting(
    members: Sequence[str],
    frame: int,
    mean: Floats,
    covariance: Floats,
    references: Sequence[Mapping[str, Reference]] = (),
    unseen: Ints | None = None,
) -> Meeting:
    """A meeting of members with beliefs (n, D) and (n, D, D) of the frame before."""
    count = len(members)
    gone = np.zeros(count, dtype=np.int64) if unseen is None else unseen
    return Meeting(
        tuple(members),
        frame,
        frame,
        mean[None].copy(),
        covariance[None].copy(),
        np.zeros(1),
        np.zeros(1),
        np.zeros((1, count, RECENT), dtype=np.int64),
        gone[None].astype(np.int64),
        tuple(references),
    )


def join_meetings(first: Meeting, second: Meeting) -> Meeting:
    """One meeting of the members of both, which were apart until now."""
    k, m = len(first.log_weight), len(second.log_weight)
    a, b = (part.ravel() for part in np.indices((k, m)))
    log_weight = first.log_weight[a] + second.log_weight[b]
    order = np.argsort(-log_weight, kind="stable")[:MOST_HYPOTHESES]
    a, b = a[order], b[order]
    shifted = np.where(second.recent == MISSED, MISSED, second.recent + first.count)
    return Meeting(
        (*first.members, *second.members),
        min(first.since, second.since),
        max(first.last_near, second.last_near),
        np.concatenate([first.mean[a], second.mean[b]], axis=1),
        np.concatenate([first.covariance[a], second.covariance[b]], axis=1),
        _normalised(log_weight[order]),
        first.looks[a] + second.looks[b],
        np.concatenate([first.recent[a], shifted[b]], axis=1),
        np.concatenate([first.unseen[a], second.unseen[b]], axis=1),
        (*first.references, *second.references),
        first.count + second.count,
    )


@lru_cache(maxsize=128)
def assignments(rows: int, columns: int) -> Ints:
    """(A, rows) every assignment of rows to columns, one to one; `columns` stands for none.

    >>> assignments(2, 1).tolist()
    [[0, 1], [1, 0], [1, 1]]
    """
    choices = [
        choice
        for choice in product(range(columns + 1), repeat=rows)
        if len({*choice} - {columns}) == sum(column < columns for column in choice)
    ]
    return np.array(choices, dtype=np.int64).reshape(-1, rows)


def halves_of_d2(offset: Floats, spread: Floats) -> tuple[Floats, Floats]:
    """(..., 2) halves of d^2 of x, y and of w, h, and of the log determinants of their covariances.

    `offset` are (..., 4), `spread` (..., 4, 4); correlations of places and sizes are left out.
    """
    d2, log = np.empty((*offset.shape[:-1], 2)), np.empty((*offset.shape[:-1], 2))
    for block, (i, j) in enumerate(((0, 1), (2, 3))):
        a, b, c = spread[..., i, i], spread[..., i, j], spread[..., j, j]
        determinant = np.maximum(a * c - b * b, 1e-12)
        u, v = offset[..., i], offset[..., j]
        d2[..., block] = 0.5 * (c * u * u - 2.0 * b * u * v + a * v * v) / determinant
        log[..., block] = 0.5 * np.log(determinant)
    return d2, log


def advance(meeting: Meeting, sighting: MeetingDetections, rates: SensorRates) -> Meeting:
    """The meeting, predicted to this frame, after its detections: every assignment, exactly; then merged."""
    count, columns = len(meeting.members), len(sighting.boxes)
    unseen = meeting.unseen + 1
    spread = meeting.covariance[:, :, None, :4, :4] + sighting.variances[:, :, None] * np.eye(4)
    offset = sighting.boxes - meeting.mean[:, :, None, :4]
    d2, log_det = halves_of_d2(offset, spread)
    scale2 = rates.scale2[gap_class(unseen)][:, :, None]
    log_density = -np.sum(d2 / scale2 + log_det + np.log(scale2), axis=-1) - 2.0 * np.log(2.0 * np.pi)
    chance = np.where(unseen == 1, rates.detection, min(rates.detection, 0.5))
    gain = np.empty((len(unseen), count, columns + 1))
    gain[..., :columns] = log_density + np.log(chance)[..., None] + sighting.looks - sighting.log_else
    gain[..., :columns][d2[..., 0] / scale2[..., 0] > FAR_D2 / 2.0] = -np.inf
    gain[..., columns] = np.log1p(-chance)
    choices = assignments(count, columns)
    log = meeting.log_weight[:, None] + gain[:, np.arange(count), choices].sum(axis=-1)
    parents, picked = np.nonzero(log > log.max() + np.log(LEAST))
    order = np.argsort(-log[parents, picked], kind="stable")[: 4 * MOST_HYPOTHESES]
    parents, choice = parents[order], choices[picked[order]]
    corrected = _corrected(evolve(meeting, unseen=unseen), sighting, parents, choice)
    return _merged(evolve(corrected, log_weight=log[parents, picked[order]]))


def _corrected(meeting: Meeting, sighting: MeetingDetections, parents: Ints, choice: Ints) -> Meeting:
    """The hypotheses `parents` (K,) after the detections that `choice` (K, n) gives their members."""
    columns, count = len(sighting.boxes), len(meeting.members)
    is_given = choice < columns
    mean, covariance = meeting.mean[parents].copy(), meeting.covariance[parents].copy()
    k, i = np.nonzero(is_given)
    column = choice[k, i]
    prior, means = covariance[k, i], mean[k, i]
    spread = prior[:, :4, :4] + sighting.variances[column][:, :, None] * np.eye(4)
    gain = np.linalg.solve(spread, prior[:, :4, :]).transpose(0, 2, 1)
    mean[k, i] = means + np.einsum("kds,ks->kd", gain, sighting.boxes[column] - means[:, :4])
    posterior = prior - gain @ prior[:, :4, :]
    covariance[k, i] = (posterior + posterior.transpose(0, 2, 1)) / 2.0
    looks = np.append(sighting.looks, np.zeros((count, 1)), axis=1)[np.arange(count), choice].sum(axis=1)
    number = np.where(is_given, meeting.count + 1 + choice, MISSED)
    recent = meeting.recent[parents]
    shifted = np.concatenate([recent[..., 1:], number[..., None]], axis=-1)
    return evolve(
        meeting,
        mean=mean,
        covariance=covariance,
        looks=meeting.looks[parents] + looks,
        # A miss moves nothing: the last detections say which state it is.
        recent=np.where(is_given[..., None], shifted, recent),
        unseen=np.where(is_given, 0, meeting.unseen[parents]),
        count=meeting.count + columns,
    )


def _merged(meeting: Meeting) -> Meeting:
    """Hypotheses with the same last detections of every member as one, with the mixture's moments."""
    log_weight = _normalised(meeting.log_weight)
    key = meeting.recent.reshape(len(log_weight), -1)
    if len(key) > 1:
        _, first, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
        group = group.ravel()
    else:
        first, group = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64)
    if len(first) == len(key):
        return _fewer(evolve(meeting, log_weight=log_weight))
    weight, size = np.exp(log_weight), len(first)
    total = np.bincount(group, weight, size)
    share = weight / total[group]
    mean = np.zeros((size, *meeting.mean.shape[1:]))
    np.add.at(mean, group, share[:, None, None] * meeting.mean)
    offset = meeting.mean - mean[group]
    covariance = np.zeros((size, *meeting.covariance.shape[1:]))
    parts = meeting.covariance + offset[..., :, None] * offset[..., None, :]
    np.add.at(covariance, group, share[:, None, None, None] * parts)
    merged = evolve(
        meeting,
        mean=mean,
        covariance=covariance,
        log_weight=np.log(np.maximum(total, 1e-300)),
        looks=np.bincount(group, share * meeting.looks, size),
        recent=meeting.recent[first],
        unseen=meeting.unseen[first],
    )
    return _fewer(merged)


def _fewer(meeting: Meeting) -> Meeting:
    order = np.argsort(-meeting.log_weight, kind="stable")[:MOST_HYPOTHESES]
    return evolve(
        meeting,
        mean=meeting.mean[order],
        covariance=meeting.covariance[order],
        log_weight=_normalised(meeting.log_weight[order]),
        looks=meeting.looks[order],
        recent=meeting.recent[order],
        unseen=meeting.unseen[order],
    )


def _normalised(log: Floats) -> Floats:
    return np.asarray(log - np.logaddexp.reduce(log))


@dataclass(frozen=True, eq=False)
class Placing:
    """Assignments of the members of a meeting to tracks.

    Attributes:
        tracks: m tracks.
        members: n members.
        choices: (P, m) member of each track; n stands for none of them.
        probability: (P,) of each.
        looks: (P,) what appearance told of it, nats.
    """

    tracks: tuple[str, ...]
    members: tuple[str, ...]
    choices: Ints
    probability: Floats
    looks: Floats

    def named(self) -> list[tuple[str, ...]]:
        """Of each, the members that the tracks are; of none, the track itself or, of a member, `NEW`."""
        names = (*self.members, None)
        return [
            tuple(
                names[member] or (NEW if track in self.members else track)
                for track, member in zip(self.tracks, choice, strict=True)
            )
            for choice in self.choices.tolist()
        ]

    @property
    def shares(self) -> dict[tuple[str, ...], float]:
        """Members that the tracks are -> probability."""
        return dict(zip(self.named(), self.probability.tolist(), strict=True))


def place_tracks(meeting: Meeting, tracks: Sequence[str], mean: Floats, covariance: Floats) -> Placing:
    """The member that each of m tracks is, by where hypotheses have the members; (m, D) and (m, D, D)."""
    count, track_count = len(meeting.members), len(tracks)
    offset = mean[:, None, None, :4] - meeting.mean[None, :, :, :4]
    spread = covariance[:, None, None, :4, :4] + meeting.covariance[None, :, :, :4, :4]
    d2 = halves_of_d2(offset, spread)[0][..., 0]
    d2 = np.where(d2 < FAR_D2 / 2.0, d2, np.inf)
    cost = np.append(d2, np.full((track_count, d2.shape[1], 1), FAR_D2 / 2.0), axis=2)
    choices = assignments(track_count, count)
    log = -cost[np.arange(track_count)[:, None], :, choices.T].sum(axis=0)
    log = log - np.logaddexp.reduce(log, axis=0) + meeting.log_weight
    probability = np.exp(log).sum(axis=1)
    looks = (np.exp(log) @ meeting.looks) / np.maximum(probability, 1e-300)
    left_out = (choices == count).sum(axis=1)
    same_size = left_out == left_out[np.argmax(probability)]
    probability = (1.0 - LAPSE) * probability + LAPSE * same_size / same_size.sum()
    order = np.argsort(-probability, kind="stable")
    order = order[probability[order] > LEAST]
    share = probability[order] / probability[order].sum()
    return Placing(tuple(tracks), meeting.members, choices[order], share, looks[order])


def close_pairs(mean: Floats, spread: Floats, limit: float) -> list[tuple[int, int]]:
    """Pairs of boxes (T, 4) whose centres are closer than `limit`, in squared sds; the closest first.

    `spread` (T, 4, 4) are the covariances of what is detected of each.
    """
    order = np.argsort(mean[:, 0], kind="stable")
    x, reach = mean[order, 0], np.sqrt(limit * spread[order, 0, 0])
    # Two reaches lie at most sqrt(2) of the larger apart.
    ends = np.searchsorted(x, x + np.sqrt(2.0) * reach.max(initial=0.0), side="right")
    pairs = [np.arange(k + 1, end) for k, end in enumerate(ends.tolist())]
    first = order[np.repeat(np.arange(len(mean)), [len(some) for some in pairs])]
    second = order[np.concatenate(pairs)] if pairs else np.empty(0, dtype=np.int64)
    value = halves_of_d2(mean[first] - mean[second], spread[first] + spread[second])[0][:, 0]
    closest = np.flatnonzero(value < limit / 2.0)
    ranked = closest[np.argsort(value[closest], kind="stable")]
    return [*zip(first[ranked].tolist(), second[ranked].tolist(), strict=True)]


def spread_of_shared(meeting: Meeting, boxes: Floats) -> Floats:
    """(M, 4) further variances of boxes (M, 4) that may be around two members at once.

    Such a box holds two members of the most probable hypothesis, of which no other box holds one.
    """
    offset = np.abs(boxes[:, None, :2] - meeting.mean[0, :, :2])
    holds = (offset < boxes[:, None, 2:] / 2.0).all(axis=2)
    exclusive = holds & (holds.sum(axis=0) == 1)
    shared = exclusive.sum(axis=1) >= 2
    sides = boxes[:, [2, 3, 2, 3]]
    return np.asarray(np.where(shared[:, None], (SHARED_SD * sides) ** 2, 0.0))
