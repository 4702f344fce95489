"""Examples of silhouettes for a shape model: from a mask, or from a box in a frame."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Array, Floats
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region
from bayesnet_track.vision.planes.shape_planes import EdgePlane
from bayesnet_track.vision.shape.shape_contours import contours, mask_box, mask_edges, vectors


def mask_example(mask: Array, grid: int) -> tuple[Floats, float]:
    """(grid * grid,) shape vector of a mask (H, W), above 0 inside, and the snake's support on its rim.

    The snake starts from the ellipse of the box around the mask, as it does in a frame: what it cannot
    follow there, such as the gap between two legs, must be missing here too.

    Raises:
        ValueError: the mask is empty.
    """
    box = mask_box(mask)[None]
    return _example(mask_edges(mask), box, mask.shape[1], mask.shape[0], grid)


def frame_example(frame: Frame, box: Floats, edges: EdgePlane, grid: int) -> tuple[Floats, float]:
    """(grid * grid,) shape vector of what a centre box (4,) of a frame holds, and the snake's support."""
    planes = PlaneCache(FramePair(frame, None)).planes([edges], Region(0, 0, frame.width, frame.height))
    points = planes[edges]
    strong = points[(points[:, 2] & 1) == 1, :2]
    return _example(strong, np.asarray(box, dtype=np.float64)[None], frame.width, frame.height, grid)


def _example(points: Array, box: Floats, width: int, height: int, grid: int) -> tuple[Floats, float]:
    found = contours(points, box, np.array([width, height], dtype=np.int64))
    return vectors(found, box, grid)[0], float(found.support[0])
