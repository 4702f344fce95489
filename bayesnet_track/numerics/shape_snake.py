"""A snake: a closed curve drawn to the nearest edges and held smooth, from the ellipse of a box.

Kass, Witkin & Terzopoulos 1988, semi-implicit: each step moves every point toward its nearest edge and then
solves ``(I + a D2 + b D4) x' = x`` for the tension a and the rigidity b. The system is circulant, so that its
inverse is one smoothing filter, made once.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

POINTS = 64
"""Points of a snake."""

STAGES = ((0.02, 2.0, 12), (0.01, 0.2, 12), (0.005, 0.03, 16))
"""Tension, rigidity and steps: stiff first, so that single edges do not catch it, then supple."""

PULL = 0.5
"""Share of the way to the nearest edge that a point goes in one step."""

BOUND = 1.2
"""A snake stays within its box grown by this factor."""


@cache
def smoothing_filters(points: int = POINTS) -> Floats:
    """(stages, points): the first row of ``(I + a D2 + b D4)^-1``, a circulant matrix, for each stage.

    D2 and D4 are the second and fourth cyclic differences (positive definite signs). Weights below 1e-5 are
    left out; each row sums to 1.
    """
    wave = 2.0 - 2.0 * np.cos(2.0 * np.pi * np.arange(points) / points)
    rows = [np.fft.ifft(1.0 / (1.0 + a * wave + b * wave**2)).real for a, b, _ in STAGES]
    filters = np.array(rows)
    filters[np.abs(filters) < 1e-5] = 0.0
    filters /= filters.sum(axis=1, keepdims=True)
    filters.flags.writeable = False
    return filters


@compiled
def _look(distance: Floats, x: float, y: float, limit: float) -> tuple[float, float, float]:
    """The map at (x, y), bilinear and at most `limit`, and its slopes; its border goes on outside."""
    rows, columns = distance.shape
    x = min(max(x, 0.0), columns - 1.0)
    y = min(max(y, 0.0), rows - 1.0)
    i, j = int(x), int(y)
    u, v = x - i, y - j
    right, below = min(i + 1, columns - 1), min(j + 1, rows - 1)
    a, b = min(distance[j, i], limit), min(distance[j, right], limit)
    c, d = min(distance[below, i], limit), min(distance[below, right], limit)
    top, bottom = a + u * (b - a), c + u * (d - c)
    return top + v * (bottom - top), (1.0 - v) * (b - a) + v * (d - c), bottom - top


@compiled
def _inside(x: float, y: float, frame: Ints) -> bool:
    return bool(-0.5 <= x < frame[0] - 0.5 and -0.5 <= y < frame[1] - 0.5)


@compiled
def _pull(distance: Floats, origin: Ints, frame: Ints, reach: float, points: Floats) -> None:
    """Move each point (M, 2) a share of the way to its nearest edge, when that is within `reach` px."""
    for m in range(points.shape[0]):
        x, y = points[m, 0], points[m, 1]
        if not _inside(x, y, frame):
            continue
        away, gx, gy = _look(distance, x - origin[0], y - origin[1], reach)
        length = np.sqrt(gx * gx + gy * gy)
        if away < reach and length > 1e-9:
            points[m, 0] -= PULL * away * gx / length
            points[m, 1] -= PULL * away * gy / length


@compiled
def _smooth(points: Floats, kernel: Floats, moved: Floats) -> None:
    """Fill `moved` (M, 2) with the points smoothed by the circulant `kernel` (M,)."""
    count = points.shape[0]
    moved[:] = 0.0
    for lag in range(count):
        weight = kernel[lag]
        if weight == 0.0:
            continue
        for m in range(count - lag):
            moved[m, 0] += weight * points[m + lag, 0]
            moved[m, 1] += weight * points[m + lag, 1]
        for m in range(count - lag, count):
            moved[m, 0] += weight * points[m + lag - count, 0]
            moved[m, 1] += weight * points[m + lag - count, 1]


@compiled
def _even(points: Floats, placed: Floats) -> None:
    """Fill `placed` (M, 2) with even points along the closed polygon `points` (P, 2), from its first."""
    count, wanted = points.shape[0], placed.shape[0]
    lengths = np.empty(count)
    total = 0.0
    for m in range(count):
        after = (m + 1) % count
        lengths[m] = np.sqrt((points[after, 0] - points[m, 0]) ** 2 + (points[after, 1] - points[m, 1]) ** 2)
        total += lengths[m]
    side, passed = 0, 0.0
    for k in range(wanted):
        target = total * k / wanted
        while side < count - 1 and passed + lengths[side] < target:
            passed += lengths[side]
            side += 1
        after = (side + 1) % count
        share = (target - passed) / lengths[side] if lengths[side] > 0.0 else 0.0
        share = min(max(share, 0.0), 1.0)
        placed[k, 0] = points[side, 0] + share * (points[after, 0] - points[side, 0])
        placed[k, 1] = points[side, 1] + share * (points[after, 1] - points[side, 1])


@compiled
def run_snakes(
    distance: Floats,
    origin: Ints,
    frame: Ints,
    boxes: Floats,
    filters: Floats,
    steps: Ints,
    reach: float,
    tolerance: float,
    snakes: Floats,
    support: Floats,
) -> None:
    """Fill `snakes` (C, M, 2), in frame px, and `support` (C,) from the ellipses of `boxes` (C, 4).

    `support` is the share of a snake's points inside the frame and within the tolerance of an edge. The
    points start at the right and run clockwise on the screen, evenly spaced. No value depends on more of the
    map than the box grown by `BOUND` and the reach.

    Args:
        distance: px to the nearest edge pixel, from column `origin[0]` and row `origin[1]` of the frame on.
        frame: its width and height.
        filters: (stages, M) from `smoothing_filters`.
        steps: (stages,) steps of each.
        reach: how far a point sees an edge, in mean sides of its box.
        tolerance: how far from an edge it still counts as on it, in mean sides; at least 1.5 px.
    """
    count = snakes.shape[1]
    points, moved = np.empty((count, 2)), np.empty((count, 2))
    for c in range(boxes.shape[0]):
        x, y, w, h = boxes[c, 0], boxes[c, 1], boxes[c, 2], boxes[c, 3]
        side = np.sqrt(w * h)
        for m in range(count):
            angle = 2.0 * np.pi * m / count
            moved[m, 0] = x + 0.5 * w * np.cos(angle)
            moved[m, 1] = y + 0.5 * h * np.sin(angle)
        _even(moved, points)
        for stage in range(filters.shape[0]):
            for _ in range(steps[stage]):
                _pull(distance, origin, frame, reach * side, points)
                _smooth(points, filters[stage], moved)
                for m in range(count):
                    points[m, 0] = min(max(moved[m, 0], x - 0.5 * BOUND * w), x + 0.5 * BOUND * w)
                    points[m, 1] = min(max(moved[m, 1], y - 0.5 * BOUND * h), y + 0.5 * BOUND * h)
            _even(points, moved)
            points[:] = moved
        near, limit = 0, max(tolerance * side, 1.5)
        for m in range(count):
            snakes[c, m, 0], snakes[c, m, 1] = points[m, 0], points[m, 1]
            if _inside(points[m, 0], points[m, 1], frame) and (
                _look(distance, points[m, 0] - origin[0], points[m, 1] - origin[1], 2.0 * limit)[0] <= limit
            ):
                near += 1
        support[c] = near / count
