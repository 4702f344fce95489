"""Precision, recall and F over the confidence threshold, as VOT scores long-term tracking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats


@dataclass(frozen=True, eq=False)
class Confident:
    """One sequence, each frame after the first, which is given.

    Attributes:
        iou: (n,) overlap with the true box; 0 where the target is absent.
        confidence: (n,) of the tracker.
        present: (n,) whether the target has a true box.
    """

    iou: Floats
    confidence: Floats
    present: NDArray[np.bool_]


@dataclass(frozen=True)
class LongTerm:
    """The best point of the curve.

    Attributes:
        precision: mean overlap of the frames with a confidence of at least the threshold; 0 where absent.
        recall: mean overlap of the frames in which the target is present; 0 below the threshold.
        f: harmonic mean of both.
        threshold: confidence at which `f` is largest, the highest such one.
    """

    precision: float
    recall: float
    f: float
    threshold: float


def long_term(sequences: Sequence[Confident]) -> LongTerm | None:
    """Precision, recall and F at the confidence threshold with the largest F; None without a target to find.

    Precision and recall of a threshold are means over sequences (Lukezic et al., Performance Evaluation
    Methodology for Long-Term Single-Object Tracking, 2020). A sequence in which nothing is reported at a
    threshold does not count for its precision; one without a frame that has the target, not for its recall.
    """
    shown = [one for one in sequences if len(one.iou)]
    if not any(one.present.any() for one in shown):
        return None
    levels = np.unique(np.concatenate([one.confidence for one in shown]))
    curves = [_curve(one, levels) for one in shown]
    precision = np.nanmean([curve[0] for curve in curves], axis=0)
    recall = np.nanmean(
        [curve[1] for curve, one in zip(curves, shown, strict=True) if one.present.any()], axis=0
    )
    total = precision + recall
    f = np.divide(2.0 * precision * recall, total, out=np.zeros_like(total), where=total > 0.0)
    best = len(f) - 1 - int(np.argmax(f[::-1]))
    return LongTerm(float(precision[best]), float(recall[best]), float(f[best]), float(levels[best]))


def _curve(one: Confident, levels: Floats) -> tuple[Floats, Floats]:
    """Precision and recall at each of the ascending levels; NaN precision where nothing is reported."""
    order = np.argsort(one.confidence, kind="stable")
    first = np.searchsorted(one.confidence[order], levels, side="left")
    above = np.append(np.cumsum(one.iou[order][::-1])[::-1], 0.0)[first]
    reported = (len(order) - first).astype(np.float64)
    precision = np.divide(above, reported, out=np.full(len(levels), np.nan), where=reported > 0)
    return precision, above / max(int(one.present.sum()), 1)
