"""Colour models of a target: foreground against surroundings; compiled kernel histograms and mean shift.

Nothing depends on where the array of cells begins: places are those of the frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Bytes, Floats
from bayesnet_track.numerics.compiled import compiled, compiled_summing, plain
from bayesnet_track.observation.planes import Frame, for_reading, read_only
from bayesnet_track.vision.kernels.color_kernels import (
    box_and_ring_means,
    color_posterior,
    count_cells,
    ring_shares,
)
from bayesnet_track.vision.planes import PixelGrid

TOP = 255
"""Level of a colour that is surely the target's."""
UNSEEN = 0.0005
"""Share of pixels below which the prior decides about a colour."""


@dataclass(frozen=True)
class CellLayout:
    """Layout of the cells into which pixels fall.

    Attributes:
        levels: of each channel, or of gray.
        gray: the three channels are copies of one.
    """

    levels: int
    gray: bool

    @property
    def count(self) -> int:
        """Number of cells."""
        return self.levels if self.gray else self.levels**3

    @property
    def layout(self) -> NDArray[np.uint16]:
        """(2, 3) levels of blue, green and red, and what one of each adds to a cell's number."""
        return _layout(self)


@cache
def _layout(cells: CellLayout) -> NDArray[np.uint16]:
    strides = (1, 0, 0) if cells.gray else (cells.levels**2, cells.levels, 1)
    return np.array([[cells.levels] * 3, strides], np.uint16)


KEPT = 64
"""Boxes of a frame whose counts are kept: many targets ask for more memory than they save time."""
_OF_FRAME: WeakKeyDictionary[Frame, dict[tuple[CellLayout, bytes], Floats]] = WeakKeyDictionary()


def count_pixels(frame: Frame, cells: CellLayout, boxes: Floats) -> Floats:
    """(K, cells) visible pixels of the centre boxes (K, 4) in each cell; each box holds the next.

    Those on the `Grid.of_image` of the last one. They are kept while the frame lives: an agent and a verifier
    learn in the same box.
    """
    of_frame, key = _OF_FRAME.setdefault(frame, {}), (cells, boxes.tobytes())
    counts = of_frame.get(key)
    if counts is None:
        filled = np.empty((len(boxes), cells.count))
        grid = PixelGrid.of_image(frame, boxes, boxes[-1, 2:])
        count_cells(grid.values, cells.layout, plain(grid.boxes(boxes)), filled)
        counts = read_only(filled)
        if len(of_frame) >= KEPT:
            of_frame.clear()
        of_frame[key] = counts
    return counts


def shares_of(counts: Floats) -> Floats:
    """(3, cells) shares of colours in two boxes without what the third holds, and in the last one.

    `counts` (4, cells) are those of `count_pixels`; all 0 where nothing was counted.
    """
    filled = np.empty((3, counts.shape[1]))
    ring_shares(for_reading(counts), filled)
    return filled


def means(frame: Frame, cells: CellLayout, levels: Bytes, boxes: Floats, ring: float, size: Floats) -> Floats:
    """(N, 2) mean posterior, 0..1, inside each centre box (N, 4) and in a ring of `ring` mean sides.

    Of the pixels of the `Grid.of_image` of a target of `size` (2,).
    """
    shares = np.empty((len(boxes), 2))
    grid = PixelGrid.of_image(frame, boxes, size, ring)
    boxes = plain(grid.boxes(boxes))
    box_and_ring_means(grid.values, cells.layout, for_reading(levels), boxes, ring, shares)
    return shares / TOP


def posterior(shares: Mapping[str, Floats], memory: float, prior: float) -> Bytes:
    """(cells,) 0..TOP: probability of the target given a colour, f / (f + b).

    `shares` of the pixels are f in the `foreground`, and b in the `background` with the share `memory` of the
    `memory`. `prior` is that of a colour which none of them has; it counts as a share of `UNSEEN`.
    """
    f, b, remembered = (for_reading(shares[name]) for name in ("foreground", "background", "memory"))
    levels = np.empty(len(f), np.uint8)
    color_posterior(f, b, remembered, memory, (prior * UNSEEN, UNSEEN), levels)
    return levels


Cells = NDArray[np.uint16]


@compiled
def _step(box: Floats, max_pixels: int) -> int:
    """Step between the rows and columns that are taken of a box: 1, 2, ... Radii below 1 px count as 1."""
    return max(int(np.ceil(np.sqrt(4.0 * max(box[2] / 2, 1.0) * max(box[3] / 2, 1.0) / max_pixels))), 1)


@compiled
def _sampled(cells: Cells, left: int, top: int, step: int, numbers: Cells) -> Cells:
    """Every `step`-th row and column of the cells, counted from the frame's first, by their new `numbers`."""
    first_row, first_column = (top + step - 1) // step * step - top, (left + step - 1) // step * step - left
    rows, columns = max(cells.shape[0] - first_row - 1, -1), max(cells.shape[1] - first_column - 1, -1)
    sampled = np.empty(((rows + step) // step, (columns + step) // step), np.uint16)
    for j in range(sampled.shape[0]):
        line = cells[first_row + j * step]
        for i in range(sampled.shape[1]):
            sampled[j, i] = numbers[line[first_column + i * step]]
    return sampled


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
    total_weight, per_radius, per_height, per_step = 0.0, 1.0 / rx, 1.0 / ry, 1.0 / step
    if not (x + rx >= left * step and x - rx < (left + columns) * step):
        return total_weight
    if not (y + ry >= top * step and y - ry < (top + rows) * step):
        return total_weight
    west, north = int(np.ceil((x - rx) * per_step)), int(np.ceil((y - ry) * per_step))
    squares, heights, firsts, lasts, weights = room[0], room[1], room[2], room[3], room[4]
    for i in range(int(np.floor((x + rx) * per_step)) + 1 - west):
        dx = ((west + i) * step - x) * per_radius
        squares[i] = dx * dx
    high = int(np.floor((y + ry) * per_step)) + 1 - north
    for j in range(high):  # without branches, so that it becomes vector instructions
        dy = ((north + j) * step - y) * per_height
        heights[j] = max(1.0 - dy * dy, 0.0)
        reach = rx * np.sqrt(heights[j])
        firsts[j], lasts[j] = np.ceil((x - reach) * per_step), np.floor((x + reach) * per_step)
        count = max(lasts[j] - firsts[j] + 1.0, 0.0)
        # The row's weight, count * height - sum of squares, in closed form.
        offset = firsts[j] * step - x
        total = count * offset * offset + offset * step * count * (count - 1)
        total += step * step * (count - 1) * count * (2 * count - 1) * (1.0 / 6.0)
        weights[j] = count * heights[j] - total * (per_radius * per_radius)
    for j in range(high):
        total_weight += weights[j]
    for j in range(max(top - north, 0), min(high, top + rows - north)):
        line = cells[north + j - top]
        for column in range(max(int(firsts[j]), left), min(int(lasts[j]), left + columns - 1) + 1):
            weight = max(heights[j] - squares[np.uint64(column - west)], 0.0)
            parts[line[np.uint64(column - left)], column & 3] += weight
    return total_weight


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
    max_pixels: int,
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
        steps[n] = _step(boxes[n], max_pixels)
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
            weight = _count(some, column, row, step, boxes[n], parts, room)
            if len(roots) > 0 and weight > 0.0:
                rho[n] = _overlap(parts, roots) / np.sqrt(weight)


def kernel_shares(cells: Cells, left: int, top: int, box: Floats, max_pixels: int, bins: int) -> Floats:
    """(bins,) shares of the colours of a centre box (4,) under the kernel, of what lies in the frame.

    Their sum is 1, or 0 when nothing does. Tracking chapter, 3.83-3.85. Arguments as of `coefficients`.
    """
    parts, nothing, numbers = np.zeros((bins, 4)), np.empty(0), np.arange(bins, dtype=np.uint16)
    _compare(cells, (left, top), plain(box[None]), max_pixels, numbers, nothing, parts, nothing)
    histogram = parts.sum(axis=1)
    return np.asarray(histogram / max(histogram.sum(), 1e-9))


def coefficients(cells: Cells, left: int, top: int, boxes: Floats, max_pixels: int, roots: Floats) -> Floats:
    """(N,) rho = sum over u of sqrt(p_u q_u), p the histogram of each box and q the model (3.87).

    The part of a box outside the frame has colours that no model has.

    Args:
        cells: (rows, columns) cell of each pixel.
        left: column of the frame at the first of them; likewise `top`.
        boxes: (N, 4) centre boxes in the frame, px.
        max_pixels: of a larger box every k-th row and column is taken, counted from the first of the frame.
        roots: (cells,) sqrt(q).
    """
    colors, rho = np.flatnonzero(roots > 0.0), np.zeros(len(boxes))
    if len(colors) and len(boxes):
        # The colours of the model are numbered anew; all others share the number after, which nobody reads.
        numbers = np.full(len(roots), len(colors), np.uint16)
        numbers[colors] = np.arange(len(colors))
        parts = np.zeros((len(colors) + 1, 4))
        _compare(cells, (left, top), plain(boxes), max_pixels, numbers, roots[colors], parts, rho)
    return rho


@compiled
def kernel_histogram(cells: Cells, x: float, y: float, rx: float, ry: float, bins: int) -> Floats:
    """(bins,) share of each colour cell under 1 - |d|^2 in the ellipse of radii rx, ry about (x, y).

    Coordinates are those of `cells` (rows, columns). Pixels outside it count in the whole, so that a window
    that leaves it sums to less than 1. Radii below 1 px are taken as 1. Tracking chapter, 3.15 and 3.84.
    """
    histogram = np.zeros(bins)
    rows, columns = cells.shape
    rx, ry = max(rx, 1.0), max(ry, 1.0)
    total = 0.0
    for row in range(int(np.ceil(y - ry)), int(np.floor(y + ry)) + 1):
        height = ((row - y) / ry) ** 2
        for column in range(int(np.ceil(x - rx)), int(np.floor(x + rx)) + 1):
            weight = 1.0 - height - ((column - x) / rx) ** 2
            if weight > 0.0:
                total += weight
                if 0 <= row < rows and 0 <= column < columns:
                    histogram[cells[row, column]] += weight
    if total > 0.0:
        histogram /= total
    return histogram


@compiled
def bhattacharyya_at(cells: Cells, model: Floats, x: float, y: float, rx: float, ry: float) -> float:
    """rho = sum over cells of sqrt(p q), p the histogram at a place and q the model (chapter, 3.87)."""
    histogram = kernel_histogram(cells, x, y, rx, ry, len(model))
    rho = 0.0
    for u in range(len(model)):
        rho += np.sqrt(histogram[u] * model[u])
    return rho


@compiled
def shift(
    cells: Cells, model: Floats, x: float, y: float, rx: float, ry: float, tolerance: float, max_steps: int
) -> tuple[float, float, int]:
    """Mean shift of an ellipse toward the place whose colours are those of `model`; the place and the steps.

    Each pixel weighs sqrt(q_u / p_u), p the histogram where the window stands: for the Epanechnikov kernel
    the mean of these weights climbs the Bhattacharyya coefficient, linearised there. A step after which rho
    itself is lower is halved. Stops below `tolerance` px a step, after `max_steps` steps, or where no pixel
    has a colour of the model (0 steps then, if at once).
    """
    rows, columns = cells.shape
    rx, ry = max(rx, 1.0), max(ry, 1.0)
    steps = 0
    weights = np.zeros(len(model))
    rho = bhattacharyya_at(cells, model, x, y, rx, ry)
    for _ in range(max_steps):
        histogram = kernel_histogram(cells, x, y, rx, ry, len(model))
        for u in range(len(model)):
            weights[u] = np.sqrt(model[u] / histogram[u]) if histogram[u] > 0.0 else 0.0
        total = dy = dx = 0.0
        for row in range(max(int(np.ceil(y - ry)), 0), min(int(np.floor(y + ry)) + 1, rows)):
            height = ((row - y) / ry) ** 2
            for column in range(max(int(np.ceil(x - rx)), 0), min(int(np.floor(x + rx)) + 1, columns)):
                if height + ((column - x) / rx) ** 2 < 1.0:
                    weight = weights[cells[row, column]]
                    total += weight
                    dx += weight * (column - x)
                    dy += weight * (row - y)
        if total <= 0.0:
            break
        steps += 1
        dx, dy = dx / total, dy / total
        next_rho = bhattacharyya_at(cells, model, x + dx, y + dy, rx, ry)
        while next_rho < rho and dx**2 + dy**2 >= tolerance**2:
            dx, dy = dx / 2, dy / 2
            next_rho = bhattacharyya_at(cells, model, x + dx, y + dy, rx, ry)
        if next_rho < rho:
            break
        x, y, rho = x + dx, y + dy, next_rho
        if dx**2 + dy**2 < tolerance**2:
            break
    return x, y, steps


@compiled
def window_moments(
    cells: Cells, probability: Floats, x: float, y: float, half_w: float, half_h: float
) -> Floats:
    """(6,) sums over a window of the back-projection P: P, P dx, P dy, P dx^2, P dx dy, P dy^2.

    dx, dy are taken from (x, y), the window's centre, in px of `cells`; pixels whose centre lies in
    [x - half_w, x + half_w) x [y - half_h, y + half_h) and inside `cells` count. The nearest always does.
    """
    rows, columns = cells.shape
    moments = np.zeros(6)
    left, right = int(np.ceil(x - half_w)), int(np.ceil(x + half_w))
    top, bottom = int(np.ceil(y - half_h)), int(np.ceil(y + half_h))
    if right <= left:
        left = int(np.floor(x + 0.5))
        right = left + 1
    if bottom <= top:
        top = int(np.floor(y + 0.5))
        bottom = top + 1
    for row in range(max(top, 0), min(bottom, rows)):
        for column in range(max(left, 0), min(right, columns)):
            p = probability[cells[row, column]]
            if p > 0.0:
                dx, dy = column - x, row - y
                moments[0] += p
                moments[1] += p * dx
                moments[2] += p * dy
                moments[3] += p * dx * dx
                moments[4] += p * dx * dy
                moments[5] += p * dy * dy
    return moments
