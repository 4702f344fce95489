"""CLEAR MOT (Bernardin & Stiefelhagen 2008): misses, false positives, identity switches; MOTA and MOTP."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.evaluate.mot_pairs import EPSILON, FramePairs, Pairs, assign
from bayesnet_track.numerics.arrays import Ints

LEAST_IOU = 0.5
KEPT = 1000.0
"""What a pair of the frame before is worth more: beyond any sum of overlaps in a frame."""
NOBODY = -1


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
    last = np.full(len(pairs.true_boxes), NOBODY, dtype=np.int64)
    before = last.copy()
    tp, idsw, iou_sum = 0, 0, 0.0
    for frame in pairs.frames:
        if not frame.iou.size:
            continue  # such a frame parts nobody: a correspondence holds until there is evidence against it
        rows, columns = _match(frame, before, min_iou)
        true, tracked = frame.true[rows], frame.tracked[columns]
        idsw += int(((last[true] != NOBODY) & (last[true] != tracked)).sum())
        last[true] = tracked
        before = np.full_like(before, NOBODY)
        before[true] = tracked
        tp += len(rows)
        iou_sum += float(frame.iou[rows, columns].sum())
    return ClearMot(tp, int(pairs.true_boxes.sum()) - tp, int(pairs.tracked_boxes.sum()) - tp, idsw, iou_sum)


def _match(frame: FramePairs, before: Ints, min_iou: float) -> tuple[Ints, Ints]:
    kept = before[frame.true][:, None] == frame.tracked[None, :]
    near = frame.iou >= min_iou - EPSILON
    rows, columns = assign(np.where(near, KEPT * kept + frame.iou, 0.0))
    matched = near[rows, columns]
    return rows[matched], columns[matched]
