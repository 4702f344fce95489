"""Compiled kernels that find the corners to be tracked: the best one of every cell of a lattice."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Bytes, Floats, Ints
from bayesnet_track.numerics.compiled import compiled

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
