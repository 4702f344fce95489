"""Compiled kernels of centre boxes: their rows and columns in a crop, and the best of many alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled

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


@compiled
def crops_of_each(boxes: Floats, starts: Corners, grow: float, columns: int, rows: int) -> Corners:
    """(T, 4) x0, y0, x1, y1 in the frame of what holds each target's boxes, grown by `grow` of their sizes.

    Those of target t are `starts[t]` to `starts[t + 1] - 1` of the boxes (N, 4).
    """
    corners = np.empty((starts.shape[0] - 1, 4), np.int64)
    for t in range(corners.shape[0]):
        for axis in range(2):
            low, high, extent = np.inf, -np.inf, float(columns if axis == 0 else rows)
            for n in range(starts[t], starts[t + 1]):
                reach = boxes[n, 2 + axis] * (0.5 + grow)
                low, high = min(low, boxes[n, axis] - reach), max(high, boxes[n, axis] + reach)
            # In this order NaN becomes 0: no index may leave the frame.
            corners[t, axis] = int(min(max(0.0, np.floor(low + 0.5)), extent))
            corners[t, 2 + axis] = int(min(max(0.0, np.ceil(high + 0.5)), extent))
    return corners


@compiled
def find_fitting(
    boxes: Floats,
    scores: Floats,
    extent: tuple[int, int],
    areas_px2: tuple[float, float],
    min_score: float,
) -> Corners:
    """Which of the boxes (N, 4) are finite, on an image of this width and height at least in part, and fit.

    Those fit whose area is within the limits and whose score is `min_score` or more.
    """
    kept = np.empty(boxes.shape[0], np.int64)
    count = 0
    for n in range(boxes.shape[0]):
        area, fits = 1.0, scores[n] >= min_score
        for axis in range(2):
            centre, side = boxes[n, axis], boxes[n, 2 + axis]
            area *= side
            fits &= np.isfinite(centre) and np.isfinite(side) and side > 0.0
            fits &= abs(2.0 * centre - (extent[axis] - 1)) < side + extent[axis]
        if fits and areas_px2[0] <= area <= areas_px2[1]:
            kept[count] = n
            count += 1
    return kept[:count].copy()


@compiled
def keep_best(boxes: Floats, most_overlap: float, most: int) -> Corners:
    """Which of the boxes (N, 4), the best first, are kept: `most` of them, none too alike a better one kept.

    Greedy non-maximum suppression: of two whose intersection over union (`numerics.boxes.overlap`) is above
    `most_overlap` the first stays.
    """
    kept = np.empty(min(most, boxes.shape[0]), np.int64)
    count = 0
    for n in range(boxes.shape[0]):
        if count == kept.shape[0]:
            break
        is_new = True
        for k in range(count):
            other = kept[k]
            shared = 1.0
            for axis in range(2):
                a, b = boxes[other, 2 + axis] / 2, boxes[n, 2 + axis] / 2
                low = max(boxes[other, axis] - a, boxes[n, axis] - b)
                shared *= max(min(boxes[other, axis] + a, boxes[n, axis] + b) - low, 0.0)
                if shared == 0.0:
                    break
            if shared > 0.0:
                union = boxes[other, 2] * boxes[other, 3] + boxes[n, 2] * boxes[n, 3] - shared
                if union > 0 and shared / union > most_overlap:
                    is_new = False
                    break
        if is_new:
            kept[count] = n
            count += 1
    return kept[:count].copy()


@compiled
def find_distinct(corners: Corners, nominal: Floats) -> tuple[Corners, Corners]:
    """(U,) the first of each kind of boxes with the same pixels, and (N,) the place of each box's kind there.

    `corners` (N, 4) and `nominal` (N,) are those of `pixels_of_boxes`.
    """
    count = corners.shape[0]
    size = 4
    while size < 2 * count:
        size *= 2
    table, first, kind = np.full(size, -1), np.empty(count, np.int64), np.empty(count, np.int64)
    kinds = 0
    for n in range(count):
        x0, y0, x1, y1 = corners[n, 0], corners[n, 1], corners[n, 2], corners[n, 3]
        slot = ((x0 * 31 + y0) * 31 + x1) * 31 + y1
        slot = (slot ^ (slot >> 7)) & (size - 1)
        while table[slot] >= 0:
            m = first[table[slot]]
            same = corners[m, 0] == x0 and corners[m, 1] == y0 and corners[m, 2] == x1 and corners[m, 3] == y1
            if same and nominal[m] == nominal[n]:
                break
            slot = (slot + 1) & (size - 1)
        if table[slot] < 0:
            table[slot] = kinds
            first[kinds] = n
            kinds += 1
        kind[n] = table[slot]
    return first[:kinds].copy(), kind


@compiled
def pairs_alike(
    boxes: Floats, sides: Floats, variances: Floats, order: Corners, limit: float, widened: float
) -> tuple[Corners, Corners]:
    """Pairs (P,) of centre boxes (T, 4) that may lie less than a box apart, with no field too far off.

    A field is by d^2 > `limit` s^2, s^2 the mean of both `variances` (T, 4) and the square of the share
    `widened` of the mean box; an infinite limit allows all. `sides` (T,) are those of squares of equal area,
    `order` sorts the boxes by x.
    """
    count = boxes.shape[0]
    largest = 0.0
    for t in range(count):
        largest = max(largest, sides[t])
    first, second = np.empty(count, np.int64), np.empty(count, np.int64)
    pairs = 0
    for at in range(count):
        one = order[at]
        end = boxes[one, 0] + (sides[one] + largest) / 2
        for after in range(at + 1, count):
            other = order[after]
            if boxes[other, 0] > end:
                break
            fits = True
            for k in range(4):
                if limit < np.inf and fits:
                    place = widened * ((boxes[one, 2 + k % 2] + boxes[other, 2 + k % 2]) / 2)
                    spread = (variances[one, k] + variances[other, k]) / 2 + place * place
                    fits = (boxes[one, k] - boxes[other, k]) ** 2 <= limit * spread
            if fits:
                if pairs == first.shape[0]:
                    first, second = np.append(first, first), np.append(second, second)
                first[pairs], second[pairs] = one, other
                pairs += 1
    return first[:pairs].copy(), second[:pairs].copy()
