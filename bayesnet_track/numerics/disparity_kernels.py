"""Compiled kernels of stereo: normalised correlation along rows, and regions of a depth map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.compiled import compiled

Shorts = NDArray[np.int16]
Floats32 = NDArray[np.float32]

LARGEST = 2047
"""Largest absolute value of a pixel: 21 x 21 products of such pixels sum to less than 2**31."""


@compiled
def _spread(image: Shorts, top: int, half: int, sums: NDArray[np.int64], spread: NDArray[np.float64]) -> None:
    """Fill `sums` with the window's sum around each pixel of the row, `spread` with n sd; 0 without a window.

    The window's first row is `top`. All sums are exact.
    """
    side = 2 * half + 1
    columns = image.shape[1]
    n = np.int64(side * side)
    first, second = np.zeros(columns, np.int64), np.zeros(columns, np.int64)
    for j in range(top, top + side):
        for i in range(columns):
            value = np.int64(image[j, i])
            first[i] += value
            second[i] += value * value
    sums[:] = 0
    spread[:] = 0.0
    a, b = np.int64(0), np.int64(0)
    for i in range(columns):
        a += first[i]
        b += second[i]
        if i >= side:
            a -= first[i - side]
            b -= second[i - side]
        if i >= side - 1:
            sums[i - half] = a
            spread[i - half] = np.sqrt(float(n * b - a * a))


@compiled
def correlate(
    left: Shorts,
    right: Shorts,
    rows: tuple[int, int],
    columns: tuple[int, int],
    half: int,
    low: int,
    high: int,
    min_spread: float,
    min_correlation: float,
    min_difference: float,
    separation: int,
    disparity: Floats32,
) -> None:
    """Fill `disparity` (rows, columns) with the best match of each window along its row, or NaN.

    Thesis eq. 3.5: (n S_rl - S_r S_l) / (n^2 sd_r sd_l), its largest value over d with the right window at
    x - d; to a fraction of a pixel by a parabola through the largest value and its neighbours. NaN where

    - a window leaves the picture, or the largest value lies beyond low .. high;
    - the left window's sd is below `min_spread` (texture), or either is 0;
    - the largest value is below `min_correlation` (foreshortening, occlusion);
    - another peak is lower by less than `min_difference` of the largest and further than `separation` px
      from it (repeated pattern).

    Args:
        left, right: (H, W) int16 pictures, absolute values at most LARGEST.
        rows, columns: first and one past the last of the pixels wanted.
        half: the window has 2 half + 1 <= 21 pixels per side.
        low, high: whole disparities searched, both included.
    """
    height, width = left.shape
    side = 2 * half + 1
    n = float(side * side)
    count = high - low + 3  # one more on either side, so that a peak at the end of the range is seen as one
    disparity[:] = np.nan
    y_first, y_last = max(rows[0], half), min(rows[1], height - half)
    x_first, x_last = max(columns[0], half), min(columns[1], width - half)
    if y_first >= y_last or x_first >= x_last:
        return
    wide = x_last - x_first
    # Sums of products down the window's columns, for every disparity; moved by one row at a time.
    down = np.zeros((count, wide + side - 1), np.int32)
    scores = np.empty((wide, count), np.float32)
    left_sums, right_sums = np.empty(width, np.int64), np.empty(width, np.int64)
    left_spread, right_spread = np.empty(width), np.empty(width)
    for y in range(y_first, y_last):
        _spread(left, y - half, half, left_sums, left_spread)
        _spread(right, y - half, half, right_sums, right_spread)
        for k in range(count):
            d = low - 1 + k
            sums = down[k]
            # columns of the window that lie in the right picture too
            begin = max(x_first - half, d)
            end = min(x_last + half, width + d)
            if end <= begin:
                for i in range(wide):
                    scores[i, k] = -2.0
                continue
            shift = x_first - half
            if y == y_first:
                for j in range(y - half, y + half + 1):
                    for i in range(begin, end):
                        sums[i - shift] += np.int32(left[j, i]) * np.int32(right[j, i - d])
            else:
                old, new = y - half - 1, y + half
                for i in range(begin, end):
                    sums[i - shift] += np.int32(left[new, i]) * np.int32(right[new, i - d]) - np.int32(
                        left[old, i]
                    ) * np.int32(right[old, i - d])
            total = np.int64(0)
            for i in range(side - 1):
                total += sums[i]
            for i in range(wide):
                total += sums[i + side - 1]
                x = x_first + i
                score = -2.0
                if x - half >= begin and x + half < end:
                    spread = left_spread[x] * right_spread[x - d]
                    if spread > 0.0:
                        score = (n * total - float(left_sums[x] * right_sums[x - d])) / spread
                scores[i, k] = score
                total -= sums[i]
        for i in range(wide):
            if left_spread[x_first + i] < n * min_spread or left_spread[x_first + i] == 0.0:
                continue
            found = _peak(scores[i], min_correlation, min_difference, separation)
            if found > 0.0:
                disparity[y - rows[0], x_first + i - columns[0]] = low - 1 + found


@compiled
def _peak(scores: Floats32, min_correlation: float, min_difference: float, separation: int) -> float:
    """Where the scores are largest, to a fraction of a step; -1 at an end, or when the peak is not clear."""
    count = scores.shape[0]
    best = 0
    for k in range(1, count):
        if scores[k] > scores[best]:
            best = k
    top = scores[best]
    if best == 0 or best == count - 1 or top < min_correlation:
        return -1.0
    limit = top - min_difference * top
    for k in range(1, count - 1):
        if (
            scores[k] > limit
            and abs(k - best) > separation
            and scores[k] >= scores[k - 1]
            and scores[k] >= scores[k + 1]
        ):
            return -1.0
    before, after = scores[best - 1], scores[best + 1]
    if before < -1.5 or after < -1.5:  # no window there
        return float(best)
    bend = float(before) - 2.0 * float(top) + float(after)
    if bend >= 0.0:
        return float(best)
    return best + 0.5 * (float(before) - float(after)) / bend


@compiled
def label_regions(depth: Floats32, step: float, min_pixels: int, labels: NDArray[np.int32]) -> int:
    """Fill `labels` with the 4-connected smooth regions of `depth`, 1, 2, ... in reading order; their number.

    Neighbours belong together when their depths differ by at most `step` of the smaller. Pixels that are NaN
    or in a region of fewer than `min_pixels` pixels have label 0.
    """
    rows, columns = depth.shape
    labels[:] = 0
    stack = np.empty((rows * columns, 2), np.int32)
    found = 0
    for y in range(rows):
        for x in range(columns):
            if labels[y, x] != 0 or np.isnan(depth[y, x]):
                continue
            found += 1
            labels[y, x] = found
            stack[0, 0], stack[0, 1] = y, x
            # `stack` keeps what was visited, so that a small region can be taken back.
            size, next_ = 1, 0
            while next_ < size:
                b, a = stack[next_, 0], stack[next_, 1]
                next_ += 1
                here = depth[b, a]
                for k in range(4):
                    v = b + (k == 0) - (k == 1)
                    u = a + (k == 2) - (k == 3)
                    if v < 0 or u < 0 or v >= rows or u >= columns or labels[v, u] != 0:
                        continue
                    there = depth[v, u]
                    if abs(there - here) <= step * min(there, here):  # never true of NaN
                        labels[v, u] = found
                        stack[size, 0], stack[size, 1] = v, u
                        size += 1
            if size < min_pixels:
                for k in range(size):
                    labels[stack[k, 0], stack[k, 1]] = -1
                found -= 1
    for y in range(rows):
        for x in range(columns):
            labels[y, x] = max(labels[y, x], 0)
    return found
