"""Hue histograms of many targets' boxes: what `histogram_kernels` does, each target with its own reference.

The boxes of all targets stand below each other; those of target t are `starts[t]` to `starts[t + 1] - 1`.
Boxes of a target that have the same pixels are counted and compared once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.numerics.kernels.box_kernels import find_distinct, pixels_of_boxes
from bayesnet_track.numerics.resampling import copy_row, copy_rows
from bayesnet_track.vision.kernels.histograms.histogram_kernels import (
    cumulative_differences,
    gather,
    integrate,
    occurring,
    pays,
    price,
    spread,
    visit,
)

Counts = NDArray[np.int32]
Bins = NDArray[np.uint8]


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
    kept = 0
    for t in range(starts.shape[0] - 1):
        x0, y0, x1, y1 = regions[t, 0], regions[t, 1], regions[t, 2], regions[t, 3]
        own, seen, whole = pixels_of_boxes(boxes[starts[t] : starts[t + 1]], x0, y0, x1 - x0, y1 - y0)
        first, kind = find_distinct(own, whole)
        for k in range(kind.shape[0]):
            places[starts[t] + k] = kept + kind[k]
        for k in range(first.shape[0]):
            copy_row(own[first[k]], corners[kept + k])
            visible[kept + k], nominal[kept + k] = seen[first[k]], whole[first[k]]
        kept += first.shape[0]
        firsts[t + 1] = kept
    return corners[:kept], visible[:kept], nominal[:kept], firsts, places


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
        own = corners[firsts[t] : firsts[t + 1]]
        x0, y0, x1, y1, pixels, most = 2**62, 2**62, 0, 0, 0, 0
        for n in range(own.shape[0]):
            size = (own[n, 2] - own[n, 0]) * (own[n, 3] - own[n, 1])
            pixels += size
            most = max(most, size)
            if size > 0:
                x0, y0 = min(x0, own[n, 0]), min(y0, own[n, 1])
                x1, y1 = max(x1, own[n, 2]), max(y1, own[n, 3])
        if most == 0:
            continue
        begin, columns, counted = crops[t, 0], crops[t, 1], counts[firsts[t] : firsts[t + 1]]
        whole = binned[begin : begin + y1 * columns].reshape((y1, columns))
        crop = whole[y0:y1, x0:x1]
        if most >= 2**16 or not pays(crop, bins, pixels):
            visit(whole, own, counted)
            continue
        moved = np.empty(own.shape, np.int64)
        for n in range(own.shape[0]):
            empty = own[n, 2] <= own[n, 0] or own[n, 3] <= own[n, 1]
            for k in range(4):
                moved[n, k] = 0 if empty else own[n, k] - (x0 if k % 2 == 0 else y0)
        present = occurring(crop, bins)
        gather(present, integrate(crop, present, 16), moved, 16, counted)
    return counts


@compiled
def _differences(counts: Counts, firsts: Ints, cumulative: Floats) -> tuple[Floats, Floats]:
    found, totals = np.empty(counts.shape), np.empty(counts.shape[0])
    for t in range(cumulative.shape[0]):
        first, last = firsts[t], firsts[t + 1]
        own, pixels = cumulative_differences(counts[first:last], cumulative[t])
        copy_rows(own, found[first:last])
        copy_row(pixels, totals[first:last])
    return found, totals


@compiled
def _prices(
    circular: Floats, colored: Floats, visible: Floats, nominal: Floats, firsts: Ints, shares: Floats
) -> tuple[Floats, Floats]:
    """`shares` (T, 3): of each reference with hue, without it, and the price of a change between the two."""
    distances, outside = np.empty(circular.shape[0]), np.empty(circular.shape[0])
    for t in range(shares.shape[0]):
        first, last = firsts[t], firsts[t + 1]
        hue, gray, achromatic = shares[t, 0], shares[t, 1], shares[t, 2]
        own, out = price(
            circular[first:last],
            colored[first:last],
            visible[first:last],
            nominal[first:last],
            hue,
            gray,
            achromatic,
        )
        copy_row(own, distances[first:last])
        copy_row(out, outside[first:last])
    return distances, outside


def color_distances_of_each(
    counts: Counts, visible: Floats, nominal: Floats, firsts: Ints, shares: Floats, achromatic: float
) -> tuple[Floats, Floats]:
    """(U,) `histogram_kernels.color_distances` to the references of the targets, of shares (T, B + 1)."""
    hue = shares[:, :-1].sum(axis=1)
    cumulative = np.cumsum(shares[:, :-1], axis=1) / np.where(hue == 0.0, 1.0, hue)[:, None]
    difference, colored = _differences(counts, firsts, cumulative)
    difference.sort(axis=1)
    rest = np.column_stack([hue, shares[:, -1], np.full(len(hue), achromatic)])
    return _prices(spread(difference), colored, visible, nominal, firsts, rest)
