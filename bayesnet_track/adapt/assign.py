"""Whose is which detection: the assignment that is best for all targets together, each pair gated."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.claims import NOBODY, Owners
from bayesnet_track.numerics.boxes import overlap
from bayesnet_track.numerics.gaussian import chi_square_quantile
from bayesnet_track.observation.cue import ClaimRule

Floats = NDArray[np.float64]


def gains(
    mean: Floats, covariance: Floats, boxes: Floats, rule: ClaimRule, log_looks: Callable[[Floats], Floats]
) -> Floats:
    """(N,) log of what speaks for detections z (N, 4) to be a target's: N(z; m, P + R) L(z)^looks.

    m (4,) and P (4, 4) are the prediction of its centre box, R the detection's own error, log L(z) what
    `log_looks` gives for boxes (M, 4), at most 0, asked only of those near enough. Constants are left
    out. Unlike the distance alone, the density makes it dear for an unsure target to take what a sure one
    expects. It is -inf beyond the gates: d^2 - 2 looks log L above the chi-square quantile of `gate`, or too
    small an overlap.
    """
    away = boxes - mean
    spread = covariance + rule.variances(boxes)[:, :, None] * np.eye(4)
    d2 = np.einsum("ni,ni->n", away, np.linalg.solve(spread, away[:, :, None])[:, :, 0])
    limit = chi_square_quantile(rule.gate, 4)
    near = (d2 <= limit) & (overlap(boxes, mean) >= rule.least_overlap)
    if rule.looks > 0 and near.any():
        d2[near] -= 2.0 * rule.looks * log_looks(boxes[near])
    return np.where(near & (d2 <= limit), -0.5 * (d2 + np.linalg.slogdet(spread)[1]), -np.inf)


def assign(gain: Floats) -> Owners:
    """(N,) column of each row of gains (N, K), one to one, or `NOBODY`.

    As many pairs as can be, and of those the largest sum of gains; -inf forbids a pair. By shortest
    augmenting paths (Jonker and Volgenant 1987), O(N^2 K).

    >>> assign(np.array([[0.0, -1.0], [-0.5, -9.0]])).tolist()
    [1, 0]
    """
    owner = np.full(len(gain), NOBODY, dtype=np.intp)
    allowed = gain > -np.inf
    rows, columns = np.flatnonzero(allowed.any(axis=1)), np.flatnonzero(allowed.any(axis=0))
    if not len(rows):
        return owner
    costs, possible = -gain[np.ix_(rows, columns)], allowed[np.ix_(rows, columns)]
    low, high = float(costs[possible].min()), float(costs[possible].max())
    # Dearer than any pairs that could be had instead.
    dear = (high - low + 1.0) * (min(costs.shape) + 1)
    costs = np.where(possible, costs - low, dear)
    if costs.shape[0] > costs.shape[1]:
        of_columns = _cheapest(costs.T)
        pairs = zip(of_columns, range(len(of_columns)), strict=True)
    else:
        of_rows = _cheapest(costs)
        pairs = zip(range(len(of_rows)), of_rows, strict=True)
    for row, column in pairs:
        if possible[row, column]:
            owner[rows[row]] = columns[column]
    return owner


def _cheapest(costs: Floats) -> Owners:
    """(N,) column of each row of finite costs (N, K), N <= K: the smallest sum."""
    count, width = costs.shape
    above, beside = np.zeros(count), np.zeros(width)  # dual prices of rows and columns
    row_of = np.full(width, NOBODY, dtype=np.intp)
    for first in range(count):
        # Dijkstra over columns, from a row without one to the nearest column without a row.
        distance, came_from = np.full(width, np.inf), np.full(width, NOBODY, dtype=np.intp)
        done = np.zeros(width, dtype=bool)
        row, column, reached = first, NOBODY, 0.0
        while True:
            through = reached + costs[row] - above[row] - beside
            nearer = ~done & (through < distance)
            distance[nearer], came_from[nearer] = through[nearer], column
            column = int(np.argmin(np.where(done, np.inf, distance)))
            reached = float(distance[column])
            done[column] = True
            if row_of[column] == NOBODY:
                break
            row = int(row_of[column])
        passed = np.flatnonzero(done & (row_of != NOBODY))
        above[row_of[passed]] += reached - distance[passed]
        above[first] += reached
        beside[done] -= reached - distance[done]
        while column != NOBODY:
            before = int(came_from[column])
            row_of[column] = first if before == NOBODY else row_of[before]
            column = before
    found = np.full(count, NOBODY, dtype=np.intp)
    taken = np.flatnonzero(row_of != NOBODY)
    found[row_of[taken]] = taken
    return found
