"""Choice of detections: blobs of a mask, the best boxes in bounded time, and reports of what is left out."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.detector import (
    NOTHING,
    Detections,
    Detector,
    DetectorParameters,
    DetectorState,
)
from bayesnet_track.observation.planes import Frame

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bayesnet_track.observation.planes import FramePair


Evidence = NDArray[np.uint8]

CANDIDATES = 1000
"""Boxes that are compared with each other at most: a detector that fires on everything stays in time."""

SURE = 255
"""Evidence of a pixel that is certainly part of a target."""


class BlobParameters(DetectorParameters):
    """Parameters of a detector that finds 4-connected regions of pixels."""

    clean_px: int = Field(
        default=1,
        ge=0,
        le=20,
        description="Regions are opened by a square that reaches this far: thinner ones vanish (px; 0: none "
        "do).",
    )
    join_px: int = Field(
        default=2,
        ge=0,
        le=50,
        description="Regions are closed by a square that reaches this far: gaps up to twice as wide vanish "
        "(px).",
    )


@dataclass(frozen=True, eq=False)
class Regions:
    """The 4-connected regions of a mask, the largest boxes first.

    Attributes:
        numbers: (H, W) int32 number of the region of each pixel, from 1; 0 is outside all of them.
        kept: (N,) numbers of the regions described here, `CANDIDATES` at most.
        corners: (N, 4) top-left corner boxes x, y, w, h of them.
    """

    numbers: NDArray[np.int32]
    kept: NDArray[np.int64]
    corners: NDArray[np.int64]


def regions(mask: Evidence, parameters: BlobParameters) -> Regions:
    """Regions of the pixels above 0 of a mask (H, W), opened and closed; only boxes of the least area."""
    import cv2

    for reach, how in ((parameters.clean_px, cv2.MORPH_OPEN), (parameters.join_px, cv2.MORPH_CLOSE)):
        if reach > 0:
            mask = cv2.morphologyEx(mask, how, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
    _, numbers, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    area = stats[:, cv2.CC_STAT_WIDTH].astype(np.int64) * stats[:, cv2.CC_STAT_HEIGHT]
    large = np.flatnonzero(area >= parameters.min_area_px)
    large = large[large > 0]  # 0 is what lies outside all regions
    large = large[np.argsort(-area[large], kind="stable")][:CANDIDATES]
    return Regions(numbers, large, stats[large, :4].astype(np.int64))


def blobs(evidence: Evidence, threshold: int, parameters: BlobParameters) -> tuple[Floats, Floats]:
    """Boxes and scores of the 4-connected regions whose evidence is at least `threshold`.

    Args:
        evidence: (H, W) for a target at each pixel, 0 .. `SURE`.
        threshold: least evidence of a pixel, at least 1.
        parameters: how regions are cleaned and joined first, and the least area of a box.

    Returns:
        (N, 4) centre boxes; (N,) scores: mean evidence over the box of the region's own pixels at least
        `threshold`, 0..1. At most `CANDIDATES`, those with the largest areas.
    """
    mask = evidence >= threshold
    components = regions(mask.astype(np.uint8), parameters)
    if len(components.kept) == 0:
        return np.empty((0, 4)), np.empty(0)
    evidence_inside = np.where(mask, evidence, 0)
    total = np.bincount(
        components.numbers.ravel(), weights=evidence_inside.ravel()
    )  # whole numbers: exact in any order
    area = np.prod(components.corners[:, 2:], axis=1)
    return centre_from_corner(components.corners), np.asarray(total[components.kept] / (SURE * area))


@dataclass(frozen=True, eq=False)
class Selected:
    """A detector of somebody else's, its finds chosen from as those of all detectors are.

    Attributes:
        detector: the detector.
        parameters: what is kept.
    """

    detector: Detector
    parameters: DetectorParameters

    def start(self) -> DetectorState:
        """Its state."""
        return self.detector.start()

    def detect(self, frames: FramePair, state: DetectorState) -> tuple[Detections | None, DetectorState]:
        """The best of its finds."""
        detections, next_state = self.detector.detect(frames, state)
        if detections is None:
            return None, next_state
        return select(
            detections.boxes, detections.scores, frames.current, self.parameters, detections.labels
        ), next_state


def select(
    boxes: Floats,
    scores: Floats,
    frame: Frame,
    parameters: DetectorParameters,
    labels: Sequence[str] | NDArray[Any] | None = None,
) -> Detections:
    """The best of (N, 4) centre boxes, none too alike: greedy non-maximum suppression.

    Left out are boxes that are not finite, outside the frame, too small, too large or too poor. Of equal
    scores the upper box, then the left one, comes first, so that the order given does not matter.

    Raises:
        ValueError: boxes and scores of other shapes.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.kernels.box_kernels import find_fitting, keep_best

    boxes, scores = plain(np.asarray(boxes, dtype=np.float64)), np.asarray(scores, dtype=np.float64)
    scores = plain(np.minimum(np.maximum(scores, 0.0), 1.0))  # half the time of `np.clip`
    if boxes.ndim != 2 or boxes.shape[1] != 4 or scores.shape != (len(boxes),):
        raise ValueError(
            f"boxes of shape {boxes.shape}, scores of shape {scores.shape}; allowed: (N, 4), (N,)"
        )
    names = [""] * len(boxes) if labels is None else labels
    areas = (parameters.min_area_px, parameters.max_area_share * frame.width * frame.height)
    remaining = find_fitting(boxes, scores, (frame.width, frame.height), areas, parameters.min_score)
    remaining = remaining[_best_first(boxes[remaining], scores[remaining])]
    if parameters.max_overlap < 1.0:
        candidates = max(CANDIDATES, parameters.max_count)
        remaining = remaining[:candidates]
        remaining = remaining[keep_best(boxes[remaining], parameters.max_overlap, candidates)]
    selected = remaining[: parameters.max_count]
    if not len(selected):
        return NOTHING
    kinds = tuple([str(names[k]) for k in selected.tolist()])
    return Detections(boxes[selected], scores[selected], kinds, len(remaining) - len(selected))


def _best_first(boxes: Floats, scores: Floats) -> NDArray[np.int64]:
    """The order of boxes (N, 4): by score, where scores are equal from the top, then from the left."""
    order = np.argsort(-scores, kind="stable")
    ordered = scores[order]
    if (ordered[1:] == ordered[:-1]).any():
        return np.lexsort((boxes[:, 3], boxes[:, 2], boxes[:, 0], boxes[:, 1], -scores))
    return order


def left_out(
    detections: Mapping[int, Detections],
    parameters: DetectorParameters,
    size: tuple[int, int],
    labels: Collection[str] = (),
) -> dict[str, int]:
    """Numbers of detections that are not used by reason, the first that holds; it names the key.

    Args:
        detections: index of a frame -> its detections.
        parameters: what of them is kept.
        size: width and height of the frames in px.
        labels: labels that are kept; all when empty.

    >>> given = Detections(np.array([[5, 5, 4, 4], [90, 5, 4, 4]]), np.array([0.9, 0.1]), ("", ""))
    >>> left_out({0: given}, DetectorParameters(min_area_px=1), (64, 48))
    {'score less than min_score 0.2': 1}
    """
    p, (width, height) = parameters, size
    frame = Frame(0, 0.0, np.broadcast_to(np.uint8(0), (height, width, 3)))
    names = [
        f"are of none of the labels {', '.join(labels)}",
        f"score less than min_score {p.min_score:g}",
        f"lie outside of the frames of {width}x{height} px",
        f"are smaller than min_area_px {p.min_area_px:g}",
        f"are larger than max_area_share {p.max_area_share:g}",
        f"overlap a better one by more than max_overlap {p.max_overlap:g}, or exceed max_count {p.max_count}",
    ]
    counts = np.zeros(len(names), dtype=np.int64)
    for of_frame in detections.values():
        area = of_frame.boxes[:, 2:].prod(axis=1)
        beyond = np.abs(2.0 * of_frame.boxes[:, :2] - (np.array(size) - 1)) >= of_frame.boxes[:, 2:] + size
        causes = [
            np.array([bool(labels) and label not in labels for label in of_frame.labels]),
            of_frame.scores < p.min_score,
            beyond.any(axis=1),
            area < p.min_area_px,
            area > p.max_area_share * width * height,
        ]
        first = np.argmax([*causes, np.ones(len(of_frame), dtype=bool)], axis=0)
        counts[:5] += np.bincount(first, minlength=6)[:5]
        fits = first == 5
        selected = select(of_frame.boxes[fits], of_frame.scores[fits], frame, p)
        counts[5] += fits.sum() - len(selected)
    return {name: int(count) for name, count in zip(names, counts, strict=True) if count}
