"""Compiled kernels of marginal association probabilities: exact by sets, and by belief propagation."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.numerics.kernels.pair_kernels import find_group


@compiled
def order_by(keys: Ints, count: int) -> tuple[Ints, Ints]:
    """Places (E,) in the order of their keys, numbers below `count`, and where each key begins (count + 1,).

    Places of one key keep their order.
    """
    starts = np.zeros(count + 1, np.int64)
    for e in range(keys.shape[0]):
        starts[keys[e] + 1] += 1
    for k in range(count):
        starts[k + 1] += starts[k]
    order, next_of = np.empty(keys.shape[0], np.int64), starts.copy()
    for e in range(keys.shape[0]):
        order[next_of[keys[e]]] = e
        next_of[keys[e]] += 1
    return order, starts


@compiled
def group_pairs(rows: Ints, columns: Ints, count: int, found: int) -> tuple[Ints, Ints]:
    """The pairs (P,) ordered by the connected groups that they form, and where each group begins (G + 1,).

    Groups come in the order of their first pairs, and pairs keep their order within a group.
    """
    parents = np.arange(count + found)
    for p in range(rows.shape[0]):
        parents[find_group(parents, count + columns[p])] = find_group(parents, rows[p])
    group_of, own = np.full(count + found, -1), np.empty(rows.shape[0], np.int64)
    groups = 0
    for p in range(rows.shape[0]):
        one = find_group(parents, rows[p])
        if group_of[one] < 0:
            group_of[one] = groups
            groups += 1
        own[p] = group_of[one]
    return order_by(own, groups)


@compiled
def sum_over_sets(outer: Ints, inner: Ints, weights: Floats, most_outer: int, most_inner: int) -> Floats:
    """Exact marginals (E,) of a group of pairs: all one-to-one choices, by the sets of `inner` taken.

    `outer` and `inner` (E,) number the ends from 0. O(2^most_inner E).
    """
    sets = 1 << most_inner
    ahead, behind = np.zeros((most_outer + 1, sets)), np.ones((most_outer + 1, sets))
    by_outer, starts = order_by(outer, most_outer)
    ahead[0, 0] = 1.0
    for k in range(most_outer):
        for taken in range(sets):
            ahead[k + 1, taken] = ahead[k, taken]
        for at in range(starts[k], starts[k + 1]):
            e = by_outer[at]
            bit = 1 << inner[e]
            for taken in range(sets):
                if taken & bit:
                    ahead[k + 1, taken] += weights[e] * ahead[k, taken ^ bit]
    for k in range(most_outer - 1, -1, -1):
        for taken in range(sets):
            behind[k, taken] = behind[k + 1, taken]
        for at in range(starts[k], starts[k + 1]):
            e = by_outer[at]
            bit = 1 << inner[e]
            for taken in range(sets):
                if not taken & bit:
                    behind[k, taken] += weights[e] * behind[k + 1, taken | bit]
    found = np.zeros(weights.shape[0])
    for e in range(weights.shape[0]):
        k, bit = outer[e], 1 << inner[e]
        for taken in range(sets):
            if not taken & bit:
                found[e] += ahead[k, taken] * behind[k + 1, taken | bit]
        found[e] *= weights[e] / behind[0, 0]
    return found


@compiled
def propagate(rows: Ints, columns: Ints, weights: Floats, sweeps: int, tolerance: float) -> Floats:
    """Marginals (E,) of a group of pairs by loopy sum-product (Williams & Lau 2014). O(sweeps E d).

    d is the largest number of pairs of one row or column. Sums leave one message out by adding up the others,
    because a difference would lose them beside a large one.
    """
    edges = weights.shape[0]
    by_row, row_starts = order_by(rows, rows.max() + 1)
    by_column, column_starts = order_by(columns, columns.max() + 1)
    to_rows, to_columns = np.ones(edges), np.zeros(edges)
    for _ in range(sweeps):
        for at in range(edges):
            e = by_row[at]
            total = 1.0
            for other in range(row_starts[rows[e]], row_starts[rows[e] + 1]):
                if other != at:
                    total += weights[by_row[other]] * to_rows[by_row[other]]
            to_columns[e] = weights[e] / total
        moved = 0.0
        for at in range(edges):
            e = by_column[at]
            total = 1.0
            for other in range(column_starts[columns[e]], column_starts[columns[e] + 1]):
                if other != at:
                    total += to_columns[by_column[other]]
            moved = max(moved, abs(to_rows[e] - 1.0 / total))
            to_rows[e] = 1.0 / total
        if moved <= tolerance:
            break
    found = np.empty(edges)
    for k in range(row_starts.shape[0] - 1):
        total = 1.0
        for at in range(row_starts[k], row_starts[k + 1]):
            total += weights[by_row[at]] * to_rows[by_row[at]]
        for at in range(row_starts[k], row_starts[k + 1]):
            found[by_row[at]] = weights[by_row[at]] * to_rows[by_row[at]] / total
    return found


@compiled
def weigh_pairs(
    rows: Ints,
    columns: Ints,
    weights: Floats,
    count: int,
    found: int,
    most: int,
    sweeps: int,
    tolerance: float,
) -> tuple[Floats, Bools]:
    """The marginals (P,) of all pairs, a group at a time, and whether each is exact.

    A group is exact when one of its sides has at most `most` members.
    """
    order, starts = group_pairs(rows, columns, count, found)
    marginals, is_exact = np.empty(rows.shape[0]), np.ones(rows.shape[0], np.bool_)
    local = np.full(count + found, -1)
    for group in range(starts.shape[0] - 1):
        pairs = order[starts[group] : starts[group + 1]]
        if pairs.shape[0] == 1:
            marginals[pairs[0]] = weights[pairs[0]] / (1.0 + weights[pairs[0]])
            continue
        own_rows, own_columns = np.empty(pairs.shape[0], np.int64), np.empty(pairs.shape[0], np.int64)
        own = np.empty(pairs.shape[0])
        row_count, column_count = 0, 0
        for k in range(pairs.shape[0]):
            t, n = rows[pairs[k]], count + columns[pairs[k]]
            if local[t] < 0:
                local[t] = row_count
                row_count += 1
            if local[n] < 0:
                local[n] = column_count
                column_count += 1
            own_rows[k], own_columns[k], own[k] = local[t], local[n], weights[pairs[k]]
        exact = min(row_count, column_count) <= most
        if exact:
            if row_count < column_count:
                own_rows, own_columns = own_columns, own_rows
            larger, smaller = max(row_count, column_count), min(row_count, column_count)
            own = sum_over_sets(own_rows, own_columns, own, larger, smaller)
        else:
            own = propagate(own_rows, own_columns, own, sweeps, tolerance)
        for k in range(pairs.shape[0]):
            marginals[pairs[k]], is_exact[pairs[k]] = own[k], exact
    return marginals, is_exact
