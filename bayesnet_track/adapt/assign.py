"""Whose is which detection: the assignment that is best for all targets together, each pair gated."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.association import NOBODY, Owners
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import overlap
from bayesnet_track.numerics.gaussian import chi_square_quantile
from bayesnet_track.observation.cue import AssociationRule


def gated_gains(
    mean: Floats,
    covariance: Floats,
    boxes: Floats,
    rule: AssociationRule,
    log_looks: Callable[[Floats], Floats],
) -> Floats:
    """(N,) log of what speaks for detections z (N, 4) to be a target's: N(z; m, P + R) L(z)^appearance.

    m (4,) and P (4, 4) are the prediction of its centre box, R the detection's own error, log L(z) what
    `log_looks` gives for boxes (M, 4), at most 0, asked only of those near enough. Constants are left
    out. Unlike the distance alone, the density makes it expensive for an unsure target to take what a
    sure one expects. It is -inf beyond the gates: d^2 - 2 appearance log L above the chi-square quantile of
    `gate`, or too small an overlap.
    """
    away = boxes - mean
    spread = covariance + rule.variances(boxes)[:, :, None] * np.eye(4)
    d2 = np.einsum("ni,ni->n", away, np.linalg.solve(spread, away[:, :, None])[:, :, 0])
    limit = chi_square_quantile(rule.gate, 4)
    near = (d2 <= limit) & (overlap(boxes, mean) >= rule.min_overlap)
    if rule.appearance > 0 and near.any():
        d2[near] -= 2.0 * rule.appearance * log_looks(boxes[near])
    return np.where(near & (d2 <= limit), -0.5 * (d2 + np.linalg.slogdet(spread)[1]), -np.inf)


def assign(gain: Floats) -> Owners:
    """(N,) column of each row of gains (N, K), one to one, or `NOBODY`.

    As many pairs as can be, and of those the largest sum of gains; -inf forbids a pair. O(N^2 K).

    >>> assign(np.array([[0.0, -1.0], [-0.5, -9.0]])).tolist()
    [1, 0]
    """
    owner = np.full(len(gain), NOBODY, dtype=np.intp)
    allowed = gain > -np.inf
    rows, columns = np.flatnonzero(allowed.any(axis=1)), np.flatnonzero(allowed.any(axis=0))
    if not len(rows):
        return owner
    from scipy.optimize import linear_sum_assignment  # here, because it takes long to import

    costs, possible = -gain[np.ix_(rows, columns)], allowed[np.ix_(rows, columns)]
    low, high = float(costs[possible].min()), float(costs[possible].max())
    # More expensive than any pairs that could be had instead.
    forbidden = (high - low + 1.0) * (min(costs.shape) + 1)
    costs = np.where(possible, costs - low, forbidden)
    for row, column in zip(*linear_sum_assignment(costs), strict=True):
        if possible[row, column]:
            owner[rows[row]] = columns[column]
    return owner


def assign_total(gain: Floats, is_pair: NDArray[np.bool_]) -> Owners:
    """(N,) column of each row of gains (N, K), one to one, or `NOBODY`: the largest sum of all gains.

    What is not a pair is rejected after the assignment, in which all gains count, as SORT has it (Bewley et
    al. 2016): a row may stay alone though another could have been its own.

    >>> assign_total(np.array([[0.9, 0.5], [0.8, 0.0]]), np.array([[True, True], [True, False]])).tolist()
    [1, 0]
    """
    from scipy.optimize import linear_sum_assignment  # here, because it takes long to import

    owner = np.full(len(gain), NOBODY, dtype=np.intp)
    rows, columns = linear_sum_assignment(gain, maximize=True)
    kept = is_pair[rows, columns]
    owner[rows[kept]] = columns[kept]
    return owner


def assign_total_pairs(
    rows: Owners, columns: Owners, gains: Floats, count: int, found: int, least: float
) -> Owners:
    """As `assign_total`, of the pairs (P,) whose gains are above 0; those below `least` are rejected."""

    def by_total(gain: Floats) -> Owners:
        return assign_total(np.maximum(gain, 0.0), gain >= least)

    owner = assign_pairs(rows, columns, gains, count, found, by_total)
    kept = np.zeros(count, dtype=np.bool_)
    kept[rows[(owner[rows] == columns) & (gains >= least)]] = True
    return np.where(kept, owner, NOBODY)


def assign_pairs(
    rows: Owners,
    columns: Owners,
    gains: Floats,
    count: int,
    found: int,
    assign_group: Callable[[Floats], Owners] = assign,
) -> Owners:
    """As `assign`, of the pairs (P,) that are not forbidden, out of `count` rows and `found` columns.

    Rows and columns that no pairs connect do not concern each other: each connected group is assigned alone,
    and those in which nobody wants what another wants are plain.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.pair_kernels import open_groups, settle_pairs

    rows, columns = np.ascontiguousarray(rows), np.ascontiguousarray(columns)  # one compiled version only
    owner, group = settle_pairs(rows, columns, gains, count, found)
    matrices, all_rows, all_columns, starts = open_groups(rows, columns, gains, group, count, found)
    for (a, r, c), (b, s, d) in pairwise(starts.tolist()):
        own_rows, own_columns = all_rows[r:s], all_columns[c:d]
        chosen = assign_group(matrices[a:b].reshape(s - r, d - c))
        is_given = chosen != NOBODY
        owner[own_rows[is_given]] = own_columns[chosen[is_given]]
    return np.asarray(owner)
