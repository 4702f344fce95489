"""Compiled kernels of foreground and background colours: cells counted, means from an integral image.

Everything is counted in integers, so that a box has the same value to the bit whatever crop it is asked in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Bytes, Floats, Ints
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.vision.kernels.color_kernels import fill_cells

Words = NDArray[np.uint16]

STEPS = 16
"""Steps of a pixel to which the edges of boxes are rounded."""


@compiled
def count_cells(image: Bytes, layout: Words, boxes: Floats, counts: Floats) -> None:
    """Fill `counts` (K, cells) with the pixels of the image that touch each box, by cell.

    Args:
        image: (H, W, 3), C order.
        layout: of `fill_cells`.
        boxes: (K, 4) centre boxes, each inside the one before it.
        counts: filled.
    """
    height, width, size = image.shape[0], image.shape[1], len(boxes)
    bounds = np.empty((size + 1, 4), np.int64)  # first and last column, first and last row
    for k in range(size):
        x, y, across, down = boxes[k, 0], boxes[k, 1], boxes[k, 2] * 0.5, boxes[k, 3] * 0.5
        bounds[k, 0] = int(np.floor(min(max(x - across + 0.5, 0.0), float(width))))
        bounds[k, 1] = int(np.ceil(min(max(x + across + 0.5, 0.0), float(width))))
        bounds[k, 2] = int(np.floor(min(max(y - down + 0.5, 0.0), float(height))))
        bounds[k, 3] = int(np.ceil(min(max(y + down + 0.5, 0.0), float(height))))
    bounds[size] = 0
    first, last = bounds[0, 0], bounds[0, 1]
    cells = np.empty(last - first, np.uint16)
    # Each pixel is counted in the smallest box that has it. Four counts each: the next pixels are often of
    # the same cell, and would wait for this one.
    apart = np.zeros((*counts.shape, 4), np.int32)
    for y in range(bounds[0, 2], bounds[0, 3]):
        fill_cells(image[y, first:last].reshape(3 * (last - first)), layout, cells)
        for k in range(size):
            if not bounds[k, 2] <= y < bounds[k, 3]:
                break
            start, stop = bounds[k, 0] - first, bounds[k, 1] - first
            left, right = stop, stop
            if bounds[k + 1, 2] <= y < bounds[k + 1, 3]:
                left, right = bounds[k + 1, 0] - first, bounds[k + 1, 1] - first
            own = apart[k]
            for begin, end in ((start, left), (right, stop)):
                for x in range(begin, end):
                    own[cells[x], x & 3] += 1
    for cell in range(counts.shape[1]):
        total = 0
        for k in range(size - 1, -1, -1):
            one = apart[k, cell]
            total += one[0] + one[1] + one[2] + one[3]
            counts[k, cell] = total


@compiled
def ring_shares(counts: Floats, shares: Floats) -> None:
    """Fill `shares` (3, cells) from the counts (4, cells) of two boxes, of a box in both, and of one in that.

    Of the pixels around the third box in the first and in the second, and of those in the last; 0 where there
    are none.
    """
    for k in range(3):
        total = 0.0
        for cell in range(counts.shape[1]):
            own = counts[3, cell] if k == 2 else counts[k, cell] - counts[2, cell]
            shares[k, cell] = own
            total += own
        for cell in range(counts.shape[1]):
            shares[k, cell] /= max(total, 1.0)


@compiled
def color_posterior(
    foreground: Floats,
    background: Floats,
    memory: Floats,
    share: float,
    unseen: tuple[float, float],
    found: Bytes,
) -> None:
    """Fill `found` (cells,) with 255 f / (f + b), b with the `share` of `memory`.

    `unseen` is added to f and to f + b.
    """
    for cell in range(len(foreground)):
        around = (1.0 - share) * background[cell] + share * memory[cell]
        of_all = (foreground[cell] + unseen[0]) / (foreground[cell] + around + unseen[1])
        found[cell] = np.uint8(np.rint(255.0 * of_all))


@compiled
def integral_of_cells(image: Bytes, layout: Words, levels: Bytes, crop: Ints) -> Ints:
    """(H + 1, W + 1) sums of the pixels' levels above and left in a crop: the first row and column are 0.

    Args:
        image: (rows, columns, 3), C order.
        layout: of `fill_cells`.
        levels: (cells,) the value of each cell.
        crop: (4,) first and last column, first and last row, the last ones left out.
    """
    left, right, top, bottom = crop
    integral = np.empty((bottom - top + 1, right - left + 1), np.int64)
    cells = np.empty(right - left, np.uint16)
    integral[0] = 0
    for y in range(bottom - top):
        fill_cells(image[top + y, left:right].reshape(3 * (right - left)), layout, cells)
        above, own = integral[y], integral[y + 1]
        own[0] = 0
        total = np.int64(0)
        for x in range(right - left):
            total += np.int64(levels[cells[x]])
            own[x + 1] = above[x + 1] + total
    return integral


@compiled
def _corner(integral: Ints, x: int, y: int) -> int:
    """The integral up to (x, y), both in steps of a pixel: bilinear, times STEPS squared."""
    column, row = x // STEPS, y // STEPS
    right, down = x - column * STEPS, y - row * STEPS
    # The last row and column are edges: there is nothing beyond them, and the share of it is 0.
    after, below = min(column + 1, integral.shape[1] - 1), min(row + 1, integral.shape[0] - 1)
    top = integral[row, column] * (STEPS - right) + integral[row, after] * right
    bottom = integral[below, column] * (STEPS - right) + integral[below, after] * right
    found: int = top * (STEPS - down) + bottom * down
    return found


@compiled
def box_and_ring_means(
    image: Bytes, layout: Words, levels: Bytes, boxes: Floats, ring: float, means: Floats
) -> None:
    """Mean level inside each box, and in the ring around it.

    What lies outside the frame counts as 0 inside a box; the ring is what of it lies inside the frame.

    Args:
        image: of `integral_of_cells`; likewise `layout` and `levels`.
        boxes: (N, 4) centre boxes, px.
        ring: width of the ring in mean sides of the box.
        means: (N, 2) filled.
    """
    across, down = image.shape[1] * STEPS, image.shape[0] * STEPS
    edges = np.empty((len(boxes), 2, 4), np.int64)  # of the box and around its ring: left, right, top, bottom
    crop = np.array([across, 0, down, 0])
    for k in range(len(boxes)):
        x, y, w, h = boxes[k, 0] + 0.5, boxes[k, 1] + 0.5, boxes[k, 2], boxes[k, 3]
        for outer in range(2):
            grown = outer * ring * 0.5 * (w + h)
            own = edges[k, outer]
            own[0] = min(max(int(np.floor((x - 0.5 * w - grown) * STEPS + 0.5)), 0), across)
            own[1] = min(max(int(np.floor((x + 0.5 * w + grown) * STEPS + 0.5)), 0), across)
            own[2] = min(max(int(np.floor((y - 0.5 * h - grown) * STEPS + 0.5)), 0), down)
            own[3] = min(max(int(np.floor((y + 0.5 * h + grown) * STEPS + 0.5)), 0), down)
        crop[0], crop[1] = min(crop[0], own[0]), max(crop[1], own[1])
        crop[2], crop[3] = min(crop[2], own[2]), max(crop[3], own[3])
    crop[0], crop[1] = crop[0] // STEPS, -(-crop[1] // STEPS)
    crop[2], crop[3] = crop[2] // STEPS, -(-crop[3] // STEPS)
    if crop[0] >= crop[1] or crop[2] >= crop[3]:
        means[:] = 0.0
        return
    integral = integral_of_cells(image, layout, levels, crop)
    x0, y0 = crop[0] * STEPS, crop[2] * STEPS
    for k in range(len(boxes)):
        inside, whole, own_area, whole_area = 0, 0, 0, 0
        for outer in range(2):
            left, right, top, bottom = edges[k, outer]
            area = (right - left) * (bottom - top)
            level = 0
            if area > 0:
                level = (
                    _corner(integral, right - x0, bottom - y0)
                    - _corner(integral, left - x0, bottom - y0)
                    - _corner(integral, right - x0, top - y0)
                    + _corner(integral, left - x0, top - y0)
                )
            inside, own_area, whole, whole_area = whole, whole_area, level, area
        nominal = max(boxes[k, 2] * boxes[k, 3] * STEPS * STEPS, float(own_area), 1.0)
        around = whole_area - own_area
        means[k, 0] = inside / nominal
        means[k, 1] = (whole - inside) / around if around > 0 else 0.0
