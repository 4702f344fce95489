"""Compiled kernels that compare the patch under each box: with a grid, with smooth patterns, by its texture.

A cell of the grid is the *mean* of the pixels that it covers, with fractions of pixels at its edges, so
that big boxes do not alias. The means come from an integral image. Edges are rounded to 1/1024 pixel, so
that every product is an integer over a power of two and every sum is exact: the result does not depend on
where the integral image starts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Bytes, Floats, Ints
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
    end = int(np.rint((low + size) * UNITS))
    if end - first < cells or first >= limit * UNITS or end <= 0:
        return 0
    step = ((end - first) << 20) // cells
    uncut = first
    for i in range(cells + 1):
        edge = first + ((i * step + (1 << 19)) >> 20)
        if i > 0:
            spans[i - 1] = edge - uncut
        uncut = edge
        units[i] = min(max(edge, 0), limit * UNITS) - origin * UNITS
    return end - first


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
def _cell_means(
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
        _cell_means(sums, x_units, y_units, x_spans, y_spans, means, shares)


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
                upper, lower, row = sums[j], sums[j + 1], values[j * cells : (j + 1) * cells]
                for i in range(cells):
                    total = (lower[i + 1] - lower[i]) - (upper[i + 1] - upper[i])
                    row[i] = total * (scale * per_length[i])
            sv, srv, svv = _weighted_sums(values, flat_weights, weighted_reference)
        else:
            _cell_means(sums, x_units, y_units, x_spans, y_spans, means, shares)
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


@compiled
def patch_projections(
    integral: Floats,
    boxes: Floats,
    origin: Ints,
    frame: Ints,
    weights: Floats,
    lines: Floats,
    projections: Floats,
) -> None:
    """Fill `projections` (N, 1 + K): the weight of a box's cells inside the frame, then K projections.

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
    column_sums, products = np.empty(powers), np.empty((powers, powers))
    for n in range(boxes.shape[0]):
        projections[n] = 0.0
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
        _cell_means(sums, x_units, y_units, x_spans, y_spans, means, shares)
        visible_weight, total = 0.0, 0.0
        for j in range(cells):
            for i in range(cells):
                shares[j, i] *= weights[j] * weights[i]
                visible_weight += shares[j, i]
                total += shares[j, i] * means[j, i]
        if visible_weight <= 0.0:
            continue
        projections[n, 0] = visible_weight
        mean = total / visible_weight
        products[:] = 0.0
        for j in range(cells):
            column_sums[:] = 0.0
            for i in range(cells):
                value = shares[j, i] * (means[j, i] - mean)
                for a in range(powers):
                    column_sums[a] += lines[a, i] * value
            for b in range(powers):
                for a in range(powers - b):
                    products[a, b] += lines[b, j] * column_sums[a]
        column = 1
        for degree in range(1, powers):
            for b in range(degree + 1):
                projections[n, column] = products[degree - b, b]
                column += 1


Ints32 = NDArray[np.int32]

PATTERNS = 10
"""Codes of binary patterns: 0 .. 8 brighter neighbours in one arc, 9 for more than one arc."""
FLAT = 8
"""Code of a pixel without a gradient, after those of 8 directions."""
_TANGENT = np.float32(np.tan(np.pi / 8))


@compiled
def binary_patterns(gray: Bytes, noise: int, codes: Bytes) -> None:
    """Uniform local binary patterns of 8 neighbours, whichever way they are turned (Ojala et al. 2002).

    Args:
        gray: (H + 2, W + 2), one pixel more on each side than the codes.
        noise: a neighbour is brighter when it exceeds the pixel by more than this, gray levels.
        codes: (H, W) filled with 0 .. PATTERNS - 1.
    """
    for y in range(codes.shape[0]):
        for x in range(codes.shape[1]):
            level = np.int64(gray[y + 1, x + 1]) + noise
            a, b, c = gray[y, x] > level, gray[y, x + 1] > level, gray[y, x + 2] > level
            d, e, f = gray[y + 1, x + 2] > level, gray[y + 2, x + 2] > level, gray[y + 2, x + 1] > level
            g, h = gray[y + 2, x] > level, gray[y + 1, x] > level
            changes = int(a != b) + int(b != c) + int(c != d) + int(d != e)
            changes += int(e != f) + int(f != g) + int(g != h) + int(h != a)
            brighter = int(a) + int(b) + int(c) + int(d) + int(e) + int(f) + int(g) + int(h)
            codes[y, x] = brighter if changes <= 2 else 9


@compiled
def gradient_directions(gray: Bytes, noise: int, codes: Bytes) -> None:
    """Direction of the gradient, FLAT where it is weak; 0 to the right, 2 down, sectors of 45 degrees.

    Args:
        gray: (H + 2, W + 2), one pixel more on each side than the codes.
        noise: sum of absolute central differences up to which a pixel is flat, gray levels.
        codes: (H, W) filled with 0 .. FLAT.
    """
    limit = np.float32(noise)
    for y in range(codes.shape[0]):
        upper, middle, lower = gray[y], gray[y + 1], gray[y + 2]
        for x in range(codes.shape[1]):  # without branches, so that it becomes vector instructions
            dx = np.float32(middle[x + 2]) - np.float32(middle[x])
            dy = np.float32(lower[x + 1]) - np.float32(upper[x + 1])
            abs_x, abs_y = abs(dx), abs(dy)
            level = np.uint8(0) if dx > 0 else np.uint8(4)
            upright = np.uint8(2) if dy > 0 else np.uint8(6)
            rising = np.uint8(1) if dx > 0 else np.uint8(3)
            falling = np.uint8(7) if dx > 0 else np.uint8(5)
            code = rising if dy > 0 else falling
            code = upright if abs_x < _TANGENT * abs_y else code
            code = level if abs_y < _TANGENT * abs_x else code
            codes[y, x] = np.uint8(8) if abs_x + abs_y <= limit else code


@compiled
def integral_histogram(codes: Bytes, integral: Ints32) -> None:
    """Counts of each code above and left: `integral` (H + 1, W + 1, B), first row and column 0."""
    bins = integral.shape[2]
    row = np.zeros(bins, np.int32)
    integral[0] = 0
    for y in range(codes.shape[0]):
        row[:] = 0
        integral[y + 1, 0] = 0
        for x in range(codes.shape[1]):
            row[codes[y, x]] += 1
            for b in range(bins):
                integral[y + 1, x + 1, b] = integral[y, x + 1, b] + row[b]


@compiled
def _cell_edges(first: float, side: float, cell: int, cells: int) -> tuple[int, int]:
    """First pixel of a cell and of the next one, of the `cells` of a side that begins at `first`, px."""
    begin = int(np.floor(first + side * cell / cells + 0.5))
    return begin, max(int(np.floor(first + side * (cell + 1) / cells + 0.5)), begin + 1)


@compiled
def cell_shares(integral: Ints32, boxes: Floats, x0: int, y0: int, cells: int, shares: Floats) -> None:
    """Share of each code in the cells of boxes, of the whole cell: what lies outside the crop has none.

    Args:
        integral: of the crop whose first pixel is (x0, y0).
        boxes: (N, 4) centre boxes, px; edges of cells are rounded to pixels, and a cell has one at least.
        x0: first column of the crop; likewise `y0`.
        cells: per side.
        shares: (N, cells, cells, B) filled.
    """
    rows, columns = integral.shape[0] - 1, integral.shape[1] - 1
    for k in range(boxes.shape[0]):
        left, top = boxes[k, 0] - 0.5 * boxes[k, 2] + 0.5, boxes[k, 1] - 0.5 * boxes[k, 3] + 0.5
        for i in range(cells):
            upper, lower = _cell_edges(top, boxes[k, 3], i, cells)
            t, b = min(max(upper - y0, 0), rows), min(max(lower - y0, 0), rows)
            for j in range(cells):
                start, stop = _cell_edges(left, boxes[k, 2], j, cells)
                l, r = min(max(start - x0, 0), columns), min(max(stop - x0, 0), columns)  # noqa: E741
                area = float(stop - start) * float(lower - upper)
                for c in range(integral.shape[2]):
                    count = integral[b, r, c] - integral[t, r, c] - integral[b, l, c] + integral[t, l, c]
                    shares[k, i, j, c] = count / area


@compiled
def counted_shares(codes: Bytes, boxes: Floats, x0: int, y0: int, cells: int, shares: Floats) -> None:
    """Shares as of `cell_shares`, from the codes (H, W) themselves: faster where there are few boxes."""
    rows, columns = codes.shape
    counts = np.empty(shares.shape[3], np.int64)
    for k in range(boxes.shape[0]):
        left, top = boxes[k, 0] - 0.5 * boxes[k, 2] + 0.5, boxes[k, 1] - 0.5 * boxes[k, 3] + 0.5
        for i in range(cells):
            upper, lower = _cell_edges(top, boxes[k, 3], i, cells)
            for j in range(cells):
                start, stop = _cell_edges(left, boxes[k, 2], j, cells)
                counts[:] = 0
                for y in range(max(upper - y0, 0), min(lower - y0, rows)):
                    line = codes[y]
                    for x in range(max(start - x0, 0), min(stop - x0, columns)):
                        counts[line[x]] += 1
                area = float(stop - start) * float(lower - upper)
                for c in range(len(counts)):
                    shares[k, i, j, c] = counts[c] / area


@compiled
def bhattacharyya(shares: Floats, reference: Floats, coefficients: Floats) -> None:
    """Mean over the cells of the sum of sqrt(share * reference): (N, C, C, B), (C, C, B) to (N,)."""
    cells = reference.shape[0]
    for k in range(shares.shape[0]):
        total = 0.0
        for i in range(cells):
            for j in range(cells):
                for b in range(reference.shape[2]):
                    total += np.sqrt(shares[k, i, j, b] * reference[i, j, b])
        coefficients[k] = min(total / (cells * cells), 1.0)


@compiled
def sample_squares(image: Bytes, left: int, top: int, side: int, samples: int, sampled: Bytes) -> None:
    """Fill `sampled` (rows, columns, 3) with a colour of each of the squares that divide a part of an image.

    It is the mean, rounded, of `samples` x `samples` pixels spread over the square: the one in the middle, or
    four of which each stands for a quarter. Beyond the image its border is repeated.

    Args:
        image: (H, W, 3), C order.
        left: first column of the first square, px; likewise `top`.
        side: of a square, px.
        samples: 1, or 2 of squares of 2 px or more.
        sampled: filled.
    """
    last_row, last_column = image.shape[0] - 1, image.shape[1] - 1
    first = side // 2 if samples == 1 else side // 4
    second = first if samples == 1 else side - 1 - first
    for j in range(sampled.shape[0]):
        upper = image[min(max(top + j * side + first, 0), last_row)]
        lower = image[min(max(top + j * side + second, 0), last_row)]
        for i in range(sampled.shape[1]):
            x = min(max(left + i * side + first, 0), last_column)
            if samples == 1:
                for c in range(3):
                    sampled[j, i, c] = upper[x, c]
                continue
            right = min(max(left + i * side + second, 0), last_column)
            for c in range(3):
                total = np.uint32(upper[x, c]) + upper[right, c] + lower[x, c] + lower[right, c]
                sampled[j, i, c] = np.uint8((total + 2) >> 2)
