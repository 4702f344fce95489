"""Compiled kernels for colours of pixels: hue, cells, foreground and background, a background model.

Everything is counted in integers, so that a box has the same value to the bit whatever crop it is asked in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Bytes, Floats, Ints, Singles
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.observation.planes import for_reading

ACHROMATIC = -1

_SHIFT = 12
_CHROMA = np.maximum(np.arange(256), 1)
_SIXTHS = np.rint((256 << _SHIFT) / (6.0 * _CHROMA)).astype(np.int64)


def hue_of_bgr(image: NDArray[np.uint8], min_chroma: int) -> NDArray[np.int16]:
    """Hexcone hue of each pixel in 1/256 of a circle (thesis eq. 3.1, corrected: 60 degrees on every branch).

    Computed here rather than by OpenCV so that the bits do not depend on its version, and so that chroma
    need not be recovered from a rounded saturation.

    Args:
        image: (H, W, 3) BGR.
        min_chroma: pixels whose largest and smallest channel differ by less are `ACHROMATIC`; at least 1.

    Returns:
        (H, W) int16, 0..255 or `ACHROMATIC`.
    """
    hue: NDArray[np.int16] = np.empty(image.shape[:2], np.int16)
    _hue(for_reading(image), min_chroma, _SIXTHS, hue)
    return hue


@compiled
def _hue(
    image: NDArray[np.uint8], min_chroma: int, sixths: NDArray[np.int64], hue: NDArray[np.int16]
) -> None:
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            b, g, r = np.int64(image[y, x, 0]), np.int64(image[y, x, 1]), np.int64(image[y, x, 2])
            top = max(b, g, r)
            chroma = top - min(b, g, r)
            if chroma < min_chroma:
                hue[y, x] = -1
                continue
            if top == r:
                turn = g - b
            elif top == g:
                turn = b - r + 2 * chroma
            else:
                turn = r - g + 4 * chroma
            hue[y, x] = ((turn * sixths[chroma] + 2048) >> 12) & 255


@compiled
def bins_of_hue(hue: NDArray[np.int16], bin_of_hue: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The entry of `bin_of_hue` (257,) for each hue, the last for `ACHROMATIC`."""
    bins = np.empty(hue.shape, np.uint8)
    for y in range(hue.shape[0]):
        for x in range(hue.shape[1]):
            angle = hue[y, x]
            bins[y, x] = bin_of_hue[angle if angle >= 0 else 256]
    return bins


@compiled
def fill_cells(line: NDArray[np.uint8], layout: NDArray[np.uint16], cells: NDArray[np.uint16]) -> None:
    """Write the cell of each pixel of `line` (3 W,) into `cells` (W,).

    Args:
        line: three channels of each pixel.
        layout: (2, 3) of each channel how many levels it has, at most 256, and what one of them adds to the
            number of a cell, which is at most 65535.
        cells: filled.
    """
    factor_blue, factor_green, factor_red = layout[0, 0], layout[0, 1], layout[0, 2]
    first, second, third = layout[1, 0], layout[1, 1], layout[1, 2]
    half = np.uint16(8)
    for x in range(len(cells)):  # whole numbers of 16 bits: four times as many at once as of 64
        a = np.uint16(np.uint16(np.uint16(line[3 * x]) * factor_blue) >> half) * first
        b = np.uint16(np.uint16(np.uint16(line[3 * x + 1]) * factor_green) >> half) * second
        c = np.uint16(np.uint16(np.uint16(line[3 * x + 2]) * factor_red) >> half) * third
        cells[x] = np.uint16(a) + np.uint16(b) + np.uint16(c)


@compiled
def fill_color_cells(image: NDArray[np.uint8], layout: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """(H, W) cell of each pixel of an (H, W, 3) image; `layout` as of `fill_cells`."""
    height, width = image.shape[0], image.shape[1]
    cells = np.empty((height, width), np.uint16)
    for y in range(height):
        fill_cells(image[y].reshape(3 * width), layout, cells[y])
    return cells


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
        x, y, half_width, half_height = boxes[k, 0], boxes[k, 1], boxes[k, 2] * 0.5, boxes[k, 3] * 0.5
        bounds[k, 0] = int(np.floor(min(max(x - half_width + 0.5, 0.0), float(width))))
        bounds[k, 1] = int(np.ceil(min(max(x + half_width + 0.5, 0.0), float(width))))
        bounds[k, 2] = int(np.floor(min(max(y - half_height + 0.5, 0.0), float(height))))
        bounds[k, 3] = int(np.ceil(min(max(y + half_height + 0.5, 0.0), float(height))))
    bounds[size] = 0
    first, last_column = bounds[0, 0], bounds[0, 1]
    cells = np.empty(last_column - first, np.uint16)
    # Each pixel is counted in the smallest box that has it. Four counts each: the next pixels are often of
    # the same cell, and would wait for this one.
    partial = np.zeros((*counts.shape, 4), np.int32)
    for y in range(bounds[0, 2], bounds[0, 3]):
        fill_cells(image[y, first:last_column].reshape(3 * (last_column - first)), layout, cells)
        for k in range(size):
            if not bounds[k, 2] <= y < bounds[k, 3]:
                break
            start, stop = bounds[k, 0] - first, bounds[k, 1] - first
            left, right = stop, stop
            if bounds[k + 1, 2] <= y < bounds[k + 1, 3]:
                left, right = bounds[k + 1, 0] - first, bounds[k + 1, 1] - first
            box_counts = partial[k]
            for begin, end in ((start, left), (right, stop)):
                for x in range(begin, end):
                    box_counts[cells[x], x & 3] += 1
    for cell in range(counts.shape[1]):
        total = 0
        for k in range(size - 1, -1, -1):
            counters = partial[k, cell]
            total += counters[0] + counters[1] + counters[2] + counters[3]
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
            count = counts[3, cell] if k == 2 else counts[k, cell] - counts[2, cell]
            shares[k, cell] = count
            total += count
        for cell in range(counts.shape[1]):
            shares[k, cell] /= max(total, 1.0)


@compiled
def color_posterior(
    foreground: Floats,
    background: Floats,
    memory: Floats,
    share: float,
    unseen: tuple[float, float],
    posterior: Bytes,
) -> None:
    """Fill `posterior` (cells,) with 255 f / (f + b), b with the `share` of `memory`.

    `unseen` is added to f and to f + b.
    """
    for cell in range(len(foreground)):
        elsewhere = (1.0 - share) * background[cell] + share * memory[cell]
        of_all = (foreground[cell] + unseen[0]) / (foreground[cell] + elsewhere + unseen[1])
        posterior[cell] = np.uint8(np.rint(255.0 * of_all))


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
        previous, current = integral[y], integral[y + 1]
        current[0] = 0
        total = np.int64(0)
        for x in range(right - left):
            total += np.int64(levels[cells[x]])
            current[x + 1] = previous[x + 1] + total
    return integral


@compiled
def _corner(integral: Ints, x: int, y: int) -> int:
    """The integral up to (x, y), both in steps of a pixel: bilinear, times STEPS squared."""
    column, row = x // STEPS, y // STEPS
    column_part, row_part = x - column * STEPS, y - row * STEPS
    # The last row and column are edges: there is nothing beyond them, and the share of it is 0.
    next_column, next_row = min(column + 1, integral.shape[1] - 1), min(row + 1, integral.shape[0] - 1)
    top = integral[row, column] * (STEPS - column_part) + integral[row, next_column] * column_part
    bottom = (
        integral[next_row, column] * (STEPS - column_part) + integral[next_row, next_column] * column_part
    )
    level: int = top * (STEPS - row_part) + bottom * row_part
    return level


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
    width, height = image.shape[1] * STEPS, image.shape[0] * STEPS
    edges = np.empty((len(boxes), 2, 4), np.int64)  # of the box and around its ring: left, right, top, bottom
    crop = np.array([width, 0, height, 0])
    for k in range(len(boxes)):
        x, y, w, h = boxes[k, 0] + 0.5, boxes[k, 1] + 0.5, boxes[k, 2], boxes[k, 3]
        for outer in range(2):
            grown = outer * ring * 0.5 * (w + h)
            edge = edges[k, outer]
            edge[0] = min(max(int(np.floor((x - 0.5 * w - grown) * STEPS + 0.5)), 0), width)
            edge[1] = min(max(int(np.floor((x + 0.5 * w + grown) * STEPS + 0.5)), 0), width)
            edge[2] = min(max(int(np.floor((y - 0.5 * h - grown) * STEPS + 0.5)), 0), height)
            edge[3] = min(max(int(np.floor((y + 0.5 * h + grown) * STEPS + 0.5)), 0), height)
        crop[0], crop[1] = min(crop[0], edge[0]), max(crop[1], edge[1])
        crop[2], crop[3] = min(crop[2], edge[2]), max(crop[3], edge[3])
    crop[0], crop[1] = crop[0] // STEPS, -(-crop[1] // STEPS)
    crop[2], crop[3] = crop[2] // STEPS, -(-crop[3] // STEPS)
    if crop[0] >= crop[1] or crop[2] >= crop[3]:
        means[:] = 0.0
        return
    integral = integral_of_cells(image, layout, levels, crop)
    x0, y0 = crop[0] * STEPS, crop[2] * STEPS
    for k in range(len(boxes)):
        box_level, ring_level, box_area, grown_area = 0, 0, 0, 0
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
            box_level, box_area, ring_level, grown_area = ring_level, grown_area, level, area
        nominal = max(boxes[k, 2] * boxes[k, 3] * STEPS * STEPS, float(box_area), 1.0)
        ring_area = grown_area - box_area
        means[k, 0] = box_level / nominal
        means[k, 1] = (ring_level - box_level) / ring_area if ring_area > 0 else 0.0


BACKGROUND, SHADOW, FOREGROUND = 0, 64, 128
"""Evidence below `SHADOW` is background; from `FOREGROUND` on, a target, up to 255 the surer it is."""


@compiled
def update_mixture(
    image: NDArray[np.uint8],
    gain: float,
    rate: float,
    weights: Singles,
    means: Singles,
    variances: Singles,
    match: float,
    background_share: float,
    min_variance: float,
    first_variance: float,
    darkest: float,
    chroma: float,
    evidence: NDArray[np.uint8],
) -> None:
    """Compare each pixel with its background, then learn it; in place.

    Args:
        image: (H, W, 3) uint8 BGR.
        gain: the means are multiplied by it first (255 at most), to compare and not to learn.
        rate: share of this frame in what is learnt.
        weights: (H, W, K) of the modes, largest first; they sum to 1.
        means: (H, W, K, 3) gray levels.
        variances: (H, W, K) of each channel.
        match: a pixel belongs to a mode within this squared distance, in the mode's variances.
        background_share: modes are background until those before them have this weight together.
        min_variance, first_variance: lower bound, and what a new mode starts with.
        darkest: a shadow has at least this share of the background's brightness; 1 for no shadows.
        chroma: and differs in colour by this at most, mean square, gray levels squared.
        evidence: (H, W) is filled in.
    """
    rows, columns, modes = weights.shape
    value, expected = np.empty(3), np.empty(3)
    for y in range(rows):
        for x in range(columns):
            for c in range(3):
                value[c] = float(image[y, x, c])
            weight_so_far, matched, is_background, nearest = 0.0, -1, False, np.inf
            for k in range(modes):
                weight = float(weights[y, x, k])
                if weight <= 0.0:
                    break
                squared_error = 0.0
                for c in range(3):
                    squared_error += (value[c] - min(gain * means[y, x, k, c], 255.0)) ** 2
                distance = squared_error / variances[y, x, k]
                if weight_so_far < background_share:
                    nearest = min(nearest, distance)
                if distance < match:
                    matched, is_background = k, weight_so_far < background_share
                    break
                weight_so_far += weight
            evidence[y, x] = BACKGROUND
            if not is_background:
                evidence[y, x] = min(128.0 * np.sqrt(max(nearest / match, 1.0)), 255.0)
                product, square = 0.0, 0.0
                for c in range(3):
                    expected[c] = min(gain * means[y, x, 0, c], 255.0)
                    product += value[c] * expected[c]
                    square += expected[c] * expected[c]
                ratio = product / max(square, 1.0)
                if darkest <= ratio < 1.0:
                    chroma_square = 0.0
                    for c in range(3):
                        chroma_square += (value[c] - ratio * expected[c]) ** 2
                    if chroma_square < 3.0 * chroma:
                        evidence[y, x] = SHADOW
            _learn(
                value,
                rate,
                matched,
                weights[y, x],
                means[y, x],
                variances[y, x],
                min_variance,
                first_variance,
            )


@compiled
def _learn(
    value: NDArray[np.float64],
    rate: float,
    matched: int,
    weights: Singles,
    means: Singles,
    variances: Singles,
    min_variance: float,
    first_variance: float,
) -> None:
    modes = weights.shape[0]
    k = matched
    if k < 0:  # a new mode instead of the weakest
        k = modes - 1
        weights[k] = 0.0
        for c in range(3):
            means[k, c] = value[c]
        variances[k] = first_variance
    total = 0.0
    for m in range(modes):
        weights[m] = weights[m] * (1.0 - rate) + (rate if m == k else 0.0)
        total += weights[m]
    for m in range(modes):
        weights[m] /= total
    if matched >= 0:
        gain = min(rate / weights[k], 1.0)
        square = 0.0
        for c in range(3):
            step = value[c] - means[k, c]
            square += step * step
            means[k, c] += gain * step
        # the part of the squared step that is scatter: with a share `own` of the new mean it is shorter
        variances[k] = max((1.0 - gain) * (variances[k] + gain * square / 3.0), min_variance)
    while k > 0 and weights[k] > weights[k - 1]:
        weights[k], weights[k - 1] = weights[k - 1], weights[k]
        variances[k], variances[k - 1] = variances[k - 1], variances[k]
        for c in range(3):
            means[k, c], means[k - 1, c] = means[k - 1, c], means[k, c]
        k -= 1
