"""What becomes of given detections before any is used: how many are left out, and why."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from bayesnet_track.observation.detector import Detections, DetectorParameters
from bayesnet_track.observation.planes import Frame
from bayesnet_track.vision.detectors.selection import select


def left_out(
    found: Mapping[int, Detections],
    parameters: DetectorParameters,
    size: tuple[int, int],
    labels: Collection[str] = (),
) -> dict[str, int]:
    """How many detections are not used, by the reason, which names the key; the first reason that holds.

    Args:
        found: index of a frame -> its detections.
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
    for one in found.values():
        area = one.boxes[:, 2:].prod(axis=1)
        apart = np.abs(2.0 * one.boxes[:, :2] - (np.array(size) - 1)) >= one.boxes[:, 2:] + size
        causes = [
            np.array([bool(labels) and label not in labels for label in one.labels]),
            one.scores < p.min_score,
            apart.any(axis=1),
            area < p.min_area_px,
            area > p.max_area_share * width * height,
        ]
        first = np.argmax([*causes, np.ones(len(one), dtype=bool)], axis=0)
        counts[:5] += np.bincount(first, minlength=6)[:5]
        fits = first == 5
        kept = select(one.boxes[fits], one.scores[fits], frame, p)
        counts[5] += fits.sum() - len(kept)
    return {name: int(count) for name, count in zip(names, counts, strict=True) if count}
