"""Compiled kernels that compare the patch under each box with a reference grid.

A cell of the grid is the *mean* of the pixels that it covers, with fractions of pixels at its edges, so
that big boxes do not alias. The means come from an integral image. Edges are rounded to 1/1024 pixel, so
that every product is an integer over a power of two and every sum is exact: the result does not depend on
where the integral image starts.
"""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.compiled import compiled, compiled_summing

UNITS = 1024
"""Steps per pixel to which the edges of cells are rounded: 2**31 * UNITS**2 stays below 2**53."""

MOMENTS = 6
"""Columns of the table that `patch_moments` fills."""


@compiled
def edge_units(low: float, size: float, origin: int, limit: int, units: Ints, spans: Ints) -> int:
    """Fill `units` with the edges of cells, in steps from the crop's first pixel, cut to the frame's `limit`.

    Fills `spans` with the lengths of cells before cutting; returns their sum, 0 when nothing can be sampled.
    """
    cells = units.shape[0] - 1
    bound = 4.0 * limit + 4.0
    if not (size > 0.0 and size < 2.0 * bound and -bound < low < bound):
        return 0
    first = int(np.rint(low * UNITS))
    last = int(np.rint((low + size) * UNITS))
    if last - first < cells or first >= limit * UNITS or last <= 0:
        return 0
    step = ((last - first) << 20) // cells
    uncut = first
    for i in range(cells + 1):
        edge = first + ((i * step + (1 << 19)) >> 20)
        if i > 0:
            spans[i - 1] = edge - uncut
        uncut = edge
        units[i] = min(max(edge, 0), limit * UNITS) - origin * UNITS
    return last - first


@compiled
def split_edges(units: Ints, count: int, pixels: Ints, parts: Floats) -> None:
    """Split edges into a pixel (kept inside the crop's `count`) and the part of it before the edge."""
    for i in range(units.shape[0]):
        pixel = min(max(units[i] // UNITS, 0), count - 1)
        pixels[i] = pixel
        parts[i] = (units[i] - pixel * UNITS) / UNITS


@compiled
def corner_sums(
    flat: Floats,
    stride: int,
    rows: Ints,
    row_parts: Floats,
    columns: Ints,
    column_parts: Floats,
    sums: Floats,
) -> None:
    """Fill `sums` with the integral image at every crossing of edges, bilinear between pixels (exact)."""
    for j in range(rows.shape[0]):
        part = row_parts[j]
        for i in range(columns.shape[0]):
            # unsigned, or Numba tests each index for a count from the end (twice the time)
            a = np.uint64(rows[j] * stride + columns[i])
            b = a + np.uint64(1)
            c = a + np.uint64(stride)
            d = c + np.uint64(1)
            left = flat[a] + part * (flat[c] - flat[a])
            right = flat[b] + part * (flat[d] - flat[b])
            sums[j, i] = left + column_parts[i] * (right - left)


@compiled
def cell_means(
    sums: Floats, x_units: Ints, y_units: Ints, x_spans: Ints, y_spans: Ints, means: Floats, shares: Floats
) -> None:
    """Fill `means` and `shares` (G, G) of one box from the sums at its edges' crossings."""
    cells = means.shape[0]
    for j in range(cells):
        tall = (y_units[j + 1] - y_units[j]) / UNITS
        for i in range(cells):
            area = tall * ((x_units[i + 1] - x_units[i]) / UNITS)
            total = (sums[j + 1, i + 1] - sums[j + 1, i]) - (sums[j, i + 1] - sums[j, i])
            means[j, i] = total / area if area > 0.0 else 0.0
            shares[j, i] = area / ((x_spans[i] / UNITS) * (y_spans[j] / UNITS))


@compiled
def patch_means(
    integral: Floats, box: Floats, origin: Ints, frame: Ints, means: Floats, shares: Floats
) -> None:
    """Fill `means` and `shares` (G, G): each cell's mean, and the share of it inside the frame, for one box.

    Arguments as for `patch_moments`. Cells outside the frame have mean 0 and share 0.
    """
    edges = means.shape[0] + 1
    x_units, y_units = np.empty(edges, np.int64), np.empty(edges, np.int64)
    x_spans, y_spans = np.empty(edges - 1, np.int64), np.empty(edges - 1, np.int64)
    columns, rows = np.empty(edges, np.int64), np.empty(edges, np.int64)
    column_parts, row_parts = np.empty(edges), np.empty(edges)
    sums = np.empty((edges, edges))
    means[:] = 0.0
    shares[:] = 0.0
    x_span = edge_units(box[0] - 0.5 * box[2] + 0.5, box[2], origin[0], frame[0], x_units, x_spans)
    y_span = edge_units(box[1] - 0.5 * box[3] + 0.5, box[3], origin[1], frame[1], y_units, y_spans)
    if x_span > 0 and y_span > 0:
        split_edges(x_units, integral.shape[1] - 1, columns, column_parts)
        split_edges(y_units, integral.shape[0] - 1, rows, row_parts)
        corner_sums(integral.ravel(), integral.shape[1], rows, row_parts, columns, column_parts, sums)
        cell_means(sums, x_units, y_units, x_spans, y_spans, means, shares)


@compiled_summing
def _weighted_sums(values: Floats, weights: Floats, weighted_reference: Floats) -> tuple[float, float, float]:
    """Sums of w v, w r v and w v v over all cells."""
    sv, srv, svv = 0.0, 0.0, 0.0
    for k in range(values.shape[0]):
        weighted = weights[k] * values[k]
        sv += weighted
        srv += weighted_reference[k] * values[k]
        svv += weighted * values[k]
    return sv, srv, svv


@compiled
def patch_moments(
    integral: Floats,
    boxes: Floats,
    origin: Ints,
    frame: Ints,
    reference: Floats,
    weights: Floats,
    moments: Floats,
) -> None:
    """Fill `moments` (N, 6) with weighted sums over the cells of each box that lie in the frame.

    Columns: the sums of w, w r, w v, w r r, w r v, w v v, with v a cell's mean, r `reference` (G, G) there,
    and w `weights` (G, G) times the share of the cell inside the frame. All are 0 for a box outside the
    frame, narrower than G / 1024 pixel, or not finite.

    Args:
        integral: (rows + 1, columns + 1) float64, C order: integral image of a crop (not empty) that covers
            the boxes as far as they lie inside the frame.
        boxes: (N, 4) centre boxes, frame coordinates.
        origin: column and row, in the frame, of the crop's first pixel.
        frame: width and height of the frame.
    """
    cells = reference.shape[0]
    flat, stride = integral.ravel(), integral.shape[1]
    x_units, y_units = np.empty(cells + 1, np.int64), np.empty(cells + 1, np.int64)
    x_spans, y_spans = np.empty(cells, np.int64), np.empty(cells, np.int64)
    columns, rows = np.empty(cells + 1, np.int64), np.empty(cells + 1, np.int64)
    column_parts, row_parts = np.empty(cells + 1), np.empty(cells + 1)
    sums = np.empty((cells + 1, cells + 1))
    means, shares = np.empty((cells, cells)), np.empty((cells, cells))
    per_length, values = np.empty(cells), np.empty(cells * cells)
    flat_weights, weighted_reference = np.empty(cells * cells), np.empty(cells * cells)
    whole_w, whole_r, whole_rr = 0.0, 0.0, 0.0
    for j in range(cells):
        for i in range(cells):
            flat_weights[j * cells + i] = weights[j, i]
            weighted_reference[j * cells + i] = weights[j, i] * reference[j, i]
            whole_w += weights[j, i]
            whole_r += weights[j, i] * reference[j, i]
            whole_rr += weights[j, i] * reference[j, i] * reference[j, i]
    for n in range(boxes.shape[0]):
        x_span = edge_units(
            boxes[n, 0] - 0.5 * boxes[n, 2] + 0.5, boxes[n, 2], origin[0], frame[0], x_units, x_spans
        )
        y_span = edge_units(
            boxes[n, 1] - 0.5 * boxes[n, 3] + 0.5, boxes[n, 3], origin[1], frame[1], y_units, y_spans
        )
        if x_span == 0 or y_span == 0:
            moments[n] = 0.0
            continue
        split_edges(x_units, stride - 1, columns, column_parts)
        split_edges(y_units, integral.shape[0] - 1, rows, row_parts)
        corner_sums(flat, stride, rows, row_parts, columns, column_parts, sums)
        sw, sr, sv, srr, srv, svv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if x_units[cells] - x_units[0] == x_span and y_units[cells] - y_units[0] == y_span:
            sw, sr, srr = whole_w, whole_r, whole_rr
            for i in range(cells):
                per_length[i] = UNITS / (x_units[i + 1] - x_units[i])
            for j in range(cells):
                scale = UNITS / (y_units[j + 1] - y_units[j])
                above, below, row = sums[j], sums[j + 1], values[j * cells : (j + 1) * cells]
                for i in range(cells):
                    total = (below[i + 1] - below[i]) - (above[i + 1] - above[i])
                    row[i] = total * (scale * per_length[i])
            sv, srv, svv = _weighted_sums(values, flat_weights, weighted_reference)
        else:
            cell_means(sums, x_units, y_units, x_spans, y_spans, means, shares)
            for j in range(cells):
                for i in range(cells):
                    w, r, v = weights[j, i] * shares[j, i], reference[j, i], means[j, i]
                    sw += w
                    sr += w * r
                    sv += w * v
                    srr += w * r * r
                    srv += w * r * v
                    svv += w * v * v
        row = moments[n]
        row[0], row[1], row[2], row[3], row[4], row[5] = sw, sr, sv, srr, srv, svv
