"""Compiled kernels of boxes and grids: their motion, crops, the best of many alike, mass of lines.

Numba draws the normals of a NumPy Generator with the bits that NumPy draws, and faster. Matrices are applied
in a fixed order, so that results do not depend on the linear algebra library or its threads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.compiled import compiled, rehearsed

Ancestors = NDArray[np.intp]
Rows = tuple[tuple[float, ...], ...]


@compiled
def drifted(states: Floats, moves: Rows) -> Floats:
    """(N, D) states after the transition `moves` (n, n) of each axis' chain.

    A state is x, y, w, h, then vx, vy, then ax, ay: D = 2 n + 2. w and h stay. The matrix comes as tuples:
    their lengths are known when it is compiled, and the loops over them cost nothing.
    """
    next_states = np.empty(states.shape)
    for m in range(states.shape[0]):
        next_states[m, 2], next_states[m, 3] = states[m, 2], states[m, 3]
        for axis in range(2):
            for i in range(len(moves)):
                value = moves[i][0] * states[m, axis]
                for j in range(1, len(moves)):
                    value += moves[i][j] * states[m, 2 + 2 * j + axis]
                next_states[m, axis if i == 0 else 2 + 2 * i + axis] = value
    return next_states


@compiled
def _driven(state: Floats, moves: Rows, root: Rows, normals: Floats, next_state: Floats) -> None:
    """Fill `next_state` (D,) with `state` after the transition and noise of the `normals` (2 n,)."""
    next_state[2], next_state[3] = state[2], state[3]
    for axis in range(2):
        for i in range(len(moves)):
            value, noise = moves[i][0] * state[axis], root[i][0] * normals[axis]
            for j in range(1, len(moves)):
                value += moves[i][j] * state[2 + 2 * j + axis]
                noise += root[i][j] * normals[2 * j + axis]
            next_state[axis if i == 0 else 2 + 2 * i + axis] = value + noise


@compiled
def confine(states: Floats, width: float, height: float) -> None:
    """In place: centres of the states (N, D) onto an image of that size, sizes to 1 px .. twice the image's.

    NaN stays.
    """
    for n in range(states.shape[0]):
        for k in range(4):
            extent = width if k % 2 == 0 else height
            low, high = (0.0, extent - 1.0) if k < 2 else (1.0, 2.0 * extent)
            if states[n, k] < low:
                states[n, k] = low
            elif states[n, k] > high:
                states[n, k] = high


@compiled
def confine_moments(mean: Floats, covariance: Floats, width: float, height: float) -> None:
    """In place: the mean (D,) as by `confine`, and its sds by x, y, w, h at most those of a box anywhere.

    Those are root mean square distances from the mean. Correlations are kept. In an image that is infinite
    centres go anywhere.
    """
    shrink, shrinks = np.ones(mean.shape[0]), False
    for k in range(4):
        extent = width if k % 2 == 0 else height
        low, high = (0.0, extent - 1.0) if k < 2 else (1.0, 2.0 * extent)
        if mean[k] < low and (k >= 2 or extent < np.inf):
            mean[k] = low
        elif mean[k] > high:
            mean[k] = high
        if extent < np.inf:
            offset = mean[k] - (low + high) / 2
            limit = np.sqrt((high - low) * (high - low) / 12 + offset * offset)
            variance = covariance[k, k]
            if variance > limit * limit:
                shrink[k], shrinks = min(1.0, limit / np.sqrt(variance)), True
    if shrinks:
        for i in range(mean.shape[0]):
            for j in range(mean.shape[0]):
                covariance[i, j] *= shrink[i] * shrink[j]


@compiled
def scale_steps(
    steps: Floats,
    areas: Floats,
    px: tuple[float, float],
    box: tuple[float, float],
    dt: float,
    wide: Ancestors,
    factor: float,
) -> None:
    """In place: normals (N, 2) times the sds of x and y over `dt` of boxes of these `areas` (N,), px^2.

    An sd has a part in px and one in sides of the box. Those of the rows `wide` are `factor` times as large.
    """
    for k in range(2):
        of_px, of_box = px[k] * px[k], box[k] * box[k]
        for n in range(len(areas)):
            steps[n, k] *= np.sqrt(dt * (of_px + of_box * areas[n]))
    for n in wide:
        steps[n, 0] *= factor
        steps[n, 1] *= factor


@compiled
def box_shares_inside(boxes: Floats, width: float, height: float) -> Floats:
    """(N,) share of each centre box (N, 4) on an image of that size, whose pixels reach from -0.5 on."""
    shares = np.ones(len(boxes))
    for n in range(len(boxes)):
        for k, extent in ((0, width), (1, height)):
            place, side = boxes[n, k], boxes[n, 2 + k]
            visible = min(place + side / 2, extent - 0.5) - max(place - side / 2, -0.5)
            shares[n] *= min(max(visible / side, 0.0), 1.0)
    return shares


@compiled
def extent_of_boxes(boxes: Floats, half: float) -> tuple[float, float, float, float]:
    """Least x and y and largest x and y of the centre boxes (N, 4) with sides of 2 `half` their size.

    All NaN where there is a NaN.
    """
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    for n in range(boxes.shape[0]):
        half_width, half_height = boxes[n, 2] * half, boxes[n, 3] * half
        if not np.isfinite(boxes[n, 0] + half_width) or not np.isfinite(boxes[n, 1] + half_height):
            bad = boxes[n, 0] + half_width + boxes[n, 1] + half_height
            if np.isnan(bad):
                return bad, bad, bad, bad
        left, right = min(left, boxes[n, 0] - half_width), max(right, boxes[n, 0] + half_width)
        top, bottom = min(top, boxes[n, 1] - half_height), max(bottom, boxes[n, 1] + half_height)
    return left, top, right, bottom


@compiled
def driven(states: Floats, parents: Ancestors, moves: Rows, root: Rows, normals: Floats) -> Floats:
    """Move `states[parents]` as `drifted` does, noise root z on each chain: `root` (n, n) is triangular.

    A row of `normals` (M, 2 n) has the first z of x, the first of y, the second of x and so on.
    """
    next_states = np.empty((parents.shape[0], states.shape[1]))
    for m in range(parents.shape[0]):
        _driven(states[parents[m]], moves, root, normals[m], next_states[m])
    return next_states


@compiled
def driven_by(
    states: Floats, parents: Ancestors, moves: Rows, root: Rows, rng: np.random.Generator
) -> Floats:
    """`driven` by `rng.standard_normal((M, 2 n))`, bit by bit: faster, but for 30 us to take `rng` over."""
    next_states = np.empty((parents.shape[0], states.shape[1]))
    normals = np.empty(2 * len(moves))
    for m in range(parents.shape[0]):
        for k in range(normals.shape[0]):
            normals[k] = rng.standard_normal()
        _driven(states[parents[m]], moves, root, normals, next_states[m])
    return next_states


Corners = NDArray[np.int64]


@compiled
def pixels_of_boxes(
    boxes: Floats, left: int, top: int, columns: int, rows: int
) -> tuple[Corners, Floats, Floats]:
    """(N, 4) corners x0, y0, x1, y1 of each box in the crop, (N,) pixels in the crop, (N,) pixels in all.

    A pixel is in a box when low edge <= its centre < high edge; every box has at least the nearest one.

    Args:
        boxes: (N, 4) centre boxes, px.
        left, top: column and row of the frame at the crop's first pixel.
        columns, rows: size of the crop.
    """
    size = boxes.shape[0]
    corners = np.zeros((size, 4), np.int64)
    visible, nominal = np.ones(size), np.ones(size)
    for n in range(size):
        for axis in range(2):
            first, extent = (left, columns) if axis == 0 else (top, rows)
            half = boxes[n, 2 + axis] / 2
            low, high = np.ceil(boxes[n, axis] - half), np.ceil(boxes[n, axis] + half)
            if not high > low:
                low = np.floor(boxes[n, axis] + 0.5)
                high = low + 1.0
            nominal[n] *= high - low
            # In this order NaN becomes 0: no index may leave the crop.
            begin, end = min(max(0.0, low - first), float(extent)), min(max(0.0, high - first), float(extent))
            corners[n, axis], corners[n, 2 + axis] = int(begin), int(end)
            visible[n] *= end - begin
    return corners, visible, nominal


@compiled
def crops_of_each(boxes: Floats, starts: Corners, grow: float, columns: int, rows: int) -> Corners:
    """(T, 4) x0, y0, x1, y1 in the frame of what holds each target's boxes, grown by `grow` of their sizes.

    Those of target t are `starts[t]` to `starts[t + 1] - 1` of the boxes (N, 4).
    """
    corners = np.empty((starts.shape[0] - 1, 4), np.int64)
    for t in range(corners.shape[0]):
        for axis in range(2):
            low, high, extent = np.inf, -np.inf, float(columns if axis == 0 else rows)
            for n in range(starts[t], starts[t + 1]):
                reach = boxes[n, 2 + axis] * (0.5 + grow)
                low, high = min(low, boxes[n, axis] - reach), max(high, boxes[n, axis] + reach)
            # In this order NaN becomes 0: no index may leave the frame.
            corners[t, axis] = int(min(max(0.0, np.floor(low + 0.5)), extent))
            corners[t, 2 + axis] = int(min(max(0.0, np.ceil(high + 0.5)), extent))
    return corners


@compiled
def find_fitting(
    boxes: Floats,
    scores: Floats,
    extent: tuple[int, int],
    areas_px2: tuple[float, float],
    min_score: float,
) -> Corners:
    """Indices of the boxes (N, 4) that are finite, fit, and lie partly on an image of this size.

    Those fit whose area is within the limits and whose score is `min_score` or more.
    """
    indices = np.empty(boxes.shape[0], np.int64)
    count = 0
    for n in range(boxes.shape[0]):
        area, fits = 1.0, scores[n] >= min_score
        for axis in range(2):
            centre, side = boxes[n, axis], boxes[n, 2 + axis]
            area *= side
            fits &= np.isfinite(centre) and np.isfinite(side) and side > 0.0
            fits &= abs(2.0 * centre - (extent[axis] - 1)) < side + extent[axis]
        if fits and areas_px2[0] <= area <= areas_px2[1]:
            indices[count] = n
            count += 1
    return indices[:count].copy()


@compiled
def keep_best(boxes: Floats, most_overlap: float, limit: int) -> Corners:
    """Indices of the kept boxes (N, 4), the best first: `limit` of them, none too alike a better one.

    Greedy non-maximum suppression: of two whose intersection over union (`numerics.boxes.overlap`) is above
    `most_overlap` the first stays.
    """
    indices = np.empty(min(limit, boxes.shape[0]), np.int64)
    count = 0
    for n in range(boxes.shape[0]):
        if count == indices.shape[0]:
            break
        is_new = True
        for k in range(count):
            better = indices[k]
            shared = 1.0
            for axis in range(2):
                a, b = boxes[better, 2 + axis] / 2, boxes[n, 2 + axis] / 2
                low = max(boxes[better, axis] - a, boxes[n, axis] - b)
                shared *= max(min(boxes[better, axis] + a, boxes[n, axis] + b) - low, 0.0)
                if shared == 0.0:
                    break
            if shared > 0.0:
                union = boxes[better, 2] * boxes[better, 3] + boxes[n, 2] * boxes[n, 3] - shared
                if union > 0 and shared / union > most_overlap:
                    is_new = False
                    break
        if is_new:
            indices[count] = n
            count += 1
    return indices[:count].copy()


@compiled
def find_distinct(corners: Corners, nominal: Floats) -> tuple[Corners, Corners]:
    """(U,) the first of each kind of boxes with the same pixels, and (N,) the place of each box's kind there.

    `corners` (N, 4) and `nominal` (N,) are those of `pixels_of_boxes`.
    """
    count = corners.shape[0]
    size = 4
    while size < 2 * count:
        size *= 2
    table, first, kind = np.full(size, -1), np.empty(count, np.int64), np.empty(count, np.int64)
    kinds = 0
    for n in range(count):
        x0, y0, x1, y1 = corners[n, 0], corners[n, 1], corners[n, 2], corners[n, 3]
        slot = ((x0 * 31 + y0) * 31 + x1) * 31 + y1
        slot = (slot ^ (slot >> 7)) & (size - 1)
        while table[slot] >= 0:
            m = first[table[slot]]
            same = corners[m, 0] == x0 and corners[m, 1] == y0 and corners[m, 2] == x1 and corners[m, 3] == y1
            if same and nominal[m] == nominal[n]:
                break
            slot = (slot + 1) & (size - 1)
        if table[slot] < 0:
            table[slot] = kinds
            first[kinds] = n
            kinds += 1
        kind[n] = table[slot]
    return first[:kinds].copy(), kind


@compiled
def pairs_alike(
    boxes: Floats, sides: Floats, variances: Floats, order: Corners, limit: float, widened: float
) -> tuple[Corners, Corners]:
    """Pairs (P,) of centre boxes (T, 4) that may lie less than a box apart, with no field too far off.

    A field is by d^2 > `limit` s^2, s^2 the mean of both `variances` (T, 4) and the square of the share
    `widened` of the mean box; an infinite limit allows all. `sides` (T,) are those of squares of equal area,
    `order` sorts the boxes by x.
    """
    count = boxes.shape[0]
    largest = 0.0
    for t in range(count):
        largest = max(largest, sides[t])
    first, second = np.empty(count, np.int64), np.empty(count, np.int64)
    pairs = 0
    for rank in range(count):
        row = order[rank]
        end = boxes[row, 0] + (sides[row] + largest) / 2
        for next_place in range(rank + 1, count):
            neighbour = order[next_place]
            if boxes[neighbour, 0] > end:
                break
            fits = True
            for k in range(4):
                if limit < np.inf and fits:
                    place = widened * ((boxes[row, 2 + k % 2] + boxes[neighbour, 2 + k % 2]) / 2)
                    spread = (variances[row, k] + variances[neighbour, k]) / 2 + place * place
                    fits = (boxes[row, k] - boxes[neighbour, k]) ** 2 <= limit * spread
            if fits:
                if pairs == first.shape[0]:
                    first, second = np.append(first, first), np.append(second, second)
                first[pairs], second[pairs] = row, neighbour
                pairs += 1
    return first[:pairs].copy(), second[:pairs].copy()


@rehearsed
def _cut_crops() -> None:
    """Cut crops for targets that learn their looks or return."""
    boxes = np.ones((1, 4))
    crops_of_each(boxes, np.array([0, 1]), 0.0, 4, 4)
    extent_of_boxes(boxes, 0.5)


STRIP = 256
"""Cells that are turned at a time."""


@compiled
def spread_columns(mass: Floats, taps: Floats, first: Ints, target: Floats) -> None:
    """Add to `target` (A, B, Y, X') the lines along X of `mass` (A, B, Y, X), each spread by its kernel.

    The kernel of B is `taps[b]` (T,); its first tap takes column 0 to column `first[b]`, all inside `target`.
    """
    a_size, b_size, rows, columns = mass.shape
    for a in range(a_size):
        for b in range(b_size):
            for y in range(rows):
                line = mass[a, b, y]
                for t in range(taps.shape[1]):
                    weight, low = taps[b, t], first[b] + t
                    to = target[a, b, y, low : low + columns]
                    for x in range(columns):
                        to[x] += weight * line[x]


@compiled
def spread_rows(mass: Floats, taps: Floats, first: Ints, target: Floats) -> None:
    """Spread mass along Y: add to `target` (A, B, Y', X), with the kernel `taps[a]` of A."""
    a_size, b_size, rows, columns = mass.shape
    for a in range(a_size):
        for b in range(b_size):
            for y in range(rows):
                line = mass[a, b, y]
                for t in range(taps.shape[1]):
                    weight = taps[a, t]
                    to = target[a, b, first[a] + t + y]
                    for x in range(columns):
                        to[x] += weight * line[x]


@compiled
def turn(mass: Floats, y_change: Floats, x_change: Floats, target: Floats) -> None:
    """Fill `target` (A, B, P) with sum y_change[a, c] x_change[b, d] mass[c, d, p].

    Strips of P stay in the cache.
    """
    a_size, b_size, places = mass.shape
    strip = np.empty((a_size, b_size, STRIP))
    for low in range(0, places, STRIP):
        count = min(STRIP, places - low)
        for c in range(a_size):
            for b in range(b_size):
                line = strip[c, b]
                line[:] = 0.0
                for d in range(b_size):
                    weight, source = x_change[b, d], mass[c, d, low : low + count]
                    for p in range(count):
                        line[p] += weight * source[p]
        for a in range(a_size):
            for b in range(b_size):
                to = target[a, b, low : low + count]
                to[:] = 0.0
                for c in range(a_size):
                    weight, line = y_change[a, c], strip[c, b]
                    for p in range(count):
                        to[p] += weight * line[p]
