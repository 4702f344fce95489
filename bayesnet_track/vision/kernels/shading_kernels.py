"""Compiled kernel that projects the patch under each box on smooth patterns: polynomials on a grid."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.vision.kernels.patch_kernels import cell_means, corner_sums, edge_units, split_edges


@compiled
def patch_projections(
    integral: Floats,
    boxes: Floats,
    origin: Ints,
    frame: Ints,
    weights: Floats,
    lines: Floats,
    found: Floats,
) -> None:
    """Fill `found` (N, 1 + K): the weight of a box's cells inside the frame, then K projections.

    The projection on the polynomials a across and b down is the sum of w p_a p_b (v - m) over the cells: v is
    a cell's mean, w `weights` (G,) of its column times that of its row and the share of it inside the frame,
    m the mean of v under w, p_a row a of `lines` (D + 1, G). There is one for each a + b in 1 .. D, in the
    order of a + b and then of b. All are 0 for a box outside the frame, narrower than G / 1024 px, or not
    finite. The first four arguments are those of `patch_kernels.patch_moments`.
    """
    cells, powers = weights.shape[0], lines.shape[0]
    flat, stride, tall = integral.ravel(), integral.shape[1], integral.shape[0]
    x_units, y_units = np.empty(cells + 1, np.int64), np.empty(cells + 1, np.int64)
    x_spans, y_spans = np.empty(cells, np.int64), np.empty(cells, np.int64)
    columns, rows = np.empty(cells + 1, np.int64), np.empty(cells + 1, np.int64)
    column_parts, row_parts = np.empty(cells + 1), np.empty(cells + 1)
    sums = np.empty((cells + 1, cells + 1))
    means, shares = np.empty((cells, cells)), np.empty((cells, cells))
    across, products = np.empty(powers), np.empty((powers, powers))
    for n in range(boxes.shape[0]):
        found[n] = 0.0
        x_span = edge_units(
            boxes[n, 0] - 0.5 * boxes[n, 2] + 0.5, boxes[n, 2], origin[0], frame[0], x_units, x_spans
        )
        y_span = edge_units(
            boxes[n, 1] - 0.5 * boxes[n, 3] + 0.5, boxes[n, 3], origin[1], frame[1], y_units, y_spans
        )
        if x_span == 0 or y_span == 0:
            continue
        split_edges(x_units, stride - 1, columns, column_parts)
        split_edges(y_units, tall - 1, rows, row_parts)
        corner_sums(flat, stride, rows, row_parts, columns, column_parts, sums)
        cell_means(sums, x_units, y_units, x_spans, y_spans, means, shares)
        seen, total = 0.0, 0.0
        for j in range(cells):
            for i in range(cells):
                shares[j, i] *= weights[j] * weights[i]
                seen += shares[j, i]
                total += shares[j, i] * means[j, i]
        if seen <= 0.0:
            continue
        found[n, 0] = seen
        mean = total / seen
        products[:] = 0.0
        for j in range(cells):
            across[:] = 0.0
            for i in range(cells):
                value = shares[j, i] * (means[j, i] - mean)
                for a in range(powers):
                    across[a] += lines[a, i] * value
            for b in range(powers):
                for a in range(powers - b):
                    products[a, b] += lines[b, j] * across[a]
        column = 1
        for degree in range(1, powers):
            for b in range(degree + 1):
                found[n, column] = products[degree - b, b]
                column += 1
