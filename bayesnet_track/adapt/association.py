"""Which detection belongs to whom: nearest pairs of detections and live targets, or candidates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats

Owners = NDArray[np.intp]

COVERED = 0.5
"""Share of the smaller box from which on two boxes are taken for one object, unless said otherwise."""

NOBODY = -1


def distances(a: Floats, b: Floats) -> Floats:
    """(N, K) distances of the centres of boxes (N, 4) and (K, 4), in the mean of both sqrt(w h).

    >>> distances(np.array([[0.0, 0, 4, 4]]), np.array([[3.0, 4, 6, 6]])).tolist()
    [[1.0]]
    """
    away = np.hypot(*(a[:, None, k] - b[None, :, k] for k in (0, 1)))
    side = (_sides(a)[:, None] + _sides(b)[None]) / 2
    return np.asarray(away / side, dtype=np.float64)


def alike(a: Floats, b: Floats, apart: float, covered: float | None = COVERED) -> NDArray[np.bool_]:
    """(N, K) whether boxes (N, 4) and (K, 4) are one object: no farther apart, or so much covered."""
    if covered is None:
        return np.asarray(distances(a, b) <= apart)
    low = np.maximum(a[:, None, :2] - a[:, None, 2:] / 2, b[None, :, :2] - b[None, :, 2:] / 2)
    high = np.minimum(a[:, None, :2] + a[:, None, 2:] / 2, b[None, :, :2] + b[None, :, 2:] / 2)
    shared = np.prod(np.clip(high - low, 0.0, None), axis=2)
    smaller = np.minimum(np.prod(a[:, 2:], axis=1)[:, None], np.prod(b[:, 2:], axis=1)[None])
    return np.asarray((distances(a, b) <= apart) | (shared >= covered * smaller))


def pair_up(cost: Floats, limit: Floats) -> Owners:
    """(N,) column of each row of the costs (N, K) that it is paired with, one to one, or `NOBODY`.

    The cheapest pair of all comes first, then the cheapest of what is left; pairs above `limit`, which
    broadcasts to (N, K), are none. Of equal costs the lower row comes first, then the lower column.
    """
    owner = np.full(len(cost), NOBODY, dtype=np.intp)
    rows, columns = np.nonzero(cost <= limit)
    free = np.ones(cost.shape[1], dtype=bool)
    for k in np.argsort(cost[rows, columns], kind="stable"):
        row, column = rows[k], columns[k]
        if owner[row] == NOBODY and free[column]:
            owner[row], free[column] = column, False
    return owner


def associate(
    detections: Floats, live: Floats, sd_px: Floats, apart: float, covered: float | None = COVERED
) -> tuple[Owners, NDArray[np.bool_]]:
    """Who holds which detection, and which are free.

    Args:
        detections: (N, 4) centre boxes.
        live: (K, 4) estimates of the targets that are not lost.
        sd_px: (K,) root mean square sd of x and y of their beliefs.
        apart: within how many box sides a detection is taken for a target's.
        covered: how much of the smaller box another holds that is taken for the same object; None: no share.

    Returns:
        (N,) the live target that it is given to, one to one, or `NOBODY`; and (N,) True where it is nobody's
        second detection either.
    """
    if len(live) == 0 or len(detections) == 0:
        return np.full(len(detections), NOBODY, dtype=np.intp), np.ones(len(detections), dtype=bool)
    reach = apart + 2.0 * sd_px / _sides(live)
    owner = pair_up(distances(detections, live), np.broadcast_to(reach, (len(detections), len(live))))
    return owner, (owner == NOBODY) & ~alike(detections, live, apart, covered).any(axis=1)


def _sides(boxes: Floats) -> Floats:
    return np.asarray(np.sqrt(boxes[:, 2] * boxes[:, 3]))
