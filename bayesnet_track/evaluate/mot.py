"""Scores of several targets at once, and by class: MOTA, IDF1, HOTA, GOSPA and OSPA(2), with their parts."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from bayesnet_track.evaluate.gospa import (
    CUTOFF_PX,
    ORDER,
    frames_gospa,
    ospa2_of,
    tracks_apart,
    trajectory_gospa,
)
from bayesnet_track.evaluate.paired_boxes import FramePairs, Measure, measured, single_figure
from bayesnet_track.evaluate.scores import meanings
from bayesnet_track.evaluate.truth import EPSILON, Pairs, Tracks, assign, class_names, pair, read_pair
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.boxes import centre_from_corner, overlap

LEAST_IOU = 0.5
KEPT = 1000.0
"""What a pair of the frame before is worth more: beyond any sum of overlaps in a frame."""
UNASSIGNED = -1


@dataclass(frozen=True)
class ClearMot:
    """Counts over a sequence.

    Attributes:
        tp: true boxes with a track.
        fn: true boxes without one.
        fp: tracked boxes without a true one.
        idsw: identity switches: true boxes with another track than the last that their target had.
        iou_sum: overlaps of the matched pairs, summed.
    """

    tp: int
    fn: int
    fp: int
    idsw: int
    iou_sum: float

    @property
    def mota(self) -> float:
        """1 - (FN + FP + IDSW) / true boxes; at most 1, and below 0 when there are more errors than boxes."""
        return 1.0 - (self.fn + self.fp + self.idsw) / (self.tp + self.fn)

    @property
    def motp(self) -> float:
        """Mean overlap of the matched pairs, 0 when there is none."""
        return self.iou_sum / self.tp if self.tp else 0.0


def clear_mot(pairs: Pairs, min_iou: float = LEAST_IOU) -> ClearMot:
    """CLEAR MOT of a sequence with true boxes.

    In each frame boxes are matched one to one where they overlap by at least `min_iou`: a pair that was
    matched in the frame before stays matched, the rest so that the sum of overlaps is largest.
    """
    return single_figure(pairs.frames, _clear_mot(pairs, min_iou))


def _clear_mot(pairs: Pairs, min_iou: float = LEAST_IOU) -> Measure[ClearMot]:
    previous_match = np.full(len(pairs.true_boxes), UNASSIGNED, dtype=np.int64)
    earlier = previous_match.copy()
    tp, idsw, iou_sum = 0, 0, 0.0
    while (frame := (yield)) is not None:
        if not frame.iou.size:
            continue  # such a frame parts nobody: a correspondence holds until there is evidence against it
        rows, columns = _match(frame, earlier, min_iou)
        true, tracked = frame.true[rows], frame.tracked[columns]
        idsw += int(((previous_match[true] != UNASSIGNED) & (previous_match[true] != tracked)).sum())
        previous_match[true] = tracked
        earlier = np.full_like(earlier, UNASSIGNED)
        earlier[true] = tracked
        tp += len(rows)
        iou_sum += float(frame.iou[rows, columns].sum())
    return ClearMot(tp, int(pairs.true_boxes.sum()) - tp, int(pairs.tracked_boxes.sum()) - tp, idsw, iou_sum)


def _match(frame: FramePairs, earlier: Ints, min_iou: float) -> tuple[Ints, Ints]:
    continued = earlier[frame.true][:, None] == frame.tracked[None, :]
    overlapping = frame.iou >= min_iou - EPSILON
    return assign(np.where(overlapping, KEPT * continued + frame.iou, 0.0))


ALPHAS = np.arange(0.05, 0.99, 0.05)
"""The 19 thresholds 0.05, 0.1 .. 0.95."""


@dataclass(frozen=True, eq=False)
class Hota:
    """The curves over `ALPHAS`; each figure of a sequence is the mean of its curve.

    Attributes:
        tp: (19,) matched pairs.
        fn: (19,) true boxes without a match.
        fp: (19,) tracked boxes without a match.
        assa: (19,) association accuracy; 0 without a match.
        loca: (19,) mean overlap of the matched pairs; 1 without a match.
    """

    tp: Ints
    fn: Ints
    fp: Ints
    assa: Floats
    loca: Floats

    @property
    def deta(self) -> Floats:
        """(19,) detection accuracy TP / (TP + FN + FP)."""
        return np.asarray(self.tp / (self.tp + self.fn + self.fp), dtype=np.float64)

    @property
    def hota(self) -> Floats:
        """(19,) sqrt(DetA AssA)."""
        return np.asarray(np.sqrt(self.deta * self.assa), dtype=np.float64)


def hota(pairs: Pairs) -> Hota:
    """HOTA of a sequence with true boxes.

    In each frame boxes are matched one to one so that the sum of overlap times alignment is largest, where
    the alignment of a target and a track says how well they agree over the whole sequence; a matched pair
    counts for every alpha that its overlap reaches. AssA is the mean over the matched pairs c of
    TPA(c) / (TPA(c) + FNA(c) + FPA(c)): of the boxes of its target or its track, the share where both match.
    """
    return _hota(pairs, single_figure(pairs.frames, _alignment(pairs)))


def _hota(pairs: Pairs, alignment: Floats) -> Hota:
    both_sizes = pairs.true_boxes[:, None] + pairs.tracked_boxes[None, :]
    matches = np.zeros((len(ALPHAS), *both_sizes.shape), dtype=np.int32)
    iou_sum = np.zeros(len(ALPHAS))
    for frame in pairs.frames:
        rows, columns = assign(alignment[np.ix_(frame.true, frame.tracked)] * frame.iou)
        iou = frame.iou[rows, columns]
        reached = iou >= ALPHAS[:, None] - EPSILON
        matches[:, frame.true[rows], frame.tracked[columns]] += reached
        iou_sum += reached @ iou
    tp = matches.sum(axis=(1, 2))
    shares = np.array([(count * (count / (both_sizes - count))).sum() for count in matches])
    return Hota(
        tp=tp,
        fn=pairs.true_boxes.sum() - tp,
        fp=pairs.tracked_boxes.sum() - tp,
        assa=shares / np.maximum(tp, 1),
        loca=np.where(tp > 0, iou_sum / np.maximum(tp, 1), 1.0),
    )


def _alignment(pairs: Pairs) -> Measure[Floats]:
    """(targets, tracks) Jaccard alignment; in a frame a pair counts by its share of both's overlaps."""
    both_sizes = pairs.true_boxes[:, None] + pairs.tracked_boxes[None, :]
    shared = np.zeros(both_sizes.shape)
    while (frame := (yield)) is not None:
        i, j = np.nonzero(frame.iou)
        iou = frame.iou[i, j]
        all_of_both = frame.iou.sum(axis=0)[j] + frame.iou.sum(axis=1)[i] - iou
        shared[frame.true[i], frame.tracked[j]] += iou / np.maximum(all_of_both, EPSILON)
    return np.asarray(shared / (both_sizes - shared), dtype=np.float64)


@dataclass(frozen=True)
class MotScore:
    """Scores of several targets. Shares are 0..1, MOTA at most 1.

    Attributes:
        frames: number up to the last with a box, true or tracked.
        true_ids: true targets.
        true_boxes: their boxes.
        track_ids: tracks.
        track_boxes: their boxes.
        mota: accuracy by CLEAR MOT at IoU 0.5.
        motp: mean IoU of the pairs it matches; 0 when it matches none.
        fp: tracked boxes without a true one.
        fn: true boxes without a tracked one.
        idsw: identity switches.
        idf1: identity score at IoU 0.5.
        idp: its precision.
        idr: its recall.
        hota: mean of its curve, as are
        deta: detection accuracy,
        assa: association accuracy,
        loca: localisation accuracy.
        cutoff_px: cut-off c of all figures from here to `tgospa_switch`, in px of box centres.
        gospa: root mean square of the frames' GOSPA, p = 2, alpha = 2, px.
        gospa_loc: its part from the distances of matched boxes; the squares of the three parts add up.
        gospa_missed: its part from missed targets.
        gospa_false: its part from false tracks.
        ospa2: OSPA(2) over the whole sequence, p = 2, px.
        tgospa: trajectory GOSPA in the units of `gospa`; None unless it is asked for.
        tgospa_switch: its part from switches.
        alphas: thresholds of IoU of the curves.
        hota_at: HOTA at each.
        deta_at: DetA at each.
        assa_at: AssA at each; 0 where nothing matches.
        loca_at: LocA at each; 1 where nothing matches.
    """

    frames: Annotated[int, "up to the last that has a box"]
    true_ids: Annotated[int, "targets"]
    true_boxes: Annotated[int, "their boxes"]
    track_ids: Annotated[int, "tracks"]
    track_boxes: Annotated[int, "their boxes"]
    mota: Annotated[float, "1 - (fn + fp + idsw) / true boxes"]
    motp: Annotated[float, "mean IoU of the matched boxes"]
    fp: Annotated[int, "tracked boxes that match no true one"]
    fn: Annotated[int, "true boxes that no tracked one matches"]
    idsw: Annotated[int, "identity switches"]
    idf1: Annotated[float, "2 x boxes on the target's own track / all boxes, true and tracked"]
    idp: Annotated[float, "share of the tracked boxes that are on their own target"]
    idr: Annotated[float, "share of the true boxes that are on their own track"]
    hota: Annotated[float, "sqrt(deta x assa), mean over IoU from .05, .1 .. .95, as are the three below"]
    deta: Annotated[float, "detection: matched / (matched + missed + false)"]
    assa: Annotated[float, "association: how much of its target and its track a matched pair has in common"]
    loca: Annotated[float, "mean IoU of the matched boxes"]
    cutoff_px: Annotated[
        float, "px: c of the figures below, the distance of box centres from which on none match"
    ]
    gospa: Annotated[
        float, "px: root mean square GOSPA of the frames, p = 2, alpha = 2; squares of its parts add up"
    ]
    gospa_loc: Annotated[float, "px: its part from distances of matched boxes"]
    gospa_missed: Annotated[float, "px: its part from missed targets"]
    gospa_false: Annotated[float, "px: its part from false tracks"]
    ospa2: Annotated[float, "px, 0 to c: OSPA(2) of whole trajectories (p = 2)"]
    tgospa: Annotated[
        float | None,
        "px: GOSPA of whole trajectories; like gospa, and a switch costs as much as a missed box",
    ]
    tgospa_switch: Annotated[float | None, "px: its part from switches"]
    alphas: tuple[float, ...]
    hota_at: tuple[float, ...]
    deta_at: tuple[float, ...]
    assa_at: tuple[float, ...]
    loca_at: tuple[float, ...]

    def text(self, explained: bool = False) -> str:
        """One figure a line, the curves left out: its name and value, and with `explained` what it says."""
        lines = []
        for name, meaning in meanings(MotScore).items():
            value = getattr(self, name)
            if value is None:
                continue
            line = f"{name:<14} {value if isinstance(value, int) else format(value, '.4f')}"
            lines.append(f"{line:<26} {meaning}" if explained else line)
        return "\n".join(lines)

    def json(self) -> str:
        """One JSON object, keys in the order of the class."""
        return json.dumps(asdict(self))


def score_mot(
    truth: Tracks, tracks: Tracks, cutoff_px: float = CUTOFF_PX, trajectories: bool = False
) -> MotScore:
    """Scores of tracks against the truth; every frame counts, also those that only one of the two has.

    Args:
        truth: the true boxes.
        tracks: the tracked ones.
        cutoff_px: cut-off c of GOSPA and OSPA(2).
        trajectories: also solve for trajectory GOSPA, which takes long where many cross.

    Raises:
        ValueError: the truth has no box, or a cut-off of 0 or less.
    """
    if not len(truth):
        raise ValueError("the truth has no box")
    pairs = pair(truth, tracks)
    sizes = cutoff_px, ORDER
    of_sets = frames_gospa(pairs, *sizes), tracks_apart(pairs, cutoff_px)
    measures = _clear_mot(pairs), _identity(pairs), _alignment(pairs), *of_sets
    clear, identities, alignment, sets, distances = measured(pairs.frames, *measures)
    higher = _hota(pairs, alignment)
    trajectory = trajectory_gospa(pairs, cutoff_px, ORDER) if trajectories else None
    return MotScore(
        frames=pairs.length,
        true_ids=len(pairs.true_boxes),
        true_boxes=len(truth),
        track_ids=len(pairs.tracked_boxes),
        track_boxes=len(tracks),
        mota=clear.mota,
        motp=clear.motp,
        fp=clear.fp,
        fn=clear.fn,
        idsw=clear.idsw,
        idf1=identities.idf1,
        idp=identities.idp,
        idr=identities.idr,
        hota=float(higher.hota.mean()),
        deta=float(higher.deta.mean()),
        assa=float(higher.assa.mean()),
        loca=float(higher.loca.mean()),
        cutoff_px=cutoff_px,
        gospa=sets.total_px,
        gospa_loc=sets.localisation_px,
        gospa_missed=sets.missed_px,
        gospa_false=sets.false_px,
        ospa2=ospa2_of(distances, *sizes),
        tgospa=None if trajectory is None else trajectory.total_px,
        tgospa_switch=None if trajectory is None else trajectory.switches_px,
        alphas=tuple(np.round(ALPHAS, 2).tolist()),
        hota_at=tuple(higher.hota.tolist()),
        deta_at=tuple(higher.deta.tolist()),
        assa_at=tuple(higher.assa.tolist()),
        loca_at=tuple(higher.loca.tolist()),
    )


def score_mot_files(
    tracks_path: str | Path,
    truth_path: str | Path,
    cutoff_px: float = CUTOFF_PX,
    trajectories: bool = False,
    frames: Collection[int] | None = None,
) -> MotScore:
    """Scores of a tracks file against a ground-truth file, both MOT; see `score_mot`.

    With `frames` only these count, as of a run that read every few frames of its source.

    Raises:
        OSError: a file cannot be read.
        ValueError: a malformed file; says file and line.
    """
    return score_mot(*read_pair(tracks_path, truth_path, frames), cutoff_px, trajectories)


@dataclass(frozen=True)
class Identity:
    """Counts over a sequence.

    Attributes:
        idtp: true boxes that overlap the box of their target's own track.
        idfn: the other true boxes.
        idfp: the other tracked boxes.
    """

    idtp: int
    idfn: int
    idfp: int

    @property
    def idf1(self) -> float:
        """2 IDTP / (true boxes + tracked boxes)."""
        return 2 * self.idtp / (2 * self.idtp + self.idfn + self.idfp)

    @property
    def idp(self) -> float:
        """IDTP / tracked boxes; 0 when there is none."""
        return self.idtp / max(self.idtp + self.idfp, 1)

    @property
    def idr(self) -> float:
        """IDTP / true boxes."""
        return self.idtp / (self.idtp + self.idfn)


def identity(pairs: Pairs, min_iou: float = LEAST_IOU) -> Identity:
    """Identity scores of a sequence with true boxes.

    Whole tracks are assigned to whole targets, one to one, so that most of their boxes overlap by at least
    `min_iou`. (The published cost, IDFN + IDFP, is the number of all boxes less twice IDTP.)
    """
    return single_figure(pairs.frames, _identity(pairs, min_iou))


def _identity(pairs: Pairs, min_iou: float = LEAST_IOU) -> Measure[Identity]:
    together = np.zeros((len(pairs.true_boxes), len(pairs.tracked_boxes)))
    while (frame := (yield)) is not None:
        i, j = np.nonzero(frame.iou >= min_iou)
        together[frame.true[i], frame.tracked[j]] += 1
    idtp = int(together[assign(together)].sum())
    return Identity(idtp, int(pairs.true_boxes.sum()) - idtp, int(pairs.tracked_boxes.sum()) - idtp)


MATCHED_IOU = 0.5
COLUMNS = ("true_ids", "true_boxes", "mota", "idf1", "hota", "fp", "fn", "idsw")
"""Of the table."""


def of_classes(truth: Tracks, tracks: Tracks, classes: Collection[str]) -> tuple[Tracks, Tracks]:
    """The true and the tracked boxes of some classes.

    Tracked boxes without classes, or with none of the ground truth's, are those of all but the ones that
    match a true box of another class in their frame (IoU 0.5 or more): those are neither right nor false.

    Raises:
        ValueError: the ground truth has no classes, or not one of these.
    """
    present = class_names(truth)
    missing = [name for name in classes if name not in present]
    if missing or truth.classes is None:
        class_text = f"it has {', '.join(present)}" if present else "its boxes have no class"
        raise ValueError(f"class {missing[0] if missing else ''!r} is not in the ground truth; {class_text}")
    mine = np.isin(truth.classes, list(classes))
    if tracks.classes is not None and set(class_names(tracks)) & set(present):
        return truth.only(mine), tracks.only(np.isin(tracks.classes, list(classes)))
    return truth.only(mine), tracks.only(~_on_others(truth, mine, tracks))


def _on_others(truth: Tracks, mine: np.ndarray, tracks: Tracks) -> np.ndarray:
    """(N,) whether tracked boxes match true ones without `mine`."""
    on_other = np.zeros(len(tracks), dtype=np.bool_)
    centres, tracked = centre_from_corner(truth.boxes), centre_from_corner(tracks.boxes)
    for frame in np.intersect1d(truth.frames[~mine], tracks.frames):
        rows, columns = np.flatnonzero(truth.frames == frame), np.flatnonzero(tracks.frames == frame)
        iou = overlap(centres[rows][:, None], tracked[columns][None])
        reached = np.where(iou >= MATCHED_IOU - EPSILON, iou, 0.0)
        for i, j in zip(*assign(reached), strict=True):
            on_other[columns[j]] = reached[i, j] > 0 and not mine[rows[i]]
    return on_other


def score_classes(
    truth: Tracks,
    tracks: Tracks,
    classes: Collection[str] = (),
    cutoff_px: float = CUTOFF_PX,
    trajectories: bool = False,
) -> dict[str, MotScore]:
    """Scores of each class by itself, of all in the ground truth where none are named; see `of_classes`.

    Raises:
        ValueError: as `of_classes` and `score_mot`.
    """
    return {
        name: score_mot(*of_classes(truth, tracks, [name]), cutoff_px, trajectories)
        for name in classes or class_names(truth)
    }


def class_table(scores: Mapping[str, MotScore]) -> str:
    """A line for each class, under a line of names."""
    width = max(len(name) for name in (*scores, "class"))
    lines = [f"{'class':<{width}} " + " ".join(f"{name:>10}" for name in COLUMNS)]
    for name, class_score in scores.items():
        values = [getattr(class_score, column) for column in COLUMNS]
        cells = [f"{value:>10}" if isinstance(value, int) else f"{value:>10.4f}" for value in values]
        lines.append(f"{name:<{width}} " + " ".join(cells))
    return "\n".join(lines)
