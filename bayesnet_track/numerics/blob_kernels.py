"""Compiled kernels for blobs: 4-connected regions of one hue inside each of many boxes, and matching them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.compiled import compiled

Floats = NDArray[np.float64]

BLOB_COLUMNS = ("x", "y", "hue", "share")
"""A blob: its centre relative to the box's (in widths and heights), mean hue (degrees), share of the box."""

_TURNS = 2 * np.pi * np.arange(256) / 256
_COSINES = np.rint(2**20 * np.cos(_TURNS)).astype(np.int64)
_SINES = np.rint(2**20 * np.sin(_TURNS)).astype(np.int64)


def grow_blobs(
    hue: NDArray[np.int16],
    boxes: Floats,
    origin: tuple[int, int],
    cells: int,
    tolerance_deg: float,
    min_share: float,
    max_blobs: int,
) -> tuple[Floats, NDArray[np.int64]]:
    """The largest regions of similar hue in each box, grown over a grid of samples.

    The hue is read at the centres of a grid of `cells` x `cells` spanned over each box; neighbours beside and
    above each other join when their hues differ by `tolerance_deg` at most. So the blobs of a box depend on
    nothing outside it, and their cost not on its size.

    Args:
        hue: (rows, columns) 0..255, or -1 where there is none; -1 is taken outside it, too.
        boxes: (N, 4) centre boxes, px.
        origin: column and row of the frame at ``hue[0, 0]``.
        cells: samples along each side of a box.
        tolerance_deg: largest difference of neighbours in one blob, degrees.
        min_share: least share of the box's cells in a blob.
        max_blobs: how many are kept, the largest.

    Returns:
        (N, max_blobs, 4) blobs in `BLOB_COLUMNS`, largest first, and (N,) how many there are.
    """
    blobs: Floats = np.zeros((len(boxes), max_blobs, 4))
    found: NDArray[np.int64] = np.zeros(len(boxes), np.int64)
    tolerance = int(tolerance_deg * 256 / 360)
    least = max(math.ceil(min_share * cells * cells), 1)
    _grow(
        np.ascontiguousarray(hue),
        np.ascontiguousarray(boxes),
        origin[0],
        origin[1],
        cells,
        tolerance,
        least,
        _COSINES,
        _SINES,
        blobs,
        found,
    )
    return blobs, found


@compiled
def _grow(
    hue: NDArray[np.int16],
    boxes: Floats,
    left: int,
    top: int,
    cells: int,
    tolerance: int,
    least: int,
    cosines: NDArray[np.int64],
    sines: NDArray[np.int64],
    blobs: Floats,
    found: NDArray[np.int64],
) -> None:
    rows, columns = hue.shape
    column_of = np.empty(cells, np.int64)
    label_above = np.empty(cells, np.int64)
    hue_above = np.empty(cells, np.int64)
    parent = np.empty(cells * cells, np.int64)
    sums = np.empty((cells * cells, 5), np.int64)  # cells, x, y, cosine, sine
    for n in range(boxes.shape[0]):
        for i in range(cells):
            share = (i + 0.5) / cells - 0.5
            column_of[i] = math.floor(boxes[n, 0] + share * boxes[n, 2] + 0.5) - left
            label_above[i] = -1
        labels = 0
        for j in range(cells):
            share = (j + 0.5) / cells - 0.5
            row = math.floor(boxes[n, 1] + share * boxes[n, 3] + 0.5) - top
            label_before, hue_before = -1, -1
            for i in range(cells):
                column = column_of[i]
                here = -1
                if 0 <= row < rows and 0 <= column < columns:
                    here = np.int64(hue[row, column])
                label = -1
                if here >= 0:
                    if label_before >= 0:
                        apart = (here - hue_before) & 255
                        if min(apart, 256 - apart) <= tolerance:
                            label = label_before
                    if label_above[i] >= 0:
                        apart = (here - hue_above[i]) & 255
                        if min(apart, 256 - apart) <= tolerance:
                            a = label_above[i]
                            while parent[a] != a:
                                a = parent[a]
                            if label < 0:
                                label = a
                            else:
                                b = label
                                while parent[b] != b:
                                    b = parent[b]
                                parent[max(a, b)] = min(a, b)
                                label = min(a, b)
                    if label < 0:
                        label = labels
                        parent[label] = label
                        sums[label] = 0
                        labels += 1
                    sums[label, 0] += 1
                    sums[label, 1] += i
                    sums[label, 2] += j
                    sums[label, 3] += cosines[here]
                    sums[label, 4] += sines[here]
                label_before, hue_before = label, here
                label_above[i], hue_above[i] = label, here
        for label in range(labels - 1, -1, -1):  # a parent's number is smaller than its child's
            if parent[label] != label:
                for k in range(5):
                    sums[parent[label], k] += sums[label, k]
                sums[label, 0] = 0
        kept = 0
        while kept < blobs.shape[1]:
            best = -1
            for label in range(labels):
                if sums[label, 0] >= least and (best < 0 or sums[label, 0] > sums[best, 0]):
                    best = label
            if best < 0:
                break
            count = sums[best, 0]
            blobs[n, kept, 0] = (sums[best, 1] / count + 0.5) / cells - 0.5
            blobs[n, kept, 1] = (sums[best, 2] / count + 0.5) / cells - 0.5
            blobs[n, kept, 2] = math.degrees(math.atan2(sums[best, 4], sums[best, 3])) % 360.0
            blobs[n, kept, 3] = count / (cells * cells)
            sums[best, 0] = 0
            kept += 1
        found[n] = kept


@compiled
def match_blobs(
    ours: Floats, theirs: Floats, sd_offset: float, sd_hue_deg: float, limit: float
) -> tuple[NDArray[np.int64], Floats]:
    """One-to-one matches, nearest pair first, of pairs nearer than `limit`.

    Args:
        ours: (K, 4) blobs.
        theirs: (M, 4) blobs.
        sd_offset: sd of a centre's coordinates, in widths and heights of the box.
        sd_hue_deg: sd of the mean hue, degrees.
        limit: a pair with a larger cost does not match.

    Returns:
        (K,) index of the match in `theirs`, -1 for none, and (K,) its cost
        ``(dx^2 + dy^2) / (2 sd_offset^2) + dhue^2 / (2 sd_hue^2)`` with dhue round the circle
        (thesis eq. 3.4, corrected), `limit` for none.
    """
    size, others = ours.shape[0], theirs.shape[0]
    match, cost = np.full(size, -1, np.int64), np.full(size, limit)
    taken = np.zeros(others, np.bool_)
    for _ in range(min(size, others)):
        least, at, to = limit, -1, -1
        for i in range(size):
            if match[i] >= 0:
                continue
            for j in range(others):
                if taken[j]:
                    continue
                x, y = ours[i, 0] - theirs[j, 0], ours[i, 1] - theirs[j, 1]
                hue = abs(ours[i, 2] - theirs[j, 2])
                hue = min(hue, 360.0 - hue)
                pair = (x * x + y * y) / (2 * sd_offset**2) + hue * hue / (2 * sd_hue_deg**2)
                if pair < least:
                    least, at, to = pair, i, j
        if at < 0:
            break
        match[at], cost[at], taken[to] = to, least, True
    return match, cost


@compiled
def blob_costs(
    blobs: Floats,
    found: NDArray[np.int64],
    reference: Floats,
    sd_offset: float,
    sd_hue_deg: float,
    unmatched: float,
) -> Floats:
    """(N,) mean cost of the reference's blobs in each box; every blob without a match costs `unmatched`.

    Args:
        blobs: (N, M, 4) blobs of each box.
        found: (N,) how many of them there are.
        reference: (K, 4) blobs of the reference; with none, each blob found costs `unmatched`.
        sd_offset: see `match_blobs`.
        sd_hue_deg: see `match_blobs`.
        unmatched: cost of a blob without a match.
    """
    size = reference.shape[0]
    costs = np.empty(blobs.shape[0])
    for n in range(blobs.shape[0]):
        match, cost = match_blobs(reference, blobs[n, : found[n]], sd_offset, sd_hue_deg, unmatched)
        matched = 0
        total = 0.0
        for k in range(size):
            total += cost[k]
            if match[k] >= 0:
                matched += 1
        costs[n] = (total + unmatched * (found[n] - matched)) / max(size, 1)
    return costs
