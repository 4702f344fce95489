"""Signed distances to closed contours, their values in a box, and how far a shape is from a model."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.compiled import compiled, compiled_summing


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
        after = (p + 1) % count
        dx, dy = contour[after, 0] - contour[p, 0], contour[after, 1] - contour[p, 1]
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
    across, down = np.empty(grid), np.empty(grid)
    for g in range(grid):
        part = (g + 0.5) / grid - 0.5
        for axis in range(2):
            at = ((box[axis] + part * box[2 + axis] - cell[axis]) / (cover * cell[2 + axis]) + 0.5) * (
                size - 1
            )
            at = min(max(at, 0.0), size - 1.0)
            if axis == 0:
                across[g] = at
            else:
                down[g] = at
    for j in range(grid):
        row = min(int(down[j]), size - 2)
        v = down[j] - row
        for i in range(grid):
            column = min(int(across[i]), size - 2)
            u = across[i] - column
            above = (1.0 - u) * field[row, column] + u * field[row, column + 1]
            below = (1.0 - u) * field[row + 1, column] + u * field[row + 1, column + 1]
            vector[j * grid + i] = unit * ((1.0 - v) * above + v * below)


@compiled_summing
def shape_energy(vector: Floats, mean: Floats, modes: Floats, variances: Floats, noise: float) -> float:
    """Squared Mahalanobis distance under N(mean, modes' diag(variances) modes + noise I).

    ``|r|^2 / noise + sum_k y_k^2 / (variance_k + noise)``, y the coordinates of ``vector - mean`` in the
    orthonormal `modes` (K, G * G) and r what is left outside them. Thesis eq. 3.7 with the residual: without
    it every shape whose coordinates are 0 would be perfect.
    """
    total = 0.0
    for p in range(vector.shape[0]):
        off = vector[p] - mean[p]
        total += off * off
    inside, energy = 0.0, 0.0
    for k in range(modes.shape[0]):
        y = 0.0
        for p in range(vector.shape[0]):
            y += modes[k, p] * (vector[p] - mean[p])
        inside += y * y
        energy += y * y / (variances[k] + noise)
    return energy + max(total - inside, 0.0) / noise


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
