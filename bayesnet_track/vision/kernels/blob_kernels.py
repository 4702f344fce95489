"""Compiled kernels for blobs inside boxes: regions of one hue, and blobs of depth."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Ints, Singles
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.observation.planes import for_reading

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
    counts: NDArray[np.int64] = np.zeros(len(boxes), np.int64)
    tolerance = int(tolerance_deg * 256 / 360)
    min_cells = max(math.ceil(min_share * cells * cells), 1)
    _grow(
        for_reading(hue),
        np.ascontiguousarray(boxes),
        origin[0],
        origin[1],
        cells,
        tolerance,
        min_cells,
        _COSINES,
        _SINES,
        blobs,
        counts,
    )
    return blobs, counts


@compiled
def _grow(
    hue: NDArray[np.int16],
    boxes: Floats,
    left: int,
    top: int,
    cells: int,
    tolerance: int,
    min_cells: int,
    cosines: NDArray[np.int64],
    sines: NDArray[np.int64],
    blobs: Floats,
    counts: NDArray[np.int64],
) -> None:
    """`grow_blobs` by joining runs of cells side by side."""
    # Written almost without branches, which a grid of real hues makes unpredictable.
    rows, columns = hue.shape
    size = cells * cells
    column_of = np.empty(cells, np.int64)
    samples = np.full(cells + size, -1, np.int32)  # after an empty row, so that every cell has one above
    beside, joined_above, link = np.zeros((3, cells + size), np.int32)
    current, left_of, upper = samples[cells:], samples[cells - 1 :], samples[:size]
    beside_now, beside_above = beside[cells:], beside[:size]
    below_now, below_left, link_now = joined_above[cells:], joined_above[cells - 1 :], link[cells:]
    run_of, link_at = np.zeros(cells + size, np.int64), np.empty(size + 1, np.int64)
    own_run = run_of[cells:]
    start, end = np.empty(size + 1, np.int64), np.empty(size + 1, np.int64)
    cosine, sine = np.zeros(size + 1, np.int64), np.zeros(size + 1, np.int64)  # running sums
    parent = np.empty(size, np.int64)
    sums = np.empty((size, 5), np.int64)  # cells, x, y, cosine, sine
    order = np.empty(blobs.shape[1], np.int64)
    for n in range(boxes.shape[0]):
        for i in range(cells):
            share = (i + 0.5) / cells - 0.5
            column_of[i] = math.floor(boxes[n, 0] + share * boxes[n, 2] + 0.5) - left
        index = cells
        for j in range(cells):
            share = (j + 0.5) / cells - 0.5
            row = math.floor(boxes[n, 1] + share * boxes[n, 3] + 0.5) - top
            for i in range(cells):
                column = column_of[i]
                is_inside = 0 <= row < rows and 0 <= column < columns
                samples[index] = hue[row, column] if is_inside else -1
                index += 1
        for k in range(size):
            difference = (current[k] - left_of[k]) & 255
            beside_now[k] = (min(difference, 256 - difference) <= tolerance) & (
                (current[k] | left_of[k]) >= 0
            )
        for k in range(size):
            difference = (current[k] - upper[k]) & 255
            below_now[k] = (min(difference, 256 - difference) <= tolerance) & ((current[k] | upper[k]) >= 0)
        for j in range(cells):
            beside_now[j * cells] = 0
        for k in range(size):  # the first cell where a run meets one above
            link_now[k] = below_now[k] & (1 - (beside_now[k] & below_left[k] & beside_above[k]))
        runs, links, cosine_sum, sine_sum = 0, 0, 0, 0
        for k in range(size):  # runs of cells joined side by side, numbered from 1; 0 takes what is none
            colored = np.int64(current[k] >= 0)
            begins = colored & (1 - beside_now[k])
            runs += begins
            own_run[k] = runs
            end[runs * colored] = k
            start[runs * begins] = k
            link_at[links] = k
            links += link_now[k]
            cosine_sum += cosines[current[k]]
            sine_sum += sines[current[k]]
            cosine[k + 1] = cosine_sum
            sine[k + 1] = sine_sum
        for run in range(runs):
            first, past = start[run + 1], end[run + 1] + 1
            length, row = past - first, first // cells
            parent[run] = run
            sums[run, 0] = length
            sums[run, 1] = length * (first + past - 1 - 2 * cells * row) // 2
            sums[run, 2] = length * row
            sums[run, 3] = cosine[past] - cosine[first]
            sums[run, 4] = sine[past] - sine[first]
        for m in range(links):
            root, other_root = own_run[link_at[m]] - 1, run_of[link_at[m]] - 1
            while parent[root] != root:
                root = parent[root]
            while parent[other_root] != other_root:
                other_root = parent[other_root]
            parent[max(root, other_root)] = min(root, other_root)
        for run in range(runs - 1, -1, -1):  # a parent comes before its children
            if parent[run] != run:
                for k in range(5):
                    sums[parent[run], k] += sums[run, k]
                sums[run, 0] = 0
        blob_count = 0
        for run in range(runs):  # insert into the largest so far, in order
            count = sums[run, 0]
            if count < min_cells or (
                blob_count == order.shape[0] and count <= sums[order[blob_count - 1], 0]
            ):
                continue
            blob_count = min(blob_count + 1, order.shape[0])
            place = blob_count - 1
            while place > 0 and sums[order[place - 1], 0] < count:
                order[place] = order[place - 1]
                place -= 1
            order[place] = run
        for k in range(blob_count):
            run = order[k]
            count = sums[run, 0]
            blobs[n, k, 0] = (sums[run, 1] / count + 0.5) / cells - 0.5
            blobs[n, k, 1] = (sums[run, 2] / count + 0.5) / cells - 0.5
            blobs[n, k, 2] = math.degrees(math.atan2(sums[run, 4], sums[run, 3])) % 360.0
            blobs[n, k, 3] = count / size
        counts[n] = blob_count


def match_blobs(
    ours: Floats, theirs: Floats, sd_offset: float, sd_hue_deg: float, limit: float
) -> tuple[NDArray[np.int64], Floats]:
    """One-to-one matches of blobs: each of `ours` in turn takes the nearest one left, nearer than `limit`.

    Args:
        ours: (K, 4) blobs.
        theirs: (M, 4) blobs.
        sd_offset: sd of a centre's coordinates, in widths and heights of the box.
        sd_hue_deg: sd of the mean hue, degrees.
        limit: a pair of a larger cost does not match.

    Returns:
        (K,) index of the match in `theirs`, -1 for none, and (K,) its cost
        ``(dx^2 + dy^2) / (2 sd_offset^2) + dhue^2 / (2 sd_hue^2)`` with dhue round the circle
        (thesis eq. 3.4, corrected), `limit` for none.
    """
    match, cost = np.empty(len(ours), np.int64), np.empty(len(ours))
    penalty = np.empty(len(theirs))
    _match(
        np.ascontiguousarray(ours),
        np.ascontiguousarray(theirs),
        len(theirs),
        sd_offset,
        sd_hue_deg,
        limit,
        match,
        cost,
        penalty,
    )
    return match, cost


@compiled
def _match(
    ours: Floats,
    theirs: Floats,
    count: int,
    sd_offset: float,
    sd_hue_deg: float,
    limit: float,
    match: NDArray[np.int64],
    cost: Floats,
    penalty: Floats,
) -> None:
    by_offset, by_hue = 0.5 / sd_offset**2, 0.5 / sd_hue_deg**2
    for j in range(count):
        penalty[j] = 0.0
    for i in range(ours.shape[0]):
        lowest, to = limit, -1
        for j in range(count):
            x, y = ours[i, 0] - theirs[j, 0], ours[i, 1] - theirs[j, 1]
            hue = abs(ours[i, 2] - theirs[j, 2])
            hue = min(hue, 360.0 - hue)
            pair = by_offset * (x * x + y * y) + by_hue * hue * hue + penalty[j]
            to = j if pair < lowest else to
            lowest = min(pair, lowest)
        match[i], cost[i] = to, lowest
        if to >= 0:
            penalty[to] = np.inf


@compiled
def blob_costs(
    blobs: Floats,
    counts: NDArray[np.int64],
    reference: Floats,
    sd_offset: float,
    sd_hue_deg: float,
    unmatched: float,
) -> Floats:
    """(N,) mean cost of the reference's blobs in each box; every blob without a match costs `unmatched`.

    Blobs count by their share of the box: one that crosses the least size, or breaks, changes little.
    Without a blob in the reference the mean is over the whole box.

    Args:
        blobs: (N, M, 4) blobs of each box.
        counts: (N,) how many of them there are.
        reference: (K, 4) blobs of the reference, C-contiguous.
        sd_offset: see `match_blobs`.
        sd_hue_deg: see `match_blobs`.
        unmatched: cost of a blob without a match.
    """
    size, capacity = reference.shape[0], blobs.shape[1]
    match, cost = np.empty(size, np.int64), np.empty(size)
    penalty = np.empty(capacity)
    costs = np.empty(blobs.shape[0])
    weight = 0.0
    for k in range(size):
        weight += reference[k, 3]
    if size == 0:
        weight = 1.0
    for n in range(blobs.shape[0]):
        _match(reference, blobs[n], counts[n], sd_offset, sd_hue_deg, unmatched, match, cost, penalty)
        total = 0.0
        for k in range(size):
            total += reference[k, 3] * cost[k]
        for j in range(counts[n]):
            total += unmatched * blobs[n, j, 3] * (penalty[j] == 0.0)
        costs[n] = total / weight
    return costs


FEATURES = 5
"""Columns of the table that `blob_features` fills: share, depth, spread, width, height."""
SHARE, DEPTH, SPREAD, WIDTH, HEIGHT = range(FEATURES)

NEAREST_M, FURTHEST_M = 0.01, 10000.0


@compiled
def blob_features(
    points: Singles, boxes: Floats, origin: Ints, cells: int, layer: float, features: Floats
) -> None:
    """Fill `features` (N, 5) with what a grid of samples on each box says of its depth blob.

    The blob of a box is its fullest layer of depth, in which depths differ by a factor of at most
    exp(3 layer). Columns: the samples in the blob as a share of all samples; the blob's mean depth, m; the
    standard deviation of depth over all valid samples of the box, m; and the blob's width and height, m, as
    those of a filled rectangle of the same standard deviation in X and in Y. All 0 without a blob.

    Args:
        points: (rows, columns, 3) X, Y, Z in m of a crop; NaN where there is none.
        boxes: (N, 4) centre boxes, frame coordinates.
        origin: column and row, in the frame, of the crop's first pixel.
        cells: samples along each side of a box, each the pixel nearest to the middle of its cell.
        layer: a third of a layer's depth, as a logarithm.
    """
    rows, columns = points.shape[0], points.shape[1]
    layers = int(np.ceil(np.log(FURTHEST_M / NEAREST_M) / layer)) + 3
    counts = np.zeros(layers, np.int64)
    places = np.empty(cells * cells, np.int64)
    samples = np.empty((cells * cells, 3))
    side = 12.0 / (1.0 - 1.0 / cells**2)  # of evenly spaced samples: width^2 / variance
    for n in range(boxes.shape[0]):
        features[n] = 0.0
        x0 = boxes[n, 0] - boxes[n, 2] / 2 - origin[0] + 0.5
        y0 = boxes[n, 1] - boxes[n, 3] / 2 - origin[1] + 0.5
        valid = 0
        for j in range(cells):
            y = y0 + (j + 0.5) * boxes[n, 3] / cells
            if not (y >= 0.0 and y < rows):
                continue
            v = int(y)
            for i in range(cells):
                x = x0 + (i + 0.5) * boxes[n, 2] / cells
                if not (x >= 0.0 and x < columns):
                    continue
                point = points[v, int(x)]
                depth = float(point[2])
                if not (depth > NEAREST_M and depth < FURTHEST_M):
                    continue
                place = int(np.log(depth / NEAREST_M) / layer) + 1
                counts[place] += 1
                places[valid] = place
                samples[valid, 0], samples[valid, 1], samples[valid, 2] = point[0], point[1], depth
                valid += 1
        if valid == 0:
            continue
        fullest, size = 0, 0
        for k in range(valid):
            place = places[k]
            layer_count = counts[place - 1] + counts[place] + counts[place + 1]
            if layer_count > size or (layer_count == size and place < fullest):
                fullest, size = place, layer_count
        for k in range(valid):
            counts[places[k]] = 0
        x, y, z, all_z = 0.0, 0.0, 0.0, 0.0
        for k in range(valid):
            all_z += samples[k, 2]
            if abs(places[k] - fullest) <= 1:
                x += samples[k, 0]
                y += samples[k, 1]
                z += samples[k, 2]
        x, y, z, all_z = x / size, y / size, z / size, all_z / valid
        xx, yy, zz = 0.0, 0.0, 0.0
        for k in range(valid):
            zz += (samples[k, 2] - all_z) ** 2
            if abs(places[k] - fullest) <= 1:
                xx += (samples[k, 0] - x) ** 2
                yy += (samples[k, 1] - y) ** 2
        features[n, SHARE] = size / cells**2
        features[n, DEPTH] = z
        features[n, SPREAD] = np.sqrt(zz / valid)
        features[n, WIDTH] = np.sqrt(side * xx / size)
        features[n, HEIGHT] = np.sqrt(side * yy / size)
