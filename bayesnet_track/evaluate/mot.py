"""Scores of several targets at once, and by class: MOTA, IDF1, HOTA, GOSPA and OSPA(2), with their parts."""

from __future__ import annotations

import json
from collections.abc import Collection
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
from bayesnet_track.evaluate.paired_boxes import (
    UNASSIGNED,
    BoxPairs,
    Measure,
    assign_gains,
    continued_matches,
    measured_blocks,
    single_figure,
)
from bayesnet_track.evaluate.scores import meanings
from bayesnet_track.evaluate.truth import (
    EPSILON,
    Tracks,
    assign_rows,
    class_names,
    of_classes,
    pair,
    read_pair,
)
from bayesnet_track.numerics.arrays import Floats, Ints

LEAST_IOU = 0.5


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


def clear_mot(pairs: BoxPairs, min_iou: float = LEAST_IOU) -> ClearMot:
    """CLEAR MOT of a sequence with true boxes.

    In each frame boxes are matched one to one where they overlap by at least `min_iou`: a pair that was
    matched in the frame before stays matched, the rest so that the sum of overlaps is largest.
    """
    return single_figure(pairs.blocks, _clear_mot(pairs, min_iou))


def _clear_mot(pairs: BoxPairs, min_iou: float = LEAST_IOU) -> Measure[ClearMot]:
    previous_match = np.full(len(pairs.true_boxes), UNASSIGNED, dtype=np.int64)
    earlier = previous_match.copy()
    tp, idsw, iou_sum = 0, 0, 0.0
    while (block := (yield)) is not None:
        rows, columns, iou = block.overlapping
        reached = iou >= min_iou - EPSILON
        edges = rows[reached], columns[reached], iou[reached]
        match = continued_matches(block, edges, earlier)
        matched = np.flatnonzero(match != UNASSIGNED)
        matched = matched[np.argsort(block.true[matched], kind="stable")]  # each target's in a row
        true, tracked = block.true[matched], block.tracked[match[matched]]
        is_first = np.append(True, true[1:] != true[:-1])[: len(true)]
        previous = np.where(is_first, previous_match[true], np.roll(tracked, 1))
        idsw += int(((previous != UNASSIGNED) & (previous != tracked)).sum())
        previous_match[true] = tracked  # the last of each target's
        tp += len(matched)
        iou_sum += float(edges[2][match[edges[0]] == edges[1]].sum())
    return ClearMot(tp, int(pairs.true_boxes.sum()) - tp, int(pairs.tracked_boxes.sum()) - tp, idsw, iou_sum)


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


def hota(pairs: BoxPairs) -> Hota:
    """HOTA of a sequence with true boxes.

    In each frame boxes are matched one to one so that the sum of overlap times alignment is largest, where
    the alignment of a target and a track says how well they agree over the whole sequence; a matched pair
    counts for every alpha that its overlap reaches. AssA is the mean over the matched pairs c of
    TPA(c) / (TPA(c) + FNA(c) + FPA(c)): of the boxes of its target or its track, the share where both match.
    """
    return _hota(pairs, single_figure(pairs.blocks, _alignment(pairs)))


def _hota(pairs: BoxPairs, alignment: Floats) -> Hota:
    size, width = len(ALPHAS) + 1, max(len(pairs.tracked_boxes), 1)
    codes, code_counts, level_iou = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], np.zeros(size)
    for block in pairs.blocks:
        rows, columns, iou = block.overlapping
        true, tracked = block.true[rows].astype(np.int64), block.tracked[columns]
        places = assign_gains(rows, columns, alignment[true, tracked] * iou)
        level = np.searchsorted(ALPHAS - EPSILON, iou[places], side="right")  # thresholds that are reached
        block_codes, counts = np.unique(
            (true[places] * width + tracked[places]) * size + level, return_counts=True
        )
        codes.append(block_codes)
        code_counts.append(counts)
        level_iou += np.bincount(level, iou[places], size)
    keys, level = np.divmod(np.concatenate(codes), size)
    pair_keys, pair_places = np.unique(keys, return_inverse=True)
    counts = np.zeros((len(pair_keys), size), dtype=np.int64)
    np.add.at(counts, (pair_places, level), np.concatenate(code_counts))
    matches = _at_least(counts)
    true, tracked = np.divmod(pair_keys, width)
    both_sizes = (pairs.true_boxes[true] + pairs.tracked_boxes[tracked])[:, None]
    tp, shares = matches.sum(axis=0), (matches * (matches / (both_sizes - matches))).sum(axis=0)
    iou_sum = _at_least(level_iou[None])[0]
    return Hota(
        tp=tp,
        fn=pairs.true_boxes.sum() - tp,
        fp=pairs.tracked_boxes.sum() - tp,
        assa=shares / np.maximum(tp, 1),
        loca=np.where(tp > 0, iou_sum / np.maximum(tp, 1), 1.0),
    )


def _at_least(of_levels: np.ndarray) -> np.ndarray:
    """(n, 19) sums over the levels from each alpha on, of (n, 20) by the number of alphas reached."""
    return np.cumsum(of_levels[:, :0:-1], axis=1)[:, ::-1]


def _alignment(pairs: BoxPairs) -> Measure[Floats]:
    """(targets, tracks) Jaccard alignment; in a frame a pair counts by its share of both's overlaps."""
    both_sizes = pairs.true_boxes[:, None] + pairs.tracked_boxes[None, :]
    shared = np.zeros(both_sizes.shape)
    while (block := (yield)) is not None:
        i, j, iou = block.overlapping
        all_of_both = np.bincount(i, iou)[i] + np.bincount(j, iou)[j] - iou if len(i) else iou
        np.add.at(shared, (block.true[i], block.tracked[j]), iou / np.maximum(all_of_both, EPSILON))
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
    clear, identities, alignment, sets, distances = measured_blocks(pairs.blocks, *measures)
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
class IdentityCounts:
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


def identity(pairs: BoxPairs, min_iou: float = LEAST_IOU) -> IdentityCounts:
    """Identity scores of a sequence with true boxes.

    Whole tracks are assigned to whole targets, one to one, so that most of their boxes overlap by at least
    `min_iou`. (The published cost, IDFN + IDFP, is the number of all boxes less twice IDTP.)
    """
    return single_figure(pairs.blocks, _identity(pairs, min_iou))


def _identity(pairs: BoxPairs, min_iou: float = LEAST_IOU) -> Measure[IdentityCounts]:
    together = np.zeros((len(pairs.true_boxes), len(pairs.tracked_boxes)))
    while (block := (yield)) is not None:
        rows, columns, iou = block.overlapping
        i, j = rows[iou >= min_iou], columns[iou >= min_iou]
        np.add.at(together, (block.true[i], block.tracked[j]), 1)
    idtp = int(together[assign_rows(together)].sum())
    return IdentityCounts(idtp, int(pairs.true_boxes.sum()) - idtp, int(pairs.tracked_boxes.sum()) - idtp)


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
