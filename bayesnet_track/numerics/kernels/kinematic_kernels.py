"""Compiled kernels that move hypotheses: chains of derivatives per axis, driven by Gaussian noise.

Numba draws the normals of a NumPy Generator with the bits that NumPy draws, and faster. Matrices are applied
in a fixed order, so that results do not depend on the linear algebra library or its threads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled

Ancestors = NDArray[np.intp]
Rows = tuple[tuple[float, ...], ...]


@compiled
def drifted(states: Floats, moves: Rows) -> Floats:
    """(N, D) states after the transition `moves` (n, n) of each axis' chain.

    A state is x, y, w, h, then vx, vy, then ax, ay: D = 2 n + 2. w and h stay. The matrix comes as tuples:
    their lengths are known when it is compiled, and the loops over them cost nothing.
    """
    new = np.empty(states.shape)
    for m in range(states.shape[0]):
        new[m, 2], new[m, 3] = states[m, 2], states[m, 3]
        for axis in range(2):
            for i in range(len(moves)):
                value = moves[i][0] * states[m, axis]
                for j in range(1, len(moves)):
                    value += moves[i][j] * states[m, 2 + 2 * j + axis]
                new[m, axis if i == 0 else 2 + 2 * i + axis] = value
    return new


@compiled
def _driven(old: Floats, moves: Rows, root: Rows, normals: Floats, new: Floats) -> None:
    """Fill the state `new` (D,) with `old` after the transition and noise of the `normals` (2 n,)."""
    new[2], new[3] = old[2], old[3]
    for axis in range(2):
        for i in range(len(moves)):
            value, noise = moves[i][0] * old[axis], root[i][0] * normals[axis]
            for j in range(1, len(moves)):
                value += moves[i][j] * old[2 + 2 * j + axis]
                noise += root[i][j] * normals[2 * j + axis]
            new[axis if i == 0 else 2 + 2 * i + axis] = value + noise


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
            away = mean[k] - (low + high) / 2
            most = np.sqrt((high - low) * (high - low) / 12 + away * away)
            own = covariance[k, k]
            if own > most * most:
                shrink[k], shrinks = min(1.0, most / np.sqrt(own)), True
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
def shares_inside(boxes: Floats, width: float, height: float) -> Floats:
    """(N,) share of each centre box (N, 4) on an image of that size, whose pixels reach from -0.5 on."""
    shares = np.ones(len(boxes))
    for n in range(len(boxes)):
        for k, extent in ((0, width), (1, height)):
            place, side = boxes[n, k], boxes[n, 2 + k]
            inside = min(place + side / 2, extent - 0.5) - max(place - side / 2, -0.5)
            shares[n] *= min(max(inside / side, 0.0), 1.0)
    return shares


@compiled
def extent_of_boxes(boxes: Floats, half: float) -> tuple[float, float, float, float]:
    """Least x and y and largest x and y of the centre boxes (N, 4) with sides of 2 `half` their size.

    All NaN where there is a NaN.
    """
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    for n in range(boxes.shape[0]):
        across, down = boxes[n, 2] * half, boxes[n, 3] * half
        if not np.isfinite(boxes[n, 0] + across) or not np.isfinite(boxes[n, 1] + down):
            bad = boxes[n, 0] + across + boxes[n, 1] + down
            if np.isnan(bad):
                return bad, bad, bad, bad
        left, right = min(left, boxes[n, 0] - across), max(right, boxes[n, 0] + across)
        top, bottom = min(top, boxes[n, 1] - down), max(bottom, boxes[n, 1] + down)
    return left, top, right, bottom


@compiled
def driven(states: Floats, parents: Ancestors, moves: Rows, root: Rows, normals: Floats) -> Floats:
    """As `drifted`, of `states[parents]`, with noise root z added to each chain: `root` (n, n) is triangular.

    A row of `normals` (M, 2 n) has the first z of x, the first of y, the second of x and so on.
    """
    new = np.empty((parents.shape[0], states.shape[1]))
    for m in range(parents.shape[0]):
        _driven(states[parents[m]], moves, root, normals[m], new[m])
    return new


@compiled
def driven_by(
    states: Floats, parents: Ancestors, moves: Rows, root: Rows, rng: np.random.Generator
) -> Floats:
    """`driven` by `rng.standard_normal((M, 2 n))`, bit by bit: faster, but for 30 us to take `rng` over."""
    new = np.empty((parents.shape[0], states.shape[1]))
    normals = np.empty(2 * len(moves))
    for m in range(parents.shape[0]):
        for k in range(normals.shape[0]):
            normals[k] = rng.standard_normal()
        _driven(states[parents[m]], moves, root, normals, new[m])
    return new
