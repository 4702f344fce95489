"""Compiled kernels of shapes: snakes, signed distances to closed contours, and distances to a model.

Kass, Witkin & Terzopoulos 1988, semi-implicit: each step moves every point toward its nearest edge and then
solves ``(I + a D2 + b D4) x' = x`` for the tension a and the rigidity b. The system is circulant, so that its
inverse is one smoothing filter, made once.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.compiled import compiled, compiled_summing
from bayesnet_track.numerics.resampling import copy_rows

POINTS = 64
"""Points of a snake."""

STAGES = ((0.02, 2.0, 6), (0.01, 0.2, 6), (0.005, 0.03, 10))
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
    filters[:, points // 2] = 0.0
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
    right, next_row = min(i + 1, columns - 1), min(j + 1, rows - 1)
    a, b = min(distance[j, i], limit), min(distance[j, right], limit)
    c, d = min(distance[next_row, i], limit), min(distance[next_row, right], limit)
    top, bottom = a + u * (b - a), c + u * (d - c)
    return top + v * (bottom - top), (1.0 - v) * (b - a) + v * (d - c), bottom - top


@compiled
def _is_inside(x: float, y: float, frame: Ints) -> bool:
    return bool(-0.5 <= x < frame[0] - 0.5 and -0.5 <= y < frame[1] - 0.5)


@compiled
def _pull(distance: Floats, origin: Ints, frame: Ints, reach: float, points: Floats) -> None:
    """Move each point (2, M) a share of the way to its nearest edge, when that is within `reach` px."""
    for m in range(points.shape[1]):
        x, y = points[0, m], points[1, m]
        if not _is_inside(x, y, frame):
            continue
        gap, gx, gy = _look(distance, x - origin[0], y - origin[1], reach)
        length = np.sqrt(gx * gx + gy * gy)
        if gap < reach and length > 1e-9:
            points[0, m] -= PULL * gap * gx / length
            points[1, m] -= PULL * gap * gy / length


@compiled
def _smooth(points: Floats, kernel: Floats, wide: Floats, smoothed: Floats) -> None:
    """Fill `smoothed` (2, M) with the points smoothed by the circulant symmetric `kernel` (M,).

    `wide` (2, 2 M) is room for the points once more, so that no index has to wrap round: vector instructions
    can be used.
    """
    count = points.shape[1]
    half = count // 2
    for axis in range(2):
        row, line = wide[axis], smoothed[axis]
        for m in range(2 * count):
            row[m] = points[axis, (m + half) % count]
        for m in range(count):
            line[m] = kernel[0] * points[axis, m]
        for lag in range(1, half):
            weight = kernel[lag]
            if weight == 0.0:
                continue
            following, preceding = row[half + lag : half + lag + count], row[half - lag : half - lag + count]
            for m in range(count):
                line[m] += weight * (following[m] + preceding[m])


@compiled
def _even(points: Floats, placed: Floats) -> None:
    """Fill `placed` (2, M) with even points along the closed polygon `points` (2, P), from its first."""
    count, size = points.shape[1], placed.shape[1]
    lengths = np.empty(count)
    total = 0.0
    for m in range(count):
        next_index = (m + 1) % count
        lengths[m] = np.sqrt(
            (points[0, next_index] - points[0, m]) ** 2 + (points[1, next_index] - points[1, m]) ** 2
        )
        total += lengths[m]
    side, passed = 0, 0.0
    for k in range(size):
        target = total * k / size
        while side < count - 1 and passed + lengths[side] < target:
            passed += lengths[side]
            side += 1
        next_index = (side + 1) % count
        share = (target - passed) / lengths[side] if lengths[side] > 0.0 else 0.0
        share = min(max(share, 0.0), 1.0)
        placed[0, k] = points[0, side] + share * (points[0, next_index] - points[0, side])
        placed[1, k] = points[1, side] + share * (points[1, next_index] - points[1, side])


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
    points, smoothed, wide = np.empty((2, count)), np.empty((2, count)), np.empty((2, 2 * count))
    for c in range(boxes.shape[0]):
        x, y, w, h = boxes[c, 0], boxes[c, 1], boxes[c, 2], boxes[c, 3]
        side = np.sqrt(w * h)
        for m in range(count):
            angle = 2.0 * np.pi * m / count
            smoothed[0, m] = x + 0.5 * w * np.cos(angle)
            smoothed[1, m] = y + 0.5 * h * np.sin(angle)
        _even(smoothed, points)
        for stage in range(filters.shape[0]):
            for _ in range(steps[stage]):
                _pull(distance, origin, frame, reach * side, points)
                _smooth(points, filters[stage], wide, smoothed)
                for m in range(count):
                    points[0, m] = min(max(smoothed[0, m], x - 0.5 * BOUND * w), x + 0.5 * BOUND * w)
                    points[1, m] = min(max(smoothed[1, m], y - 0.5 * BOUND * h), y + 0.5 * BOUND * h)
            _even(points, smoothed)
            copy_rows(smoothed, points)
        hits, limit = 0, max(tolerance * side, 1.5)
        for m in range(count):
            snakes[c, m, 0], snakes[c, m, 1] = points[0, m], points[1, m]
            if _is_inside(points[0, m], points[1, m], frame) and (
                _look(distance, points[0, m] - origin[0], points[1, m] - origin[1], 2.0 * limit)[0] <= limit
            ):
                hits += 1
        support[c] = hits / count


@compiled
def map_points(matrix: Floats, points: Floats, mapped: Floats) -> None:
    """Fill `mapped` (C, A, 2) with `matrix` (A, B) times each run of `points` (C, B, 2)."""
    for c in range(points.shape[0]):
        for a in range(matrix.shape[0]):
            x, y = 0.0, 0.0
            for b in range(matrix.shape[1]):
                x += matrix[a, b] * points[c, b, 0]
                y += matrix[a, b] * points[c, b, 1]
            mapped[c, a, 0], mapped[c, a, 1] = x, y


@compiled
def signed_distance(contour: Floats, xs: Floats, ys: Floats, field: Floats) -> None:
    """Fill `field` (rows, columns) with the distance to the closed polygon `contour` (P, 2), negative inside.

    Columns lie at `xs`, rows at `ys`. Inside is where a ray crosses the polygon an odd number of times.
    """
    count = contour.shape[0]
    sides = np.empty((count, 5))
    for p in range(count):
        next_index = (p + 1) % count
        dx, dy = contour[next_index, 0] - contour[p, 0], contour[next_index, 1] - contour[p, 1]
        square = dx * dx + dy * dy
        scale = 1.0 / square if square > 0.0 else 0.0
        sides[p, 0], sides[p, 1], sides[p, 2], sides[p, 3] = contour[p, 0], contour[p, 1], dx, dy
        sides[p, 4] = scale
    nearest, sign = np.empty(xs.shape[0]), np.empty(xs.shape[0])
    for j in range(ys.shape[0]):
        nearest[:] = np.inf
        sign[:] = 1.0
        for p in range(count):
            x0, dx, dy, scale = sides[p, 0], sides[p, 2], sides[p, 3], sides[p, 4]
            v = ys[j] - sides[p, 1]
            for i in range(xs.shape[0]):  # column by column, so that vector instructions can be used
                u = xs[i] - x0
                t = min(max((u * dx + v * dy) * scale, 0.0), 1.0)
                a, b = u - t * dx, v - t * dy
                nearest[i] = min(nearest[i], a * a + b * b)
            # The corner itself is compared, not differences: two sides that share it must agree on its row.
            if (ys[j] >= contour[p, 1]) != (ys[j] >= contour[(p + 1) % count, 1]):
                crossing = x0 + dx * v / dy
                for i in range(xs.shape[0]):
                    sign[i] = -sign[i] if xs[i] > crossing else sign[i]
        for i in range(xs.shape[0]):
            field[j, i] = sign[i] * np.sqrt(nearest[i])


@compiled
def cell_fields(contours: Floats, boxes: Floats, cover: float, fields: Floats) -> None:
    """Fill `fields` (C, S, S) with the signed distances (px) to each contour (C, P, 2) around its box (C, 4).

    The S x S points span the centre box grown by the factor `cover`, borders included.
    """
    size = fields.shape[1]
    xs, ys = np.empty(size), np.empty(size)
    for c in range(boxes.shape[0]):
        for i in range(size):
            part = cover * (i / (size - 1.0) - 0.5)
            xs[i], ys[i] = boxes[c, 0] + part * boxes[c, 2], boxes[c, 1] + part * boxes[c, 3]
        signed_distance(contours[c], xs, ys, fields[c])


@compiled
def shape_vector(field: Floats, cell: Floats, cover: float, box: Floats, vector: Floats) -> None:
    """Fill `vector` (G * G,) with the field at the centres of G x G equal cells of the centre box (4,).

    Bilinear between the field's points. The unit is half of the box's mean side, sqrt(w h) / 2, so that the
    vector is the same at any place and scale.
    """
    size, grid = field.shape[0], round(np.sqrt(vector.shape[0]))
    unit = 2.0 / np.sqrt(box[2] * box[3])
    columns, rows = np.empty(grid), np.empty(grid)
    for g in range(grid):
        part = (g + 0.5) / grid - 0.5
        for axis in range(2):
            position = ((box[axis] + part * box[2 + axis] - cell[axis]) / (cover * cell[2 + axis]) + 0.5) * (
                size - 1
            )
            position = min(max(position, 0.0), size - 1.0)
            if axis == 0:
                columns[g] = position
            else:
                rows[g] = position
    for j in range(grid):
        row = min(int(rows[j]), size - 2)
        v = rows[j] - row
        for i in range(grid):
            column = min(int(columns[i]), size - 2)
            u = columns[i] - column
            upper = (1.0 - u) * field[row, column] + u * field[row, column + 1]
            lower = (1.0 - u) * field[row + 1, column] + u * field[row + 1, column + 1]
            vector[j * grid + i] = unit * ((1.0 - v) * upper + v * lower)


@compiled_summing
def shape_energy(vector: Floats, mean: Floats, modes: Floats, variances: Floats, noise: float) -> float:
    """Squared Mahalanobis distance under N(mean, modes' diag(variances) modes + noise I).

    ``|r|^2 / noise + sum_k y_k^2 / (variance_k + noise)``, y the coordinates of ``vector - mean`` in the
    orthonormal `modes` (K, G * G) and r what is left outside them. Thesis eq. 3.7 with the residual: without
    it every shape whose coordinates are 0 would be perfect.
    """
    total = 0.0
    for p in range(vector.shape[0]):
        deviation = vector[p] - mean[p]
        total += deviation * deviation
    explained, energy = 0.0, 0.0
    for k in range(modes.shape[0]):
        y = 0.0
        for p in range(vector.shape[0]):
            y += modes[k, p] * (vector[p] - mean[p])
        explained += y * y
        energy += y * y / (variances[k] + noise)
    return energy + max(total - explained, 0.0) / noise


@compiled
def score_shapes(
    fields: Floats,
    cells: Floats,
    cover: float,
    owner: Ints,
    boxes: Floats,
    mean: Floats,
    modes: Floats,
    variances: Floats,
    noise: float,
    energies: Floats,
) -> None:
    """Fill `energies` (N,) with the `shape_energy` of each box (N, 4) in the field of its cell `owner` (N,).

    A box whose owner is negative has no field; its energy is left alone.
    """
    vector = np.empty(mean.shape[0])
    for n in range(boxes.shape[0]):
        c = owner[n]
        if c >= 0:
            shape_vector(fields[c], cells[c], cover, boxes[n], vector)
            energies[n] = shape_energy(vector, mean, modes, variances, noise)
