"""Identity metrics of several targets: CLEAR MOT and HOTA."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.evaluate.truth import EPSILON, FramePairs, Pairs, assign
from bayesnet_track.numerics.arrays import Floats, Ints

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
    previous_match = np.full(len(pairs.true_boxes), UNASSIGNED, dtype=np.int64)
    earlier = previous_match.copy()
    tp, idsw, iou_sum = 0, 0, 0.0
    for frame in pairs.frames:
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
    rows, columns = assign(np.where(overlapping, KEPT * continued + frame.iou, 0.0))
    matched = overlapping[rows, columns]
    return rows[matched], columns[matched]


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
    both_sizes = pairs.true_boxes[:, None] + pairs.tracked_boxes[None, :]
    alignment = _alignment(pairs, both_sizes)
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


def _alignment(pairs: Pairs, both_sizes: Ints) -> Floats:
    """(targets, tracks) Jaccard alignment; in a frame a pair counts by its share of both's overlaps."""
    shared = np.zeros(both_sizes.shape)
    for frame in pairs.frames:
        iou = frame.iou
        all_of_both = iou.sum(axis=0)[None, :] + iou.sum(axis=1)[:, None] - iou
        part = np.divide(iou, all_of_both, out=np.zeros_like(iou), where=all_of_both > EPSILON)
        shared[np.ix_(frame.true, frame.tracked)] += part
    return np.asarray(shared / (both_sizes - shared), dtype=np.float64)
