"""Compiled kernels for hue histograms of many boxes, and their circular distance to a reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.compiled import compiled, compiled_summing
from bayesnet_track.numerics.resampling import copy_row

Counts = NDArray[np.int32]
Bins = NDArray[np.uint8]
Words = NDArray[np.uint64]
Corners = NDArray[np.int64]


def count_in_boxes(binned: Bins, corners: Corners, bins: int) -> Counts:
    """Histogram of every box, by whichever of two exact methods is cheaper.

    Args:
        binned: (rows, columns) bin of each pixel; `bins` and above are not counted.
        corners: (N, 4) x0, y0, x1, y1 of each box in rows and columns of `binned`, inside it.
        bins: number of bins.

    Returns:
        (N, bins) pixels of each box in each bin.
    """
    binned = np.ascontiguousarray(binned)  # one compiled version only
    pixels = (corners[:, 2] - corners[:, 0]) * (corners[:, 3] - corners[:, 1])
    if pays(binned, bins, int(pixels.sum())):
        return count_by_integral(binned, corners, bins)
    return count_directly(binned, corners, bins)


def count_directly(binned: Bins, corners: Corners, bins: int) -> Counts:
    """`count_in_boxes` by visiting each pixel of each box."""
    counts: Counts = np.empty((len(corners), bins), np.int32)
    visit(binned, corners, counts)
    return counts


def count_by_integral(binned: Bins, corners: Corners, bins: int) -> Counts:
    """`count_in_boxes` by four reads of an integral histogram."""
    pixels = (corners[:, 2] - corners[:, 0]) * (corners[:, 3] - corners[:, 1])
    bits = 16 if int(pixels.max(initial=0)) < 2**16 else 32
    counts: Counts = np.zeros((len(corners), bins), np.int32)
    present = occurring(binned, bins)
    gather(present, integrate(binned, present, bits), corners, bits, counts)
    return counts


@compiled
def visit(binned: Bins, corners: Corners, counts: Counts) -> None:
    """Fill in the counts (N, B), pixel by pixel."""
    row = np.zeros(256, np.int32)
    for n in range(corners.shape[0]):
        row[:] = 0
        for y in range(corners[n, 1], corners[n, 3]):
            for x in range(corners[n, 0], corners[n, 2]):
                row[binned[y, x]] += 1
        copy_row(row, counts[n])


@compiled
def pays(binned: Bins, bins: int, pixels: int) -> bool:
    """Whether an integral histogram is cheaper than to visit all pixels of the boxes.

    A pixel of a box takes 0.9 ns; one of the integral 0.6 ns, and 0.6 more for every four bins that occur.
    """
    if 4 * binned.size >= 6 * pixels:
        return False
    return bool((4 + occurring(binned, bins).shape[0]) * binned.size < 6 * pixels)


@compiled
def occurring(binned: Bins, bins: int) -> Ints:
    """Those of the first `bins` that occur."""
    occurs = np.zeros(256, np.bool_)
    for y in range(binned.shape[0]):
        for x in range(binned.shape[1]):
            occurs[binned[y, x]] = True
    return np.flatnonzero(occurs[:bins])


@compiled
def integrate(binned: Bins, present: Ints, bits: int) -> Words:
    """The integral histogram (W, rows + 1, columns + 1) of the bins that are `present`.

    A word has the sums of several bins, of so many `bits` each. A sum may outgrow its bits, into those of the
    next: differences of words have the counts of a box all the same, if it has fewer than 2^bits pixels.
    """
    lanes, (rows, columns) = 64 // bits, binned.shape
    integral = np.empty(((present.shape[0] + lanes - 1) // lanes, rows + 1, columns + 1), np.uint64)
    for w in range(integral.shape[0]):
        adds = np.zeros(256, np.uint64)
        for lane in range(min(lanes, present.shape[0] - w * lanes)):
            adds[present[w * lanes + lane]] = np.uint64(1) << np.uint64(bits * lane)
        for x in range(columns + 1):
            integral[w, 0, x] = 0
        for y in range(rows):
            above, here, running = integral[w, y], integral[w, y + 1], np.uint64(0)
            here[0] = running
            for x in range(columns):
                running += adds[binned[y, x]]
                here[x + 1] = above[x + 1] + running
    return integral


@compiled
def gather(present: Ints, integral: Words, corners: Corners, bits: int, counts: Counts) -> None:
    """Fill in the bins of the boxes that are `present`, from their integral histogram, in counts (N, B)."""
    lanes, mask = 64 // bits, (np.uint64(1) << np.uint64(bits)) - np.uint64(1)
    for n in range(corners.shape[0]):
        x0, y0, x1, y1 = corners[n, 0], corners[n, 1], corners[n, 2], corners[n, 3]
        for w in range(integral.shape[0]):
            word = integral[w, y0, x0] + integral[w, y1, x1] - integral[w, y0, x1] - integral[w, y1, x0]
            for lane in range(min(lanes, present.shape[0] - w * lanes)):
                own = (word >> np.uint64(bits * lane)) & mask
                counts[n, present[w * lanes + lane]] = np.int32(own)


def color_distances(
    counts: Counts, visible: Floats, nominal: Floats, shares: Floats, achromatic: float
) -> tuple[Floats, Floats]:
    """(N,) cost of moving each histogram into a reference, 0..1, and (N,) the share of each box outside.

    Coloured pixels go to coloured ones, colourless to colourless, as far as both have them; what is left over
    has changed between colour and no colour. Pixels outside cost 1 each. The cost of moving hues is the
    circular earth mover's distance, 1 between opposite hues: ``2/B sum |D - median D|`` with D the difference
    of the cumulative shares. It is thesis eq. 3.2 in a form in which it does not matter where hue starts.

    Args:
        counts: (N, B) coloured pixels in each bin.
        visible: (N,) pixels inside the frame.
        nominal: (N,) pixels of the whole box.
        shares: (B + 1,) of the reference, without colour last.
        achromatic: price of a change between colour and no colour.
    """
    hue = float(shares[:-1].sum())
    difference, colored = cumulative_differences(counts, np.cumsum(shares[:-1]) / (hue or 1.0))
    difference.sort(axis=1)  # NumPy sorts many short rows faster than compiled code
    return price(spread(difference), colored, visible, nominal, hue, float(shares[-1]), achromatic)


@compiled
def cumulative_differences(counts: Counts, cumulative: Floats) -> tuple[Floats, Floats]:
    """(N, B) differences of the cumulative shares, and (N,) pixels counted."""
    size, bins = counts.shape
    difference, totals = np.empty((size, bins)), np.empty(size)
    for n in range(size):
        total = 0
        for k in range(bins):
            total += counts[n, k]
        totals[n] = total
        scale = 1.0 / max(total, 1)
        below = 0
        for k in range(bins):
            below += counts[n, k]
            difference[n, k] = below * scale - cumulative[k]
    return difference, totals


@compiled_summing
def spread(ordered: Floats) -> Floats:
    """(N,) 2/B times the sum of distances from the median, of rows (N, B) in ascending order."""
    size, bins = ordered.shape
    found = np.empty(size)
    for n in range(size):
        low, high = ordered[n, : bins // 2], ordered[n, bins // 2 :]
        total = 0.0
        for k in range(bins // 2):
            total += high[k] - low[k]
        found[n] = 2.0 / bins * total
    return found


@compiled
def price(
    circular: Floats,
    colored: Floats,
    visible: Floats,
    nominal: Floats,
    hue: float,
    gray: float,
    achromatic: float,
) -> tuple[Floats, Floats]:
    """(N,) the cost of moving histograms whose hues lie `circular` (N,) apart, and the share outside."""
    distances, outside = np.empty(circular.shape[0]), np.empty(circular.shape[0])
    for n in range(circular.shape[0]):
        outside[n] = 1.0 - visible[n] / nominal[n]
        both_hue = min(colored[n] / nominal[n], hue)
        both_gray = min((visible[n] - colored[n]) / nominal[n], gray)
        changed = max(1.0 - both_hue - both_gray - outside[n], 0.0)
        distances[n] = both_hue * circular[n] + achromatic * changed + outside[n]
    return distances, outside
