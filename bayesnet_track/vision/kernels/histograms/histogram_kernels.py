"""Compiled kernels for hue histograms of many boxes, and their circular distance to a reference."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled, compiled_summing

Counts = NDArray[np.int32]
Bins = NDArray[np.uint8]
Corners = NDArray[np.int64]

INTEGRAL_SHARE = 0.04
"""An integral histogram is cheaper where the crop has less than this share of all boxes' pixels."""


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
    if binned.size > INTEGRAL_SHARE * int(pixels.sum()):
        return count_directly(binned, corners, bins)
    return count_by_integral(binned, corners, bins)


def count_directly(binned: Bins, corners: Corners, bins: int) -> Counts:
    """`count_in_boxes` by visiting each pixel of each box."""
    counts: Counts = np.zeros((len(corners), 256), np.int32)
    _visit(binned, corners, counts)
    return np.ascontiguousarray(counts[:, :bins])


def count_by_integral(binned: Bins, corners: Corners, bins: int) -> Counts:
    """`count_in_boxes` by four reads of an integral histogram.

    Sums are kept modulo 2^16 where no box has that many pixels: the differences are exact all the same,
    and half as much memory is moved.
    """
    pixels = (corners[:, 2] - corners[:, 0]) * (corners[:, 3] - corners[:, 1])
    dtype = np.uint16 if int(pixels.max(initial=0)) < 2**16 else np.uint32
    rows, columns = binned.shape
    integral = np.empty((rows + 1, columns + 1, bins), dtype)
    integrate(binned, one_hot_rows(bins, dtype), integral)
    counts: Counts = np.empty((len(corners), bins), np.int32)
    gather(integral, corners, counts)
    return counts


@lru_cache(maxsize=16)
def one_hot_rows(bins: int, dtype: type[np.unsignedinteger]) -> NDArray[np.unsignedinteger]:
    """(256, bins) what a pixel of each bin adds to the counts; only read."""
    return np.eye(256, bins, dtype=dtype)


@compiled
def _visit(binned: Bins, corners: Corners, counts: Counts) -> None:
    for n in range(corners.shape[0]):
        row = counts[n]
        for y in range(corners[n, 1], corners[n, 3]):
            for x in range(corners[n, 0], corners[n, 2]):
                row[binned[y, x]] += 1


@compiled
def integrate(
    binned: Bins, one_hot: NDArray[np.unsignedinteger], integral: NDArray[np.unsignedinteger]
) -> None:
    """Fill the integral histogram (rows + 1, columns + 1, B) of `binned`; a row of `one_hot` is a bin's."""
    rows, columns = binned.shape
    bins = integral.shape[2]
    integral[0] = 0
    running = np.zeros(bins, integral.dtype)
    for y in range(rows):
        running[:] = 0
        integral[y + 1, 0] = 0
        for x in range(columns):
            above, here, hot = integral[y, x + 1], integral[y + 1, x + 1], one_hot[binned[y, x]]
            for k in range(bins):
                total = running[k] + hot[k]
                running[k] = total
                here[k] = above[k] + total


@compiled
def gather(integral: NDArray[np.unsignedinteger], corners: Corners, counts: Counts) -> None:
    """Fill the counts (N, B) of the boxes from an integral histogram."""
    modulus = 1 << (8 * integral.itemsize)
    for n in range(corners.shape[0]):
        x0, y0, x1, y1 = corners[n, 0], corners[n, 1], corners[n, 2], corners[n, 3]
        a, b, c, d = integral[y0, x0], integral[y0, x1], integral[y1, x0], integral[y1, x1]
        for k in range(counts.shape[1]):
            counts[n, k] = (np.int64(a[k]) + np.int64(d[k]) - np.int64(b[k]) - np.int64(c[k])) & (modulus - 1)


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
