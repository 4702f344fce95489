"""Compiled kernel that turns centre boxes into rows and columns of a crop of the frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.compiled import compiled

Floats = NDArray[np.float64]
Corners = NDArray[np.int64]


@compiled
def pixels_of_boxes(
    boxes: Floats, left: int, top: int, columns: int, rows: int
) -> tuple[Corners, Floats, Floats]:
    """(N, 4) corners x0, y0, x1, y1 of each box in the crop, (N,) pixels in the crop, (N,) pixels in all.

    A pixel is in a box when low edge <= its centre < high edge; every box has at least the nearest one.

    Args:
        boxes: (N, 4) centre boxes, px.
        left, top: column and row of the frame at the crop's first pixel.
        columns, rows: size of the crop.
    """
    size = boxes.shape[0]
    corners = np.zeros((size, 4), np.int64)
    visible, nominal = np.ones(size), np.ones(size)
    for n in range(size):
        for axis in range(2):
            first, extent = (left, columns) if axis == 0 else (top, rows)
            half = boxes[n, 2 + axis] / 2
            low, high = np.ceil(boxes[n, axis] - half), np.ceil(boxes[n, axis] + half)
            if not high > low:
                low = np.floor(boxes[n, axis] + 0.5)
                high = low + 1.0
            nominal[n] *= high - low
            # In this order NaN becomes 0: no index may leave the crop.
            begin, end = min(max(0.0, low - first), float(extent)), min(max(0.0, high - first), float(extent))
            corners[n, axis], corners[n, 2 + axis] = int(begin), int(end)
            visible[n] *= end - begin
    return corners, visible, nominal
