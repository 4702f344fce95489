"""Compiled kernels of texture: a code per pixel, and histograms of codes in the cells of boxes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Bytes, Floats
from bayesnet_track.numerics.compiled import compiled

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
        above, here, below = gray[y], gray[y + 1], gray[y + 2]
        for x in range(codes.shape[1]):  # without branches, so that it becomes vector instructions
            dx = np.float32(here[x + 2]) - np.float32(here[x])
            dy = np.float32(below[x + 1]) - np.float32(above[x + 1])
            across, down = abs(dx), abs(dy)
            level = np.uint8(0) if dx > 0 else np.uint8(4)
            upright = np.uint8(2) if dy > 0 else np.uint8(6)
            rising = np.uint8(1) if dx > 0 else np.uint8(3)
            falling = np.uint8(7) if dx > 0 else np.uint8(5)
            code = rising if dy > 0 else falling
            code = upright if across < _TANGENT * down else code
            code = level if down < _TANGENT * across else code
            codes[y, x] = np.uint8(8) if across + down <= limit else code


@compiled
def integral_histogram(codes: Bytes, integral: Ints32) -> None:
    """How often each code occurs above and left: `integral` (H + 1, W + 1, B), first row and column 0."""
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
                near, far = _cell_edges(left, boxes[k, 2], j, cells)
                l, r = min(max(near - x0, 0), columns), min(max(far - x0, 0), columns)  # noqa: E741
                area = float(far - near) * float(lower - upper)
                for c in range(integral.shape[2]):
                    count = integral[b, r, c] - integral[t, r, c] - integral[b, l, c] + integral[t, l, c]
                    shares[k, i, j, c] = count / area


@compiled
def counted_shares(codes: Bytes, boxes: Floats, x0: int, y0: int, cells: int, shares: Floats) -> None:
    """As `cell_shares`, from the codes (H, W) themselves: in less time where there are few boxes."""
    rows, columns = codes.shape
    counts = np.empty(shares.shape[3], np.int64)
    for k in range(boxes.shape[0]):
        left, top = boxes[k, 0] - 0.5 * boxes[k, 2] + 0.5, boxes[k, 1] - 0.5 * boxes[k, 3] + 0.5
        for i in range(cells):
            upper, lower = _cell_edges(top, boxes[k, 3], i, cells)
            for j in range(cells):
                near, far = _cell_edges(left, boxes[k, 2], j, cells)
                counts[:] = 0
                for y in range(max(upper - y0, 0), min(lower - y0, rows)):
                    line = codes[y]
                    for x in range(max(near - x0, 0), min(far - x0, columns)):
                        counts[line[x]] += 1
                area = float(far - near) * float(lower - upper)
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
