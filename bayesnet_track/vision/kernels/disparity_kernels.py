"""Compiled kernels of stereo: normalised correlation along rows, and regions of a depth map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Singles
from bayesnet_track.numerics.compiled import compiled

Shorts = NDArray[np.int16]
Ints32 = NDArray[np.int32]

LARGEST = 2047
"""Largest absolute value of a pixel: 21 x 21 products of such pixels sum to less than 2**31."""


@compiled
def _window_sums(image: Shorts, top: int, half: int, sums: Floats, inverse: Floats) -> None:
    """Fill `sums` with the window's sum around each pixel of the row, `inverse` with 1 / (n sd).

    The window's first row is `top`. All sums are exact. `inverse` is NaN where the window is flat or leaves
    the picture.
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
    sums[:] = 0.0
    inverse[:] = np.nan
    a, b = np.int64(0), np.int64(0)
    for i in range(columns):
        a += first[i]
        b += second[i]
        if i >= side:
            a -= first[i - side]
            b -= second[i - side]
        if i >= side - 1:
            square = n * b - a * a
            sums[i - half] = float(a)
            if square > 0:
                inverse[i - half] = 1.0 / np.sqrt(float(square))


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
    disparity: Singles,
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
    column_sums = np.zeros((count, wide + side - 1), np.int32)
    total = np.zeros(wide, np.int32)
    scores = np.empty((count, wide), np.float32)
    left_sums, right_sums = np.empty(width), np.empty(width)
    left_inverse, right_inverse = np.empty(width), np.empty(width)
    best_scores, place = np.empty(wide, np.float32), np.empty(wide, np.int32)
    limit, rivals = np.empty(wide, np.float32), np.empty(wide, np.int32)
    shift = x_first - half
    for y in range(y_first, y_last):
        _window_sums(left, y - half, half, left_sums, left_inverse)
        _window_sums(right, y - half, half, right_sums, right_inverse)
        for k in range(count):
            d = low - 1 + k
            sums, row = column_sums[k], scores[k]
            # columns of the windows that lie in the right picture too
            begin, end = max(shift, d), min(x_last + half, width + d)
            row[:] = np.nan
            if end - begin < side:
                continue
            # Slices, so that indices count from 0: only such loops become vector instructions.
            part = sums[begin - shift : end - shift]
            if y == y_first:
                for j in range(y - half, y + half + 1):
                    _add_products(part, left[j, begin:end], right[j, begin - d : end - d])
            else:
                entering, leaving = y + half, y - half - 1
                _add_products(part, left[entering, begin:end], right[entering, begin - d : end - d])
                _subtract_products(part, left[leaving, begin:end], right[leaving, begin - d : end - d])
            _running_sums(sums, side, total)
            first, stop = begin + half, end - half
            _score(
                n,
                total[first - x_first : stop - x_first],
                left_sums[first:stop],
                right_sums[first - d : stop - d],
                left_inverse[first:stop],
                right_inverse[first - d : stop - d],
                row[first - x_first : stop - x_first],
            )
        _find_best(scores, best_scores, place)
        _limits(best_scores, min_difference, limit)
        _count_rivals(scores, place, limit, separation, rivals)
        for i in range(wide):
            inverse = left_inverse[x_first + i]
            if not inverse * n * min_spread <= 1.0 or place[i] <= 0 or place[i] >= count - 1:
                continue
            if best_scores[i] < min_correlation or rivals[i] > 0:
                continue
            match = low - 1 + place[i] + _fraction(scores, i, place[i])
            disparity[y - rows[0], x_first + i - columns[0]] = match


@compiled
def _add_products(sums: Ints32, first: Shorts, second: Shorts) -> None:
    for i in range(sums.shape[0]):
        sums[i] += np.int32(first[i]) * np.int32(second[i])


@compiled
def _subtract_products(sums: Ints32, first: Shorts, second: Shorts) -> None:
    for i in range(sums.shape[0]):
        sums[i] -= np.int32(first[i]) * np.int32(second[i])


@compiled
def _running_sums(values: Ints32, side: int, sums: Ints32) -> None:
    """Fill `sums` with the sums of `side` successive values."""
    running = np.int32(0)
    for i in range(side):
        running += values[i]
    sums[0] = running
    entering, leaving = values[side:], values[: sums.shape[0]]
    for i in range(sums.shape[0] - 1):
        running += entering[i] - leaving[i]
        sums[i + 1] = running


@compiled
def _score(
    n: float,
    products: Ints32,
    left_sums: Floats,
    right_sums: Floats,
    left_inverse: Floats,
    right_inverse: Floats,
    scores: Singles,
) -> None:
    """Thesis eq. 3.5 from sums over windows."""
    for i in range(scores.shape[0]):
        moment = n * float(products[i]) - left_sums[i] * right_sums[i]
        scores[i] = np.float32(moment * left_inverse[i] * right_inverse[i])


@compiled
def _find_best(scores: Singles, best_scores: Singles, place: Ints32) -> None:
    """Fill `best_scores` and `place` with each column's largest score and its row; -1 where there is none."""
    best_scores[:] = np.float32(-2.0)
    place[:] = -1
    for k in range(scores.shape[0]):
        row = scores[k]
        for i in range(row.shape[0]):
            is_better = row[i] > best_scores[i]  # never true of NaN
            best_scores[i] = row[i] if is_better else best_scores[i]
            place[i] = np.int32(k) if is_better else place[i]


@compiled
def _limits(best_scores: Singles, min_difference: float, limit: Singles) -> None:
    """Fill `limit` with what a rival's score exceeds: (1 - min_difference) best, rounded down."""
    for i in range(best_scores.shape[0]):
        top = float(best_scores[i])
        exact = top - min_difference * top
        limit[i] = np.float32(exact)
        if float(limit[i]) > exact:
            limit[i] = np.nextafter(limit[i], np.float32(-np.inf))


@compiled
def _count_rivals(scores: Singles, place: Ints32, limit: Singles, separation: int, rivals: Ints32) -> None:
    """Fill `rivals` with the number of peaks above `limit` that are further than `separation` from `place`.

    Row by row, since only loops along rows become vector instructions.
    """
    rivals[:] = 0
    for k in range(1, scores.shape[0] - 1):
        previous, row, following = scores[k - 1], scores[k], scores[k + 1]
        low, high = np.int32(k - separation), np.int32(k + separation)
        for i in range(row.shape[0]):
            score = row[i]
            is_rival = (score > limit[i]) & ((place[i] < low) | (place[i] > high))
            is_below = (previous[i] > score) | (following[i] > score)
            rivals[i] += np.int32(is_rival & (not is_below))


@compiled
def _fraction(scores: Singles, i: int, peak: int) -> float:
    """Peak of a parabola through the best score and its neighbours, in steps from the best."""
    lower, top, upper = float(scores[peak - 1, i]), float(scores[peak, i]), float(scores[peak + 1, i])
    bend = lower - 2.0 * top + upper
    return 0.5 * (lower - upper) / bend if bend < 0.0 else 0.0


@compiled
def label_regions(depth: Singles, step: float, min_pixels: int, labels: Ints32) -> int:
    """Fill `labels` with the 4-connected smooth regions of `depth`, 1, 2, ... in reading order; their number.

    Neighbours belong together when their depths differ by at most `step` of the smaller. Pixels that are NaN
    or in a region of fewer than `min_pixels` pixels have label 0.
    """
    rows, columns = depth.shape
    labels[:] = 0
    stack = np.empty((rows * columns, 2), np.int32)
    count = 0
    for y in range(rows):
        for x in range(columns):
            if labels[y, x] != 0 or np.isnan(depth[y, x]):
                continue
            count += 1
            labels[y, x] = count
            stack[0, 0], stack[0, 1] = y, x
            # `stack` keeps what was visited, so that a small region can be taken back.
            size, next_ = 1, 0
            while next_ < size:
                b, a = stack[next_, 0], stack[next_, 1]
                next_ += 1
                value = depth[b, a]
                for k in range(4):
                    v = b + (k == 0) - (k == 1)
                    u = a + (k == 2) - (k == 3)
                    if v < 0 or u < 0 or v >= rows or u >= columns or labels[v, u] != 0:
                        continue
                    neighbour = depth[v, u]
                    if abs(neighbour - value) <= step * min(neighbour, value):  # never true of NaN
                        labels[v, u] = count
                        stack[size, 0], stack[size, 1] = v, u
                        size += 1
            if size < min_pixels:
                for k in range(size):
                    labels[stack[k, 0], stack[k, 1]] = -1
                count -= 1
    for y in range(rows):
        for x in range(columns):
            labels[y, x] = max(labels[y, x], 0)
    return count
