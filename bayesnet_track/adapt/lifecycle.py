"""Births, ends and duplicates of targets: records, and tentative tracks before a birth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayesnet_track.adapt.association import UNASSIGNED, Owners, distances, pair_up
from bayesnet_track.adapt.cameras import CameraErrors, Watch
from bayesnet_track.adapt.existence import DetectionModel
from bayesnet_track.graph.settings.lifecycle import Birth, Confirm, Death, MergeDuplicates
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.journal.events.joins import Refusal
from bayesnet_track.journal.target_net import Fault
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import Reference
from bayesnet_track.observation.detector import DetectorState


@dataclass(frozen=True, eq=False)
class AppearanceMemory:
    """A target as it is remembered, lost or dead.

    Attributes:
        target: target id.
        template: name of its plate.
        mean: (D,) mean state when it was last well seen.
        covariance: (D, D) of its belief then.
        time: that time, frame intervals.
        references: agent -> what it remembers.
        birth: what its draws were keyed by.
        kinds: probabilities of what it was, of a kind of target with categories.
    """

    target: str
    template: str
    mean: Floats
    covariance: Floats
    time: float
    references: Mapping[str, Reference]
    birth: str
    kinds: Floats | None = None


@dataclass(frozen=True, eq=False)
class TrackRecord:
    """Counts of a live target.

    Attributes:
        since: frame in which its net was born.
        mean: (D,) mean state when it was last well seen.
        covariance: (D, D) of its belief then.
        time: that time, frame intervals.
        lost_frames: consecutive frames in which it is lost.
        unseen_frames: consecutive frames without a detection of its own.
    """

    since: int
    mean: Floats
    covariance: Floats
    time: float
    lost_frames: int = 0
    unseen_frames: int = 0


@dataclass(frozen=True, eq=False)
class CameraBudget:
    """Settings of how cameras are switched.

    Attributes:
        per_step: declared cost that a step may take.
        undetected: root of the UD that a target which nobody detected counts as, m.
        costs: camera -> declared cost of one of its frames.
    """

    per_step: float
    undetected: float
    costs: Mapping[str, float]

    @classmethod
    def from_graph(cls, spec: GraphSpec) -> CameraBudget | None:
        """The settings of a graph; None where all cameras are on."""
        if spec.adapt is None:
            return None
        costs = {name: source.cost for name, source in spec.cameras.items()}
        return cls(spec.adapt.cost_per_step, spec.adapt.undetected_m, costs)


@dataclass(frozen=True, eq=False)
class CameraMemory:
    """Memory of which cameras were on.

    Attributes:
        cameras: those of the last step in which a camera was on, the best first.
        credit: declared cost that was saved.
        undetected: plate -> (G,) expected number of undetected targets in each cell of the ground.
    """

    cameras: tuple[str, ...] = ()
    credit: float = 0.0
    undetected: Mapping[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class TrackHistory:
    """Memory of births and deaths between frames.

    Attributes:
        detectors: detector -> its state.
        failed: detector -> its last failure.
        candidates: plate -> what was detected and is no target yet.
        records: live target -> what is counted of it.
        dead: targets whose nets ended and that can return, in the order of their deaths.
        overlaps: (younger, older) target -> overlaps of their beliefs in the last consecutive frames.
        refused: plate -> births refused so far.
        cut: detector -> frames in which it found more than `max_count`.
        last_id: largest number that was given to a target.
        births: live target -> what its draws are keyed by (`numerics.streams.birth_key`).
        detection_models: plate with `existence` -> what its detections have told about all of them.
        refusals: live target without a detection -> one beside it that no target had; None when that
            was reported.
        clocks: what is known of the clocks of cameras; None where none is learnt.
        watches: plate -> camera -> what is known of where it points.
        cameras: memory of which cameras were on, where they are switched.
    """

    detectors: Mapping[str, DetectorState] = field(default_factory=dict)
    failed: Mapping[str, Fault] = field(default_factory=dict)
    candidates: Mapping[str, tuple[Candidate, ...]] = field(default_factory=dict)
    records: Mapping[str, TrackRecord] = field(default_factory=dict)
    dead: tuple[AppearanceMemory, ...] = ()
    overlaps: Mapping[tuple[str, str], tuple[float, ...]] = field(default_factory=dict)
    refused: Mapping[str, int] = field(default_factory=dict)
    cut: Mapping[str, int] = field(default_factory=dict)
    last_id: int = 0
    births: Mapping[str, str] = field(default_factory=dict)
    detection_models: Mapping[str, DetectionModel] = field(default_factory=dict)
    refusals: Mapping[str, Refusal | None] = field(default_factory=dict)
    errors: CameraErrors | None = None
    watches: Mapping[str, Mapping[str, Watch]] = field(default_factory=dict)
    cameras: CameraMemory = field(default_factory=CameraMemory)


def find_end_cause(record: TrackRecord, rule: Death) -> tuple[str, int, int] | None:
    """The reason that ends a net: (lost or unseen, its frames, the rule's number); None when it lives on."""
    if record.lost_frames >= rule.lost_frames:
        return "lost", record.lost_frames, rule.lost_frames
    if rule.unseen_frames is not None and record.unseen_frames >= rule.unseen_frames:
        return "unseen", record.unseen_frames, rule.unseen_frames
    return None


SAME_PLACE = 0.1
"""Places this share of a box apart are one object: beliefs are widened by so much to be compared."""


def belief_overlap(mean_a: Floats, cov_a: Floats, mean_b: Floats, cov_b: Floats) -> Floats:
    """Bhattacharyya coefficient, 0..1, of two Gaussians of x, y, w, h, both widened by `SAME_PLACE` of a box.

    exp(-D), D = d' S^-1 d / 8 + ln(det S / sqrt(det S_a det S_b)) / 2, S = (S_a + S_b) / 2. Means: (..., 4)
    and covariances (..., 4, 4).

    >>> box, sure = np.array([50.0, 40, 20, 20]), np.zeros((4, 4))
    >>> round(float(belief_overlap(box, sure, box + [4, 0, 0, 0], sure)), 6)  # exp(-(4 / 2)^2 / 8)
    0.606531
    """
    box = (mean_a + mean_b) / 2
    widening = ((SAME_PLACE * box[..., [2, 3, 2, 3]]) ** 2)[..., None] * np.eye(4)
    first, second = cov_a + widening, cov_b + widening
    pooled = (first + second) / 2
    d = (mean_a - mean_b)[..., None]
    shape = np.linalg.slogdet(pooled)[1] - (np.linalg.slogdet(first)[1] + np.linalg.slogdet(second)[1]) / 2
    distance2 = (np.swapaxes(d, -1, -2) @ np.linalg.solve(pooled, d))[..., 0, 0]
    return np.asarray(np.exp(-distance2 / 8 - np.maximum(shape, 0.0) / 2))


def overlapping(
    names: Sequence[str],
    means: Floats,
    covariances: Floats,
    starts: Sequence[int],
    previous: Mapping[tuple[str, str], tuple[float, ...]],
    rule: MergeDuplicates,
) -> dict[tuple[str, str], tuple[float, ...]]:
    """(younger, older) -> overlaps of their beliefs in the last frames; means (T, 4), covariances (T, 4, 4).

    No more than `rule.frames` of them; only pairs that overlap by `rule.overlap` in this frame. Of those born
    in one frame the later named is the younger. Targets whose centres lie a box apart are not compared.
    """
    first, second = near_pairs(means, covariances, rule.overlap)
    if not len(first):
        return {}
    values = belief_overlap(means[first], covariances[first], means[second], covariances[second])
    streaks = {}
    for pair in np.flatnonzero(values >= rule.overlap).tolist():
        i, j, value = int(first[pair]), int(second[pair]), float(values[pair])
        older, younger = (names[k] for k in sorted((i, j), key=lambda k: (starts[k], k)))
        streak = (*previous.get((younger, older), ()), value)
        streaks[younger, older] = streak[-rule.frames :]
    return streaks


def near_pairs(boxes: Floats, covariances: Floats, min_overlap: float = 0.0) -> tuple[Owners, Owners]:
    """Rows i < j (P,) of centre boxes (T, 4) whose centres lie less than a box apart, in order.

    Left out are those whose fields, each alone, rule out an overlap of `min_overlap`: cheap, and leaves few.

    >>> near_pairs(np.array([[0.0, 0, 4, 4], [9, 0, 4, 4], [3, 0, 4, 4]]), np.zeros((3, 4, 4)))
    (array([0]), array([2]))
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.kernels.box_kernels import pairs_alike

    order, sides = np.argsort(boxes[:, 0], kind="stable"), np.sqrt(boxes[:, 2] * boxes[:, 3])
    variances = plain(np.diagonal(covariances, axis1=1, axis2=2))
    limit = -8.0 * np.log(min_overlap) * (1.0 + 1e-9) if min_overlap > 0.0 else np.inf
    ends = pairs_alike(plain(boxes), sides, variances, order, limit, SAME_PLACE)
    if not len(ends[0]):
        return ends
    low, high = np.minimum(*ends), np.maximum(*ends)
    distance = np.hypot(boxes[low, 0] - boxes[high, 0], boxes[low, 1] - boxes[high, 1])
    is_near = distance / ((sides[low] + sides[high]) / 2) < 1.0
    low, high = low[is_near], high[is_near]
    by_rows = np.lexsort((high, low))
    return low[by_rows], high[by_rows]


FOLLOW_BOX = 1.0
"""How far from where it is expected a candidate is looked for, in box sides."""

ALONE_BOX = 3.5
"""The same after its first detection, where neither another candidate nor another detection is so near."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Something detected that is no target yet.

    Attributes:
        box: (4,) centre box where it was last detected, or is expected since.
        step: (2,) its centre's last displacement per look, px.
        looks: for each of the last looks, its score there, or None when it was not seen.
        first_frame: frame in which it was first detected.
        birth: what its draws are keyed by once it is a target: its first detection.
        mean: (D,) of its belief, where the plate has `existence` or tentative tracks.
        covariance: (D, D) of its belief.
        existence: probability that it exists.
        observed: (H,) what is remembered of the detections of a tentative track (`adapt.association`).
        is_far: whether its first two detections are more than `FOLLOW_BOX` apart.
        track: its detections in the looks that count, in order: time (frame intervals) and centre box (4,).
        labels: (V,) log-likelihood of the labels of its detections by the value of what it is; None where
            labels are no evidence.
    """

    box: Floats
    step: Floats
    looks: tuple[float | None, ...]
    first_frame: int
    birth: str
    mean: Floats | None = None
    covariance: Floats | None = None
    existence: float | None = None
    observed: Floats | None = None
    track: tuple[tuple[float, Floats], ...] = ()
    is_far: bool = False
    labels: Floats | None = None

    def told(self, labels: Floats) -> Candidate:
        """The same after a detection with a label of these log-likelihoods (V,)."""
        return evolve(self, labels=labels if self.labels is None else self.labels + labels)

    @property
    def seen(self) -> int:
        """In how many of its looks it was seen."""
        return sum(score is not None for score in self.looks)

    @property
    def score(self) -> float:
        """Mean score of the looks in which it was seen."""
        scores = [score for score in self.looks if score is not None]
        return sum(scores) / len(scores)


@dataclass(frozen=True, eq=False)
class FreeDetections:
    """Detections of a frame that are no live target's, the best first.

    Attributes:
        boxes: (N, 4) centre boxes.
        scores: (N,).
        births: what the draws of each are keyed by if it is the first of a target.
        frame: index of the frame.
        time: its time, frame intervals.
        alone_box: how far from its first detection a candidate is looked for that is alone, in box sides.
        labels: (N, V) log-likelihoods of their labels; None where labels are no evidence.
    """

    boxes: Floats
    scores: Floats
    births: Sequence[str]
    frame: int
    time: float
    alone_box: float = 0.0
    labels: Floats | None = None

    def label_of(self, candidate: Candidate, row: int) -> Candidate:
        """The candidate with what the label of a detection says."""
        return candidate if self.labels is None else candidate.told(self.labels[row])


def feed(candidates: Sequence[Candidate], free: FreeDetections, rule: Birth) -> tuple[Candidate, ...]:
    """The candidates after a look at the free detections.

    A candidate goes on with the nearest box within `FOLLOW_BOX` of where it is expected, or with the one box
    within `free.alone_box` of its only detection, if that is near no other candidate. One that was missed
    too often to be confirmed by the looks it has left is dropped. No more than twice `rule.max_targets` (and
    8) are kept: those seen most often, then those with the best scores.
    """
    confirm = rule.confirm
    expected = np.array([candidate.box for candidate in candidates]).reshape(-1, 4)
    expected[:, :2] += np.array([candidate.step for candidate in candidates]).reshape(-1, 2)
    nearest, distant = _follow(candidates, expected, free)
    owner = np.maximum(nearest, distant)
    matches = {k: row for row, k in enumerate(owner.tolist()) if k != UNASSIGNED}
    scores, is_near = free.scores.tolist(), (distant == UNASSIGNED).tolist()
    updated = []
    for number, candidate in enumerate(candidates):
        row = matches.get(number)
        looks = (*candidate.looks, None if row is None else scores[row])[-confirm.of :]
        if row is None:
            if not _is_hopeless(looks, confirm):
                updated.append(evolve(candidate, box=expected[number].copy(), looks=looks))
            continue
        box, is_far = free.boxes[row].copy(), candidate.is_far or not is_near[row]
        track = (*candidate.track, (free.time, box))[-confirm.of :]
        step = box[:2] - candidate.box[:2]
        followed = evolve(candidate, looks=looks, box=box, step=step, track=track, is_far=is_far)
        updated.append(free.label_of(followed, row))
    first = Candidate(np.empty(4), np.zeros(2), (), free.frame, "")
    # A detection far from a candidate may be another's first.
    for index in np.flatnonzero(nearest == UNASSIGNED).tolist():
        box = free.boxes[index].copy()
        candidate = evolve(
            first, box=box, looks=(scores[index],), birth=free.births[index], track=((free.time, box),)
        )
        updated.append(free.label_of(candidate, index))
    return keep_candidates(updated, rule)


def _follow(candidates: Sequence[Candidate], expected: Floats, free: FreeDetections) -> tuple[Owners, Owners]:
    """(N,) the candidate that each detection goes on with, or `UNASSIGNED`; and those that are far away.

    Candidates are looked for where they are `expected`, centre boxes (C, 4).
    """
    gaps = distances(free.boxes, expected)
    owner = pair_up(gaps, np.full(gaps.shape, FOLLOW_BOX))
    distant = np.full_like(owner, UNASSIGNED)
    is_near = gaps <= free.alone_box
    is_alone = is_near & (is_near.sum(axis=0) == 1) & (is_near.sum(axis=1, keepdims=True) == 1)
    for row, column in np.argwhere(is_alone).tolist():
        if owner[row] == UNASSIGNED and len(candidates[column].track) == 1:
            distant[row] = column
    return owner, distant


def look_again(
    candidate: Candidate, box: Floats | None, score: float | None, confirm: Confirm
) -> Candidate | None:
    """A tentative track after a look: seen in the centre box (4,) or not; None when it is given up."""
    looks = (*candidate.looks, score)[-confirm.of :]
    if _is_hopeless(looks, confirm):
        return None
    if box is None:
        return evolve(candidate, looks=looks)
    return evolve(candidate, looks=looks, box=box.copy(), step=box[:2] - candidate.box[:2])


def keep_candidates(candidates: Sequence[Candidate], rule: Birth) -> tuple[Candidate, ...]:
    """No more than twice `rule.max_targets` (and 8): those seen most often, then those of the best scores."""
    limit = max(2 * rule.max_targets, 8)
    if len(candidates) <= limit:
        return tuple(candidates)
    ranked = sorted(range(len(candidates)), key=lambda k: (-candidates[k].seen, -candidates[k].score, k))
    selected = sorted(ranked[:limit])
    return tuple(candidates[k] for k in selected)


def is_confirmed(candidate: Candidate, confirm: Confirm) -> bool:
    """True when it is seen now and was often enough."""
    return candidate.looks[-1] is not None and candidate.seen >= confirm.hits


def _is_hopeless(looks: Sequence[float | None], confirm: Confirm) -> bool:
    """True after so many misses on end that no look it has had can count toward a confirmation."""
    misses = 0
    for score in reversed(looks):
        if score is not None:
            break
        misses += 1
    return misses > confirm.of - confirm.hits


def is_refusal_notable(previous: int, count: int) -> bool:
    """True when the number of refused births has reached 1, 10, 100, ... since it was `previous`."""
    level = 1
    while level <= previous:
        level *= 10
    return count >= level
