"""Compiled kernels of sparse optical flow: corners, Lucas-Kanade, flow in boxes, agreement of point pairs.

Whatever is computed for a point is computed from whole-number pixel positions and offsets from them, so that
the bits of the result do not depend on where a crop starts.
"""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Bytes, Floats, Ints, Singles
from bayesnet_track.numerics.compiled import compiled, compiled_summing
from bayesnet_track.numerics.resampling import copy_row

BLOCK = 2
"""The gradient matrix of a corner sums over (2 BLOCK + 1)^2 pixels."""
RIM = BLOCK + 1
"""A pixel's corner score depends on the pixels up to this far away."""
GRADIENT_SCALE = 8.0
"""The Sobel operator gives this many times the gradient in gray levels per pixel."""


@compiled
def corner_scores(gray: Bytes, threshold: float, scores: Floats) -> None:
    """Fill `scores` (as `gray`) with the smaller eigenvalue of the gradient matrix.

    The matrix is the mean over the block, in (gray levels per pixel)^2. The score is 0 where it would not
    exceed `threshold`, and within RIM pixels of the border.
    """
    height, width = gray.shape
    scores[:] = 0.0
    if height <= 2 * RIM or width <= 2 * RIM:
        return
    side = 2 * BLOCK + 1
    limit = threshold * GRADIENT_SCALE**2 * side**2
    xx, xy, yy = (
        np.zeros((side, width), np.int32),
        np.zeros((side, width), np.int32),
        np.zeros((side, width), np.int32),
    )
    sum_xx, sum_xy, sum_yy = np.zeros(width, np.int32), np.zeros(width, np.int32), np.zeros(width, np.int32)
    for j in range(1, height - 1):
        a, b, c = gray[j - 1], gray[j], gray[j + 1]
        slot = j % side
        line_xx, line_xy, line_yy = xx[slot], xy[slot], yy[slot]
        for i in range(1, width - 1):
            gx = (
                (np.int32(a[i + 1]) - np.int32(a[i - 1]))
                + np.int32(2) * (np.int32(b[i + 1]) - np.int32(b[i - 1]))
                + (np.int32(c[i + 1]) - np.int32(c[i - 1]))
            )
            gy = (
                (np.int32(c[i - 1]) - np.int32(a[i - 1]))
                + np.int32(2) * (np.int32(c[i]) - np.int32(a[i]))
                + (np.int32(c[i + 1]) - np.int32(a[i + 1]))
            )
            new_xx, new_xy, new_yy = gx * gx, gx * gy, gy * gy
            sum_xx[i] += new_xx - line_xx[i]
            sum_xy[i] += new_xy - line_xy[i]
            sum_yy[i] += new_yy - line_yy[i]
            line_xx[i], line_xy[i], line_yy[i] = new_xx, new_xy, new_yy
        centre = j - BLOCK
        if centre < RIM:
            continue
        for i in range(RIM, width - RIM):
            p, q, r = 0, 0, 0
            for k in range(i - BLOCK, i + BLOCK + 1):
                p += sum_xx[k]
                q += sum_xy[k]
                r += sum_yy[k]
            if p > limit and r > limit and (p - limit) * (r - limit) > float(q) * float(q):
                spread = np.sqrt(float(p - r) ** 2 + 4.0 * float(q) ** 2)
                scores[centre, i] = 0.5 * (p + r - spread) / (GRADIENT_SCALE**2 * side**2)


@compiled
def lattice_corners(scores: Floats, origin: Ints, low: Ints, high: Ints, spacing: int, corners: Ints) -> int:
    """Fill `corners` (cells, 2) with x, y of the best corner of every cell of a lattice; their number.

    The cells are `spacing` pixels wide, the first at `low` and the last before `high` (x, y in the frame).
    `origin` is the place of the first score; the scores must reach one pixel further than the cells, as far
    as the frame does. A corner must be no lower than its eight neighbours. Order: by cell, rows first.
    """
    height, width = scores.shape
    count = 0
    for top in range(low[1] - origin[1], high[1] - origin[1], spacing):
        for left in range(low[0] - origin[0], high[0] - origin[0], spacing):
            highest, x, y = 0.0, -1, -1
            for j in range(top, min(top + spacing, high[1] - origin[1])):
                for i in range(left, min(left + spacing, high[0] - origin[0])):
                    if scores[j, i] > highest:
                        highest, x, y = scores[j, i], i, j
            if x < 0:
                continue
            peak = True
            for j in range(max(y - 1, 0), min(y + 2, height)):
                for i in range(max(x - 1, 0), min(x + 2, width)):
                    peak = peak and scores[j, i] <= highest
            if peak:
                corners[count, 0] = origin[0] + x
                corners[count, 1] = origin[1] + y
                count += 1
    return count


LEVELS = 3
"""Levels of the image pyramid."""
ITERATIONS = 20
"""Steps of Lucas-Kanade per level, at most."""
STOP_PX = 0.03
"""A step shorter than this, in pixels of the level, ends the level."""

FLOW_UNITS = 2.0**20
"""Flow is averaged in steps of one over this, pixels."""


@compiled
def _copy(level: Bytes, left: int, top: int, rows: int, stride: int, raw: Singles) -> None:
    """Fill `raw` with `rows` rows of `stride` pixels from (left, top) on; edge pixels repeat outside."""
    height, width = level.shape
    if left >= 0 and top >= 0 and left + stride <= width and top + rows <= height:
        for j in range(rows):
            source, row = level[top + j, left : left + stride], raw[j * stride : (j + 1) * stride]
            for i in range(stride):
                row[i] = source[i]
    else:
        for j in range(rows):
            source, row = level[min(max(top + j, 0), height - 1)], raw[j * stride : (j + 1) * stride]
            for i in range(stride):
                row[i] = source[min(max(left + i, 0), width - 1)]


# A window is held flat, its rows `size + 3` apart: one long loop is vectorised where many short ones are not.
# The last three of a row are no part of it; there the gradients are 0.


@compiled_summing
def _gradients(
    raw: Singles,
    fx: float,
    fy: float,
    size: int,
    mask: Singles,
    smooth: Singles,
    patch: Singles,
    slopes: Singles,
) -> tuple[float, float, float]:
    """Fill `patch` with the source, (fx, fy) off `raw`, and `slopes` with its gradient.

    `raw` is one pixel larger than the patch on each side, and one more to the right and below.
    Returns the sums of the gradient's products: xx, xy, yy.
    """
    stride = size + 3
    w00, w01, w10, w11 = _weights(fx, fy)
    right, next_row, diagonal = raw[1:], raw[stride:], raw[stride + 1 :]
    for k in range((size + 2) * stride):
        smooth[k] = w00 * raw[k] + w01 * right[k] + w10 * next_row[k] + w11 * diagonal[k]
    upper, lower = smooth[1:], smooth[2 * stride + 1 :]
    previous, centre, following = smooth[stride:], smooth[stride + 1 :], smooth[stride + 2 :]
    slope_x, slope_y = slopes[0], slopes[1]
    xx, xy, yy = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range(size * stride):
        half = np.float32(0.5) * mask[k]
        u, v = half * (following[k] - previous[k]), half * (lower[k] - upper[k])
        slope_x[k], slope_y[k], patch[k] = u, v, centre[k]
        xx += u * u
        xy += u * v
        yy += v * v
    return float(xx), float(xy), float(yy)


@compiled_summing
def _mismatch(
    raw: Singles, fx: float, fy: float, size: int, patch: Singles, slopes: Singles
) -> tuple[float, float]:
    """Sums over the window of (patch - target) times the gradient; the target lies (fx, fy) off `raw`."""
    stride = size + 3
    w00, w01, w10, w11 = _weights(fx, fy)
    right, next_row, diagonal = raw[1:], raw[stride:], raw[stride + 1 :]
    slope_x, slope_y = slopes[0], slopes[1]
    sum_x, sum_y = np.float32(0.0), np.float32(0.0)
    for k in range(size * stride):
        error = patch[k] - (w00 * raw[k] + w01 * right[k] + w10 * next_row[k] + w11 * diagonal[k])
        sum_x += error * slope_x[k]
        sum_y += error * slope_y[k]
    return float(sum_x), float(sum_y)


@compiled
def _weights(fx: float, fy: float) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Bilinear weights of a pixel, the one right of it, the one below, and the one below that."""
    gx, gy = 1.0 - fx, 1.0 - fy
    return np.float32(gx * gy), np.float32(fx * gy), np.float32(gx * fy), np.float32(fx * fy)


@compiled
def _track_level(
    source: Bytes,
    target: Bytes,
    x: int,
    y: int,
    start: Floats,
    flow: Floats,
    size: int,
    mask: Singles,
    windows: Singles,
    limit: float,
) -> bool:
    """One level of Lucas-Kanade: moves `flow` so that target(p + start + flow) looks like source(p + start).

    False when the patch has no texture, or when start + flow exceeds `limit` pixels of this level.
    """
    half, stride = size // 2, size + 3
    raw, smooth, patch, slopes = windows[0], windows[1], windows[2], windows[3:]
    whole_x, whole_y = int(np.floor(start[0])), int(np.floor(start[1]))
    _copy(source, x + whole_x - half - 1, y + whole_y - half - 1, stride, stride, raw)
    xx, xy, yy = _gradients(raw, start[0] - whole_x, start[1] - whole_y, size, mask, smooth, patch, slopes)
    determinant = xx * yy - xy * xy
    if determinant <= 1e-6 * (xx + yy) ** 2 or determinant <= 0.0:
        return False
    for step in range(ITERATIONS):
        at_x, at_y = start[0] + flow[0], start[1] + flow[1]
        pixel_x, pixel_y = int(np.floor(at_x)), int(np.floor(at_y))
        if step == 0 or pixel_x != whole_x or pixel_y != whole_y:
            whole_x, whole_y = pixel_x, pixel_y
            _copy(target, x + whole_x - half, y + whole_y - half, size + 1, stride, raw)
        sum_x, sum_y = _mismatch(raw, at_x - whole_x, at_y - whole_y, size, patch, slopes)
        step_x = (yy * sum_x - xy * sum_y) / determinant
        step_y = (xx * sum_y - xy * sum_x) / determinant
        flow[0] += step_x
        flow[1] += step_y
        if not (abs(start[0] + flow[0]) <= limit and abs(start[1] + flow[1]) <= limit):
            return False
        if step_x * step_x + step_y * step_y < STOP_PX * STOP_PX:
            break
    return True


@compiled
def track_points(
    coarse_source: Bytes,
    middle_source: Bytes,
    fine_source: Bytes,
    coarse_target: Bytes,
    middle_target: Bytes,
    fine_target: Bytes,
    points: Ints,
    origin: Ints,
    window: int,
    reach: float,
    agree: float,
    flows: Floats,
    valid: Bytes,
) -> None:
    """Pyramidal Lucas-Kanade on three levels from the source to the target frame, and back as a check.

    Fills `flows` (P, 2), pixels, and `valid` (P,): 1 where the point stays within about `reach` pixels in x
    and in y on every level, and tracking back from where it ended returns to within `agree` pixels of it.

    Args:
        coarse_source .. fine_target: crops of the two frames, each level half as wide as the next finer one.
        points: (P, 2) x, y in the frame. They must lie so far inside the crop that no window within reach
            leaves it, except where the crop ends with the frame (there edge pixels repeat).
        origin: column and row in the frame of the crop's first pixel, multiples of 4.
        window: odd side of the compared patch, pixels of each level.
    """
    stride = window + 3
    windows = np.zeros((5, (window + 5) * stride), np.float32)
    mask = np.zeros(window * stride, np.float32)
    for j in range(window):
        mask[j * stride : j * stride + window] = np.float32(1.0)
    start, moves = np.zeros(2), np.zeros((2, 2))
    flow, back = moves[0], moves[1]
    height, width = fine_source.shape
    for n in range(points.shape[0]):
        x, y = points[n, 0] - origin[0], points[n, 1] - origin[1]
        good, valid[n] = True, 0
        for way in range(2):  # one loop, so that a level is compiled once
            move = moves[way]
            move[0] = move[1] = 0.0
            shift_x, shift_y = (flow[0], flow[1]) if way else (0.0, 0.0)
            for scale in (4, 2, 1):
                source = coarse_source if scale == 4 else middle_source if scale == 2 else fine_source
                target = coarse_target if scale == 4 else middle_target if scale == 2 else fine_target
                if scale < 4:
                    move[0], move[1] = 2.0 * move[0], 2.0 * move[1]
                start[0], start[1] = (x % scale + shift_x) / scale, (y % scale + shift_y) / scale
                good = good and _track_level(
                    target if way else source,
                    source if way else target,
                    x // scale,
                    y // scale,
                    start,
                    move,
                    window,
                    mask,
                    windows,
                    reach / scale + 1.0,
                )
            end_x, end_y = x + flow[0], y + flow[1]
            good = good and -0.5 <= end_x <= width - 0.5 and -0.5 <= end_y <= height - 0.5
            if not good:
                break
        flows[n, 0], flows[n, 1] = flow[0], flow[1]
        error_x, error_y = flow[0] + back[0], flow[1] + back[1]
        if good and error_x * error_x + error_y * error_y <= agree * agree:
            valid[n] = 1


@compiled_summing
def flow_in_boxes(points: Floats, boxes: Floats, counts: Floats, means: Floats) -> None:
    """Fill `counts` (N,) and `means` (N, 2): how many points lie in each box, and their mean flow.

    `points` (P, 4) x, y, dx, dy, `boxes` (N, 4) centre boxes, edges included. Without a point the mean is 0.
    Flow is rounded to 1 / FLOW_UNITS pixel, so that sums are exact: points outside a box cannot touch them.
    """
    size = points.shape[0]
    xs, ys, dxs, dys = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    lowest, highest = np.empty(size), np.empty(size)  # y from here on, and up to here
    for k in range(size):
        xs[k], ys[k] = points[k, 0], points[k, 1]
        dxs[k] = np.rint(points[k, 2] * FLOW_UNITS) / FLOW_UNITS
        dys[k] = np.rint(points[k, 3] * FLOW_UNITS) / FLOW_UNITS
        highest[k] = max(highest[k - 1], ys[k]) if k > 0 else ys[k]
    for k in range(size - 1, -1, -1):
        lowest[k] = min(lowest[k + 1], ys[k]) if k + 1 < size else ys[k]
    for n in range(boxes.shape[0]):
        half_w, half_h = 0.5 * boxes[n, 2], 0.5 * boxes[n, 3]
        left, right = boxes[n, 0] - half_w, boxes[n, 0] + half_w
        top, bottom = boxes[n, 1] - half_h, boxes[n, 1] + half_h
        # Points come in rows of the lattice, so that those as high as the box follow each other.
        # By halves; `np.searchsorted` would take as long to compile as all the rest.
        first, past, end = 0, 0, size
        while first < end:
            middle = (first + end) // 2
            first, end = (middle + 1, end) if highest[middle] < top else (first, middle)
        end = size
        while past < end:
            middle = (past + end) // 2
            past, end = (middle + 1, end) if lowest[middle] <= bottom else (past, middle)
        x, y, dx, dy = xs[first:past], ys[first:past], dxs[first:past], dys[first:past]
        count, sum_x, sum_y = 0.0, 0.0, 0.0
        for k in range(past - first):
            is_inside = (left <= x[k]) & (x[k] <= right) & (top <= y[k]) & (y[k] <= bottom)
            count += 1.0 if is_inside else 0.0
            sum_x += dx[k] if is_inside else 0.0
            sum_y += dy[k] if is_inside else 0.0
        counts[n] = count
        means[n, 0] = sum_x / count if count > 0.0 else 0.0
        means[n, 1] = sum_y / count if count > 0.0 else 0.0


@compiled
def consensus(
    source: Floats, target: Floats, tolerance: float, min_distance: float, max_scale: float
) -> Bools:
    """(N,) True for the points that one translation or one similarity takes to within `tolerance` px.

    All are tried: the translation of every point, and the similarity of every two points at least
    `min_distance` px from each other that changes sizes by a factor of `max_scale` at most. The one with the
    most points wins, not counting those that define it (1 or 2); of two equal ones that with the smaller
    squares. No randomness.
    """
    size = len(source)
    agreeing, trial = np.zeros(size, np.bool_), np.zeros(size, np.bool_)
    best_count, best_squares = -1, 0.0
    for i in range(size):
        for j in range(i, size):
            dx, dy = source[j, 0] - source[i, 0], source[j, 1] - source[i, 1]
            ex, ey = target[j, 0] - target[i, 0], target[j, 1] - target[i, 1]
            real, imaginary = 1.0, 0.0
            if j > i:
                squared_length = dx * dx + dy * dy
                if squared_length < min_distance * min_distance:
                    continue
                real, imaginary = (dx * ex + dy * ey) / squared_length, (dx * ey - dy * ex) / squared_length
                factor = np.sqrt(real * real + imaginary * imaginary)
                if not 1.0 / max_scale <= factor <= max_scale:
                    continue
            count, squares = (-2 if j > i else -1), 0.0
            for k in range(size):
                x, y = source[k, 0] - source[i, 0], source[k, 1] - source[i, 1]
                off_x = target[k, 0] - target[i, 0] - (real * x - imaginary * y)
                off_y = target[k, 1] - target[i, 1] - (imaginary * x + real * y)
                error = off_x * off_x + off_y * off_y
                trial[k] = error <= tolerance * tolerance
                if trial[k]:
                    count += 1
                    squares += error
            if count > best_count or (count == best_count and squares < best_squares):
                best_count, best_squares = count, squares
                copy_row(trial, agreeing)
    return agreeing
