"""Compiled kernels for sparse optical flow: corners of a lattice, Lucas-Kanade tracking, flow inside boxes.

Whatever is computed for a point is computed from whole-number pixel positions and offsets from them, so that
the bits of the result do not depend on where a crop starts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]

BLOCK = 2
"""The gradient matrix of a corner sums over (2 BLOCK + 1)^2 pixels."""
RIM = BLOCK + 1
"""A pixel's corner score depends on the pixels up to this far away."""
GRADIENT_SCALE = 8.0
"""The Sobel operator gives this many times the gradient in gray levels per pixel."""
LEVELS = 3
"""Levels of the image pyramid."""
ITERATIONS = 20
"""Steps of Lucas-Kanade per level, at most."""
STOP_PX = 0.03
"""A step shorter than this, in pixels of the level, ends the level."""


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
def lattice_corners(scores: Floats, origin: Ints, low: Ints, high: Ints, spacing: int, found: Ints) -> int:
    """Fill `found` (cells, 2) with x, y of the best corner of every cell of a lattice; returns their number.

    The cells are `spacing` pixels wide, the first at `low` and the last before `high` (x, y in the frame).
    `origin` is the place of the first score; the scores must reach one pixel further than the cells, as far
    as the frame does. A corner must be no lower than its eight neighbours. Order: by cell, rows first.
    """
    height, width = scores.shape
    count = 0
    for top in range(low[1] - origin[1], high[1] - origin[1], spacing):
        for left in range(low[0] - origin[0], high[0] - origin[0], spacing):
            best, x, y = 0.0, -1, -1
            for j in range(top, min(top + spacing, high[1] - origin[1])):
                for i in range(left, min(left + spacing, high[0] - origin[0])):
                    if scores[j, i] > best:
                        best, x, y = scores[j, i], i, j
            if x < 0:
                continue
            peak = True
            for j in range(max(y - 1, 0), min(y + 2, height)):
                for i in range(max(x - 1, 0), min(x + 2, width)):
                    peak = peak and scores[j, i] <= best
            if peak:
                found[count, 0] = origin[0] + x
                found[count, 1] = origin[1] + y
                count += 1
    return count


@compiled
def _sample(level: Bytes, x: int, y: int, dx: float, dy: float, patch: Floats) -> None:
    """Fill `patch` (n, n) with the image around (x + dx, y + dy), bilinear; edge pixels repeat outside."""
    size = patch.shape[0]
    half = size // 2
    whole_x, whole_y = int(np.floor(dx)), int(np.floor(dy))
    fx, fy = dx - whole_x, dy - whole_y
    w00, w01, w10, w11 = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    left, top = x + whole_x - half, y + whole_y - half
    height, width = level.shape
    if left >= 0 and top >= 0 and left + size < width and top + size < height:
        for j in range(size):
            upper, lower = level[top + j, left : left + size + 1], level[top + j + 1, left : left + size + 1]
            for i in range(size):
                patch[j, i] = w00 * upper[i] + w01 * upper[i + 1] + w10 * lower[i] + w11 * lower[i + 1]
    else:
        for j in range(size):
            upper = level[min(max(top + j, 0), height - 1)]
            lower = level[min(max(top + j + 1, 0), height - 1)]
            for i in range(size):
                a, b = min(max(left + i, 0), width - 1), min(max(left + i + 1, 0), width - 1)
                patch[j, i] = w00 * upper[a] + w01 * upper[b] + w10 * lower[a] + w11 * lower[b]


@compiled
def _track_level(
    source: Bytes,
    target: Bytes,
    x: int,
    y: int,
    start: Floats,
    flow: Floats,
    padded: Floats,
    patch: Floats,
    gradients: Floats,
    limit: float,
) -> bool:
    """One level of Lucas-Kanade: moves `flow` so that target(p + start + flow) looks like source(p + start).

    False when the patch has no texture, or when start + flow exceeds `limit` pixels of this level.
    """
    size = patch.shape[0]
    _sample(source, x, y, start[0], start[1], padded)
    xx, xy, yy = 0.0, 0.0, 0.0
    for j in range(size):
        for i in range(size):
            gx = 0.5 * (padded[j + 1, i + 2] - padded[j + 1, i])
            gy = 0.5 * (padded[j + 2, i + 1] - padded[j, i + 1])
            gradients[0, j, i], gradients[1, j, i] = gx, gy
            xx += gx * gx
            xy += gx * gy
            yy += gy * gy
    determinant = xx * yy - xy * xy
    if determinant <= 1e-6 * (xx + yy) ** 2 or determinant <= 0.0:
        return False
    for _ in range(ITERATIONS):
        _sample(target, x, y, start[0] + flow[0], start[1] + flow[1], patch)
        bx, by = 0.0, 0.0
        for j in range(size):
            for i in range(size):
                error = padded[j + 1, i + 1] - patch[j, i]
                bx += error * gradients[0, j, i]
                by += error * gradients[1, j, i]
        step_x = (yy * bx - xy * by) / determinant
        step_y = (xx * by - xy * bx) / determinant
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
    padded, patch = np.empty((window + 2, window + 2)), np.empty((window, window))
    gradients = np.empty((2, window, window))
    start, there, back = np.zeros(2), np.zeros(2), np.zeros(2)
    height, width = fine_source.shape
    for n in range(points.shape[0]):
        x, y = points[n, 0] - origin[0], points[n, 1] - origin[1]
        good = True
        there[:] = 0.0
        for scale in (4, 2, 1):
            source = coarse_source if scale == 4 else middle_source if scale == 2 else fine_source
            target = coarse_target if scale == 4 else middle_target if scale == 2 else fine_target
            there *= 1.0 if scale == 4 else 2.0
            start[0], start[1] = (x % scale) / scale, (y % scale) / scale
            good = good and _track_level(
                source,
                target,
                x // scale,
                y // scale,
                start,
                there,
                padded,
                patch,
                gradients,
                reach / scale + 1.0,
            )
        flows[n, 0], flows[n, 1] = there[0], there[1]
        valid[n] = 0
        end_x, end_y = x + there[0], y + there[1]
        if not (good and -0.5 <= end_x <= width - 0.5 and -0.5 <= end_y <= height - 0.5):
            continue
        back[:] = 0.0
        for scale in (4, 2, 1):
            source = coarse_source if scale == 4 else middle_source if scale == 2 else fine_source
            target = coarse_target if scale == 4 else middle_target if scale == 2 else fine_target
            back *= 1.0 if scale == 4 else 2.0
            start[0], start[1] = (x % scale + there[0]) / scale, (y % scale + there[1]) / scale
            good = good and _track_level(
                target,
                source,
                x // scale,
                y // scale,
                start,
                back,
                padded,
                patch,
                gradients,
                reach / scale + 1.0,
            )
        error_x, error_y = there[0] + back[0], there[1] + back[1]
        if good and error_x * error_x + error_y * error_y <= agree * agree:
            valid[n] = 1


@compiled
def flow_in_boxes(points: Floats, boxes: Floats, counts: Floats, means: Floats) -> None:
    """Fill `counts` (N,) and `means` (N, 2): how many points lie in each box, and their mean flow.

    `points` (P, 4) x, y, dx, dy, `boxes` (N, 4) centre boxes, edges included. Without a point the mean is 0.
    Sums run in the order of the points.
    """
    for n in range(boxes.shape[0]):
        half_w, half_h = 0.5 * boxes[n, 2], 0.5 * boxes[n, 3]
        left, right = boxes[n, 0] - half_w, boxes[n, 0] + half_w
        top, bottom = boxes[n, 1] - half_h, boxes[n, 1] + half_h
        count, sum_x, sum_y = 0, 0.0, 0.0
        for k in range(points.shape[0]):
            if left <= points[k, 0] <= right and top <= points[k, 1] <= bottom:
                count += 1
                sum_x += points[k, 2]
                sum_y += points[k, 3]
        counts[n] = count
        means[n, 0] = sum_x / count if count > 0 else 0.0
        means[n, 1] = sum_y / count if count > 0 else 0.0
