"""How well detections fit the true boxes: recall and precision."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.boxes import overlap

Boxes = NDArray[np.float64]


@dataclass(frozen=True)
class DetectionScore:
    """Counts over some frames.

    Attributes:
        found: true boxes with a detection.
        missed: true boxes without one.
        false: detections of nothing.
    """

    found: int = 0
    missed: int = 0
    false: int = 0

    @property
    def recall(self) -> float:
        """Share of the true boxes that were found; NaN when there are none."""
        return self.found / (self.found + self.missed) if self.found + self.missed else float("nan")

    @property
    def precision(self) -> float:
        """Share of the detections that are true; NaN when there are none."""
        return self.found / (self.found + self.false) if self.found + self.false else float("nan")

    def __add__(self, other: DetectionScore) -> DetectionScore:
        return DetectionScore(self.found + other.found, self.missed + other.missed, self.false + other.false)


def score_detections(boxes: Boxes, truth: Boxes, min_iou: float = 0.5) -> DetectionScore:
    """Centre boxes (N, 4), the best first, against the true ones (M, 4) of the same frame.

    Each detection in turn takes the true box, of those not taken, that it overlaps most, when their
    intersection over union is at least `min_iou` (as in Pascal VOC).
    """
    free = np.ones(len(truth), dtype=bool)
    for box in boxes:
        fit = np.where(free, overlap(box, truth), -1.0)
        if len(fit) and fit.max() >= min_iou:
            free[int(fit.argmax())] = False
    found = int((~free).sum())
    return DetectionScore(found, len(truth) - found, len(boxes) - found)


def total(scores: Iterable[DetectionScore]) -> DetectionScore:
    """All of them together."""
    return sum(scores, DetectionScore())
