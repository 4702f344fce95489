"""Compiled kernels for hue histograms of many boxes, and their circular distance to references.

For many targets the boxes stand below each other; those of target t are `starts[t]` to `starts[t + 1] - 1`.
Boxes of a target that have the same pixels are counted and compared once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.compiled import compiled, compiled_summing, rehearsed
from bayesnet_track.numerics.kernels.box_kernels import find_distinct, pixels_of_boxes
from bayesnet_track.numerics.resampling import copy_row, copy_rows
from bayesnet_track.observation.planes import for_reading

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
    binned = for_reading(binned)
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
    _gather(present, integrate(binned, present, bits), corners, bits, counts)
    return counts


@rehearsed
def _count_a_large_box() -> None:
    """Count the pixels of a box that fills its crop."""
    binned, corners = for_reading(np.zeros((4, 4), np.uint8)), np.array([[0, 0, 4, 4]])
    pays(binned, 1, 16)
    count_directly(binned, corners, 1)


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
    """True if an integral histogram is cheaper than to visit all pixels of the boxes.

    A pixel of a box takes 0.9 ns; one of the integral 0.6 ns, and 0.6 more for every four bins that occur.
    """
    if 4 * binned.size >= 6 * pixels:
        return False
    return bool((4 + occurring(binned, bins).shape[0]) * binned.size < 6 * pixels)


@compiled
def occurring(binned: Bins, bins: int) -> Ints:
    """Bins of the first `bins` that occur."""
    occurs = np.zeros(256, np.bool_)
    for y in range(binned.shape[0]):
        for x in range(binned.shape[1]):
            occurs[binned[y, x]] = True
    present, count = np.empty(256, np.int64), 0
    for value in range(min(bins, 256)):  # not flatnonzero, which takes half a second to compile
        if occurs[value]:
            present[count] = value
            count += 1
    return present[:count]


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
            previous, current, running = integral[w, y], integral[w, y + 1], np.uint64(0)
            current[0] = running
            for x in range(columns):
                running += adds[binned[y, x]]
                current[x + 1] = previous[x + 1] + running
    return integral


@compiled
def _gather(present: Ints, integral: Words, corners: Corners, bits: int, counts: Counts) -> None:
    """Fill in the bins of the boxes that are `present`, from their integral histogram, in counts (N, B)."""
    lanes, mask = 64 // bits, (np.uint64(1) << np.uint64(bits)) - np.uint64(1)
    for n in range(corners.shape[0]):
        x0, y0, x1, y1 = corners[n, 0], corners[n, 1], corners[n, 2], corners[n, 3]
        for w in range(integral.shape[0]):
            word = integral[w, y0, x0] + integral[w, y1, x1] - integral[w, y0, x1] - integral[w, y1, x0]
            for lane in range(min(lanes, present.shape[0] - w * lanes)):
                count = (word >> np.uint64(bits * lane)) & mask
                counts[n, present[w * lanes + lane]] = np.int32(count)


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
        running = 0
        for k in range(bins):
            running += counts[n, k]
            difference[n, k] = running * scale - cumulative[k]
    return difference, totals


@compiled_summing
def spread(ordered: Floats) -> Floats:
    """(N,) 2/B times the sum of distances from the median, of rows (N, B) in ascending order."""
    size, bins = ordered.shape
    spreads = np.empty(size)
    for n in range(size):
        low, high = ordered[n, : bins // 2], ordered[n, bins // 2 :]
        total = 0.0
        for k in range(bins // 2):
            total += high[k] - low[k]
        spreads[n] = 2.0 / bins * total
    return spreads


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
    distances, beyond = np.empty(circular.shape[0]), np.empty(circular.shape[0])
    for n in range(circular.shape[0]):
        beyond[n] = 1.0 - visible[n] / nominal[n]
        both_hue = min(colored[n] / nominal[n], hue)
        both_gray = min((visible[n] - colored[n]) / nominal[n], gray)
        recolored = max(1.0 - both_hue - both_gray - beyond[n], 0.0)
        distances[n] = both_hue * circular[n] + achromatic * recolored + beyond[n]
    return distances, beyond


@compiled
def distinct_of_each(boxes: Floats, starts: Ints, regions: Ints) -> tuple[Ints, Floats, Floats, Ints, Ints]:
    """The boxes of each target of which no other of its own has the same pixels.

    Args:
        boxes: (N, 4) centre boxes, px.
        starts: (T + 1,).
        regions: (T, 4) x0, y0, x1, y1 of the crop on which each target's plane is.

    Returns:
        (U, 4) corners in the crop, (U,) pixels in the crop, (U,) pixels in all, (T + 1,) where those of each
        target begin, and (N,) where each box is among them.
    """
    corners, places = np.empty((boxes.shape[0], 4), np.int64), np.empty(boxes.shape[0], np.int64)
    visible, nominal = np.empty(boxes.shape[0]), np.empty(boxes.shape[0])
    firsts = np.zeros(starts.shape[0], np.int64)
    count = 0
    for t in range(starts.shape[0] - 1):
        x0, y0, x1, y1 = regions[t, 0], regions[t, 1], regions[t, 2], regions[t, 3]
        target_corners, in_crop, in_all = pixels_of_boxes(
            boxes[starts[t] : starts[t + 1]], x0, y0, x1 - x0, y1 - y0
        )
        first, kind = find_distinct(target_corners, in_all)
        for k in range(kind.shape[0]):
            places[starts[t] + k] = count + kind[k]
        for k in range(first.shape[0]):
            copy_row(target_corners[first[k]], corners[count + k])
            visible[count + k], nominal[count + k] = in_crop[first[k]], in_all[first[k]]
        count += first.shape[0]
        firsts[t + 1] = count
    return corners[:count], visible[:count], nominal[:count], firsts, places


@compiled
def count_of_each(binned: Bins, crops: Ints, corners: Ints, firsts: Ints, bins: int) -> Counts:
    """(U, B) pixels of each box in each bin.

    Args:
        binned: (P,) bins of the pixels of all crops, row by row.
        crops: (T, 2) where each target's crop begins, and its columns.
        corners: (U, 4) of the boxes in their crops.
        firsts: (T + 1,) where the boxes of each target begin.
        bins: B.
    """
    counts = np.zeros((corners.shape[0], bins), np.int32)
    for t in range(firsts.shape[0] - 1):
        boxes = corners[firsts[t] : firsts[t + 1]]
        x0, y0, x1, y1, pixels, largest = 2**62, 2**62, 0, 0, 0, 0
        for n in range(boxes.shape[0]):
            size = (boxes[n, 2] - boxes[n, 0]) * (boxes[n, 3] - boxes[n, 1])
            pixels += size
            largest = max(largest, size)
            if size > 0:
                x0, y0 = min(x0, boxes[n, 0]), min(y0, boxes[n, 1])
                x1, y1 = max(x1, boxes[n, 2]), max(y1, boxes[n, 3])
        if largest == 0:
            continue
        begin, columns, counted = crops[t, 0], crops[t, 1], counts[firsts[t] : firsts[t + 1]]
        plane = binned[begin : begin + y1 * columns].reshape((y1, columns))
        crop = plane[y0:y1, x0:x1]
        if largest >= 2**16 or not pays(crop, bins, pixels):
            visit(plane, boxes, counted)
            continue
        shifted = np.empty(boxes.shape, np.int64)
        for n in range(boxes.shape[0]):
            empty = boxes[n, 2] <= boxes[n, 0] or boxes[n, 3] <= boxes[n, 1]
            for k in range(4):
                shifted[n, k] = 0 if empty else boxes[n, k] - (x0 if k % 2 == 0 else y0)
        present = occurring(crop, bins)
        _gather(present, integrate(crop, present, 16), shifted, 16, counted)
    return counts


@compiled
def _differences(counts: Counts, firsts: Ints, cumulative: Floats) -> tuple[Floats, Floats]:
    differences, totals = np.empty(counts.shape), np.empty(counts.shape[0])
    for t in range(cumulative.shape[0]):
        first, stop = firsts[t], firsts[t + 1]
        target_differences, pixels = cumulative_differences(counts[first:stop], cumulative[t])
        copy_rows(target_differences, differences[first:stop])
        copy_row(pixels, totals[first:stop])
    return differences, totals


@compiled
def _prices(
    circular: Floats, colored: Floats, visible: Floats, nominal: Floats, firsts: Ints, shares: Floats
) -> tuple[Floats, Floats]:
    """`shares` (T, 3): of each reference with hue, without it, and the price of a change between the two."""
    distances, beyond = np.empty(circular.shape[0]), np.empty(circular.shape[0])
    for t in range(shares.shape[0]):
        first, stop = firsts[t], firsts[t + 1]
        hue, gray, achromatic = shares[t, 0], shares[t, 1], shares[t, 2]
        target_distances, target_beyond = price(
            circular[first:stop],
            colored[first:stop],
            visible[first:stop],
            nominal[first:stop],
            hue,
            gray,
            achromatic,
        )
        copy_row(target_distances, distances[first:stop])
        copy_row(target_beyond, beyond[first:stop])
    return distances, beyond


def color_distances_of_each(
    counts: Counts, visible: Floats, nominal: Floats, firsts: Ints, shares: Floats, achromatic: float
) -> tuple[Floats, Floats]:
    """(U,) `histogram_kernels.color_distances` to the references of the targets, of shares (T, B + 1)."""
    hue = shares[:, :-1].sum(axis=1)
    cumulative = np.cumsum(shares[:, :-1], axis=1) / np.where(hue == 0.0, 1.0, hue)[:, None]
    difference, colored = _differences(counts, firsts, cumulative)
    difference.sort(axis=1)
    parts = np.column_stack([hue, shares[:, -1], np.full(len(hue), achromatic)])
    return _prices(spread(difference), colored, visible, nominal, firsts, parts)
