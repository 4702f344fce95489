"""Compiled kernels: colour histograms of boxes under an Epanechnikov kernel, compared with a model.

Nothing depends on where the array of cells begins: places are those of the frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled, compiled_summing, plain

Cells = NDArray[np.uint16]


@compiled
def _step(box: Floats, most: int) -> int:
    """Which rows and columns are taken of a box: every one, second, ... Radii below 1 px are taken as 1."""
    return max(int(np.ceil(np.sqrt(4.0 * max(box[2] / 2, 1.0) * max(box[3] / 2, 1.0) / most))), 1)


@compiled
def _sampled(cells: Cells, left: int, top: int, step: int, numbers: Cells) -> Cells:
    """Every `step`-th row and column of the cells, counted from the frame's first, by their new `numbers`."""
    above, before = (top + step - 1) // step * step - top, (left + step - 1) // step * step - left
    rows, columns = max(cells.shape[0] - above - 1, -1), max(cells.shape[1] - before - 1, -1)
    found = np.empty(((rows + step) // step, (columns + step) // step), np.uint16)
    for j in range(found.shape[0]):
        line = cells[above + j * step]
        for i in range(found.shape[1]):
            found[j, i] = numbers[line[before + i * step]]
    return found


@compiled
def _room(box: Floats, step: int) -> int:
    """At least as many as a box has rows, or columns, that `step` divides."""
    return max(int(max(box[2], box[3], 2.0) / step) + 2, 0)


@compiled
def _count(cells: Cells, left: int, top: int, step: int, box: Floats, parts: Floats, room: Floats) -> float:
    """Add the weights 1 - |d|^2 of the box's ellipse by cell to `parts` (cells, 4); the weight of it all.

    Four sums, of every fourth pixel: neighbours have one colour, and an addition would wait for the one
    before. Pixels outside the frame count in the whole only.

    Args:
        cells: (rows, columns) of the pixels whose row and column `step` divides.
        left: the first of them has the column `left * step`; likewise `top`.
        step: pixels from one to the next.
        box: (4,) centre box.
        parts: added to.
        room: (5, R) written into, R at least `_room`.
    """
    rows, columns = cells.shape
    x, y = box[0], box[1]
    rx, ry = max(box[2] / 2, 1.0), max(box[3] / 2, 1.0)
    whole, per_radius, per_height, per_step = 0.0, 1.0 / rx, 1.0 / ry, 1.0 / step
    if not (x + rx >= left * step and x - rx < (left + columns) * step):
        return whole
    if not (y + ry >= top * step and y - ry < (top + rows) * step):
        return whole
    west, north = int(np.ceil((x - rx) * per_step)), int(np.ceil((y - ry) * per_step))
    squares, heights, firsts, lasts, weights = room[0], room[1], room[2], room[3], room[4]
    for i in range(int(np.floor((x + rx) * per_step)) + 1 - west):
        away = ((west + i) * step - x) * per_radius
        squares[i] = away * away
    high = int(np.floor((y + ry) * per_step)) + 1 - north
    for j in range(high):  # without branches, so that it becomes vector instructions
        below = ((north + j) * step - y) * per_height
        heights[j] = max(1.0 - below * below, 0.0)
        reach = rx * np.sqrt(heights[j])
        firsts[j], lasts[j] = np.ceil((x - reach) * per_step), np.floor((x + reach) * per_step)
        count = max(lasts[j] - firsts[j] + 1.0, 0.0)
        # The row's weight, count * height - sum of squares, in closed form.
        near = firsts[j] * step - x
        total = count * near * near + near * step * count * (count - 1)
        total += step * step * (count - 1) * count * (2 * count - 1) * (1.0 / 6.0)
        weights[j] = count * heights[j] - total * (per_radius * per_radius)
    for j in range(high):
        whole += weights[j]
    for j in range(max(top - north, 0), min(high, top + rows - north)):
        line = cells[north + j - top]
        for column in range(max(int(firsts[j]), left), min(int(lasts[j]), left + columns - 1) + 1):
            weight = max(heights[j] - squares[np.uint64(column - west)], 0.0)
            parts[line[np.uint64(column - left)], column & 3] += weight
    return whole


@compiled_summing
def _overlap(parts: Floats, roots: Floats) -> float:
    """Sum over the known colours of sqrt(p q), p those of `parts` (K + 1, 4), which is cleared."""
    total = 0.0
    for u in range(len(roots)):
        total += np.sqrt(parts[u, 0] + parts[u, 1] + parts[u, 2] + parts[u, 3]) * roots[u]
    parts[:] = 0.0
    return total


@compiled
def _compare(
    cells: Cells,
    place: tuple[int, int],
    boxes: Floats,
    most: int,
    numbers: Cells,
    roots: Floats,
    parts: Floats,
    rho: Floats,
) -> None:
    """Fill `rho` (N,); without `roots` (K,), add the weights of the boxes to `parts` (cells, 4) instead.

    Colours have new `numbers` here; those of the model are the first K.
    """
    left, top = place
    steps, size = np.empty(len(boxes), np.int64), 0
    for n in range(len(boxes)):
        steps[n] = _step(boxes[n], most)
        size = max(size, _room(boxes[n], steps[n]))
    room = np.empty((5, size))
    for step in range(steps.min(), steps.max() + 1):
        if not (steps == step).any():
            continue
        some = _sampled(cells, left, top, step, numbers)
        column, row = (left + step - 1) // step, (top + step - 1) // step
        for n in range(len(boxes)):
            if steps[n] != step:
                continue
            whole = _count(some, column, row, step, boxes[n], parts, room)
            if len(roots) > 0 and whole > 0.0:
                rho[n] = _overlap(parts, roots) / np.sqrt(whole)


def kernel_shares(cells: Cells, left: int, top: int, box: Floats, most: int, bins: int) -> Floats:
    """(bins,) shares of the colours of a centre box (4,) under the kernel, of what lies in the frame.

    Their sum is 1, or 0 when nothing does. Tracking chapter, 3.83-3.85. Arguments as of `coefficients`.
    """
    parts, nothing, numbers = np.zeros((bins, 4)), np.empty(0), np.arange(bins, dtype=np.uint16)
    _compare(cells, (left, top), plain(box[None]), most, numbers, nothing, parts, nothing)
    histogram = parts.sum(axis=1)
    return np.asarray(histogram / max(histogram.sum(), 1e-9))


def coefficients(cells: Cells, left: int, top: int, boxes: Floats, most: int, roots: Floats) -> Floats:
    """(N,) rho = sum over u of sqrt(p_u q_u), p the histogram of each box and q the model (3.87).

    The part of a box outside the frame has colours that no model has.

    Args:
        cells: (rows, columns) cell of each pixel.
        left: column of the frame at the first of them; likewise `top`.
        boxes: (N, 4) centre boxes in the frame, px.
        most: of a larger box, in pixels, every k-th row and column is taken, counted from the frame's first.
        roots: (cells,) sqrt(q).
    """
    known, rho = np.flatnonzero(roots > 0.0), np.zeros(len(boxes))
    if len(known) and len(boxes):
        # The colours of the model are numbered anew; all others share the number after, which nobody reads.
        numbers = np.full(len(roots), len(known), np.uint16)
        numbers[known] = np.arange(len(known))
        parts = np.zeros((len(known) + 1, 4))
        _compare(cells, (left, top), plain(boxes), most, numbers, roots[known], parts, rho)
    return rho
