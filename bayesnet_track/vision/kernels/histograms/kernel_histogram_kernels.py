"""Compiled kernels: colour histograms of boxes under an Epanechnikov kernel, compared with a model.

Nothing depends on where the array of cells begins: places are those of the frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled

Cells = NDArray[np.uint16]


@compiled
def _count(cells: Cells, left: int, top: int, box: Floats, most: int, parts: Floats) -> float:
    """Add the weights 1 - |d|^2 of the box's ellipse by cell to `parts` (2, cells); the weight of it all.

    Two sums, of every other pixel: neighbours have one colour, and an addition would wait for the one before.

    Pixels outside the frame count in the whole only. Of a box of more than `most` pixels every k-th row and
    column is taken, counted from the frame's first. Radii below 1 px are taken as 1.
    """
    rows, columns = cells.shape
    x, y = box[0], box[1]
    rx, ry = max(box[2] / 2, 1.0), max(box[3] / 2, 1.0)
    step = max(int(np.ceil(np.sqrt(4.0 * rx * ry / most))), 1)
    even, odd = parts[0], parts[1]
    whole, per_radius = 0.0, 1.0 / rx
    if not (x + rx >= left and x - rx < left + columns and y + ry >= top and y - ry < top + rows):
        return whole
    per_height, per_square, per_step = 1.0 / ry, 1.0 / (rx * rx), 1.0 / step
    leftmost, rightmost = (left + step - 1) // step * step, left + columns - 1
    for row in range(int(np.ceil((y - ry) / step)) * step, int(np.floor(y + ry)) + 1, step):
        height = 1.0 - ((row - y) * per_height) ** 2
        if height <= 0.0:
            continue
        reach = rx * np.sqrt(height)
        first, last = int(np.ceil((x - reach) * per_step)), int(np.floor((x + reach) * per_step))
        count = last - first + 1
        if count <= 0:
            continue
        # The row's weight, count * height - sum of squares, in closed form.
        near = first * step - x
        squares = count * near * near + near * step * count * (count - 1)
        squares += step * step * (count - 1) * count * (2 * count - 1) * (1.0 / 6.0)
        whole += count * height - squares * per_square
        if not top <= row < top + rows:
            continue
        line = cells[row - top]
        begin, end = max(first * step, leftmost), min(last * step, rightmost)
        column, away, more = begin, (begin - x) * per_radius, step * per_radius
        while column + step <= end:
            even[line[column - left]] += max(height - away * away, 0.0)
            away += more
            odd[line[column + step - left]] += max(height - away * away, 0.0)
            away += more
            column += 2 * step
        if column <= end:
            even[line[column - left]] += max(height - away * away, 0.0)
    return whole


@compiled
def kernel_shares(cells: Cells, left: int, top: int, box: Floats, most: int, bins: int) -> Floats:
    """(bins,) shares of the colours of a centre box (4,) under the kernel, of what lies in the frame.

    Their sum is 1, or 0 when nothing does. Tracking chapter, 3.83-3.85. Arguments as of `coefficients`.
    """
    parts = np.zeros((2, bins))
    _count(cells, left, top, box, most, parts)
    histogram = parts[0] + parts[1]
    shares: Floats = histogram / max(histogram.sum(), 1e-9)
    return shares


@compiled
def coefficients(cells: Cells, left: int, top: int, boxes: Floats, most: int, roots: Floats) -> Floats:
    """(N,) rho = sum over u of sqrt(p_u q_u), p the histogram of each box and q the model (3.87).

    The part of a box outside the frame has colours that no model has.

    Args:
        cells: (rows, columns) cell of each pixel.
        left, top: column and row of the frame at the first of them.
        boxes: (N, 4) centre boxes in the frame, px.
        most: larger boxes, in pixels, are sampled.
        roots: (cells,) sqrt(q).
    """
    rho, parts = np.zeros(len(boxes)), np.zeros((2, len(roots)))
    known = np.flatnonzero(roots > 0.0)  # what the others hold is never read, and never cleared
    for n in range(len(boxes)):
        whole = _count(cells, left, top, boxes[n], most, parts)
        total = 0.0
        for u in known:
            weight = parts[0, u] + parts[1, u]
            if weight > 0.0:
                total += np.sqrt(weight) * roots[u]
                parts[0, u] = parts[1, u] = 0.0
        if whole > 0.0:
            rho[n] = total / np.sqrt(whole)
    return rho
