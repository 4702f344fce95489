"""Compiled kernels of foreground and background colours: cells counted, means from an integral image.

Everything is counted in integers, so that a box has the same value to the bit whatever crop it is asked in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Bytes, Floats, Ints
from bayesnet_track.numerics.compiled import compiled

STEPS = 16
"""Steps of a pixel to which the edges of boxes are rounded."""


@compiled
def count_cells(image: Bytes, tables: NDArray[np.int32], counts: Floats) -> None:
    """Add the pixels of `image` (H, W, 3) to `counts` (cells,).

    `tables` (3, 256) has each channel's part of a cell's number, which is the sum of the three.
    """
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            cell = tables[0, image[y, x, 0]] + tables[1, image[y, x, 1]] + tables[2, image[y, x, 2]]
            counts[cell] += 1.0


@compiled
def integral_of_cells(image: Bytes, tables: NDArray[np.int32], levels: Bytes, integral: Ints) -> None:
    """Sums of the pixels' levels above and left: `integral` (H + 1, W + 1), its first row and column 0.

    Args:
        image: (H, W, 3).
        tables: (3, 256) as of `count_cells`.
        levels: (cells,) the value of each cell.
        integral: filled.
    """
    integral[0, :] = 0
    for y in range(image.shape[0]):
        integral[y + 1, 0] = 0
        total = np.int64(0)
        for x in range(image.shape[1]):
            cell = tables[0, image[y, x, 0]] + tables[1, image[y, x, 1]] + tables[2, image[y, x, 2]]
            total += np.int64(levels[cell])
            integral[y + 1, x + 1] = integral[y, x + 1] + total


@compiled
def _corner(integral: Ints, x: int, y: int) -> int:
    """The integral up to (x, y), both in steps of a pixel: bilinear, times STEPS squared."""
    column, row = x // STEPS, y // STEPS
    right, down = x - column * STEPS, y - row * STEPS
    # The last row and column are edges: there is nothing beyond them, and the share of it is 0.
    after, below = min(column + 1, integral.shape[1] - 1), min(row + 1, integral.shape[0] - 1)
    top = integral[row, column] * (STEPS - right) + integral[row, after] * right
    bottom = integral[below, column] * (STEPS - right) + integral[below, after] * right
    found: int = top * (STEPS - down) + bottom * down
    return found


@compiled
def _sum(integral: Ints, left: int, top: int, right: int, bottom: int) -> int:
    return (
        _corner(integral, right, bottom)
        - _corner(integral, left, bottom)
        - _corner(integral, right, top)
        + _corner(integral, left, top)
    )


@compiled
def box_and_ring_means(
    integral: Ints, boxes: Floats, ring: float, x0: int, y0: int, width: int, height: int, means: Floats
) -> None:
    """Mean level inside each box, and in the ring around it.

    What lies outside the frame counts as 0 inside a box; the ring is what of it lies inside the frame.

    Args:
        integral: of the crop whose first pixel is (x0, y0); it covers boxes and rings inside the frame.
        boxes: (N, 4) centre boxes, px.
        ring: width of the ring in mean sides of the box.
        x0: first column of the crop; likewise `y0`.
        width: of the frame, px; likewise `height`.
        means: (N, 2) filled.
    """
    across, down = width * STEPS, height * STEPS
    for k in range(boxes.shape[0]):
        x, y, w, h = boxes[k, 0] + 0.5, boxes[k, 1] + 0.5, boxes[k, 2], boxes[k, 3]
        sums = np.zeros(2, np.int64)
        areas = np.zeros(2, np.int64)
        for outer in range(2):
            grown = outer * ring * 0.5 * (w + h)
            left = min(max(int(np.floor((x - 0.5 * w - grown) * STEPS + 0.5)), 0), across)
            right = min(max(int(np.floor((x + 0.5 * w + grown) * STEPS + 0.5)), 0), across)
            top = min(max(int(np.floor((y - 0.5 * h - grown) * STEPS + 0.5)), 0), down)
            bottom = min(max(int(np.floor((y + 0.5 * h + grown) * STEPS + 0.5)), 0), down)
            areas[outer] = (right - left) * (bottom - top)
            if areas[outer] > 0:
                sums[outer] = _sum(
                    integral,
                    left - x0 * STEPS,
                    top - y0 * STEPS,
                    right - x0 * STEPS,
                    bottom - y0 * STEPS,
                )
        nominal = max(w * h * STEPS * STEPS, float(areas[0]), 1.0)
        around = areas[1] - areas[0]
        means[k, 0] = sums[0] / nominal
        means[k, 1] = (sums[1] - sums[0]) / around if around > 0 else 0.0
