"""Compiled kernels that share detections among rows: the gate, assignment, covers, updates by mixtures.

They follow `adapt.association` in a fixed order of arithmetic that no linear algebra library decides.
"""

from __future__ import annotations

import math

import numpy as np

from bayesnet_track.numerics.arrays import (
    AGENT_UD,
    AREA,
    ESS,
    FIT,
    HYPOTHESES,
    LOG_EVIDENCE,
    MEASURES,
    NATS,
    STRENGTH,
    UD,
    Bools,
    Floats,
    Ints,
)
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.numerics.gaussian import factor
from bayesnet_track.numerics.kernels.row_kernels import correct_row, place_row


@compiled
def gate_rows(
    mean: Floats,
    covariance: Floats,
    boxes: Floats,
    variances: Floats,
    order: Ints,
    starts: Ints,
    ends: Ints,
    limit: float,
    min_overlap: float,
) -> tuple[Ints, Ints, Floats]:
    """Pairs of detections (N, 4) and targets, predicted with (T, D) and (T, D, D), that pass the gate.

    Rows, columns and gains (P,) of the pairs within the gate d^2 <= `limit` that overlap enough: the numbers
    of `adapt.association.gated_gains`. Looked at are the detections `order[starts[t]:ends[t]]`.
    """
    count = mean.shape[0]
    room = 0
    for t in range(count):
        room += ends[t] - starts[t]
    rows, columns, gains = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room)
    spread, lower, innovation = np.empty((4, 4)), np.zeros((4, 4)), np.empty(4)
    pairs = 0
    for t in range(count):
        for place in range(starts[t], ends[t]):
            n = order[place]
            dy = boxes[n, 1] - mean[t, 1]
            if dy * dy > limit * (covariance[t, 1, 1] + variances[n, 1]) * (1.0 + 1e-9):
                continue
            shared, area, other_area = 1.0, 1.0, 1.0
            for k in range(2):
                low = max(mean[t, k] - mean[t, k + 2] / 2, boxes[n, k] - boxes[n, k + 2] / 2)
                high = min(mean[t, k] + mean[t, k + 2] / 2, boxes[n, k] + boxes[n, k + 2] / 2)
                shared *= max(high - low, 0.0)
                area *= mean[t, k + 2]
                other_area *= boxes[n, k + 2]
            union = area + other_area - shared
            if (shared / union if union > 0 else 0.0) < min_overlap:
                continue
            for i in range(4):
                innovation[i] = boxes[n, i] - mean[t, i]
                for j in range(4):
                    spread[i, j] = covariance[t, i, j]
                spread[i, i] += variances[n, i]
            half = factor(spread, lower, 4)
            d2 = 0.0
            for i in range(4):
                value = innovation[i]
                for j in range(i):
                    value -= lower[i, j] * innovation[j]
                innovation[i] = value / lower[i, i]
                d2 += innovation[i] * innovation[i]
            if d2 <= limit:
                rows[pairs], columns[pairs], gains[pairs] = t, n, -0.5 * (d2 + 2.0 * half)
                pairs += 1
    return rows[:pairs].copy(), columns[:pairs].copy(), gains[:pairs].copy()


@compiled
def overlap_rows(
    expected: Floats, boxes: Floats, order: Ints, starts: Ints, ends: Ints
) -> tuple[Ints, Ints, Floats]:
    """Rows, columns and intersections over union (P,) of the boxes (T, 4) and (N, 4) that overlap at all.

    Looked at are the detections `order[starts[t]:ends[t]]`.
    """
    count = expected.shape[0]
    room = 0
    for t in range(count):
        room += ends[t] - starts[t]
    rows, columns, overlaps = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room)
    pairs = 0
    for t in range(count):
        for place in range(starts[t], ends[t]):
            n = order[place]
            shared, area, other_area = 1.0, 1.0, 1.0
            for k in range(2):
                low = max(expected[t, k] - expected[t, k + 2] / 2, boxes[n, k] - boxes[n, k + 2] / 2)
                high = min(expected[t, k] + expected[t, k + 2] / 2, boxes[n, k] + boxes[n, k + 2] / 2)
                shared *= max(high - low, 0.0)
                area *= expected[t, k + 2]
                other_area *= boxes[n, k + 2]
            if shared > 0.0:
                rows[pairs], columns[pairs], overlaps[pairs] = t, n, shared / (area + other_area - shared)
                pairs += 1
    return rows[:pairs].copy(), columns[:pairs].copy(), overlaps[:pairs].copy()


@compiled
def find_group(parents: Ints, member: int) -> int:
    """The number of the group that `member` is in."""
    while parents[member] != member:
        parents[member] = parents[parents[member]]
        member = parents[member]
    return member


@compiled
def settle_pairs(
    rows: Ints, columns: Ints, gains: Floats, count: int, column_count: int
) -> tuple[Ints, Ints]:
    """Assign where it is plain: (T,) columns of the rows or -1, and of each pair (P,) its open group or -1.

    Rows and columns that pairs connect form a group. Where the best columns of all its rows differ, or the
    best rows of all its columns do, these are as many pairs as can be, and the best.
    """
    owner = np.full(count, -1)
    parents = np.arange(count + column_count)
    best_of_row, best_of_column = np.full(count, -1), np.full(column_count, -1)
    for p in range(rows.shape[0]):
        t, n = rows[p], columns[p]
        if best_of_row[t] < 0 or gains[p] > gains[best_of_row[t]]:
            best_of_row[t] = p
        if best_of_column[n] < 0 or gains[p] > gains[best_of_column[n]]:
            best_of_column[n] = p
        first, second = find_group(parents, t), find_group(parents, count + n)
        if first != second:
            parents[second] = first
    taken_columns, taken_rows = np.zeros(column_count, np.bool_), np.zeros(count, np.bool_)
    by_rows, by_columns = np.ones(count + column_count, np.bool_), np.ones(count + column_count, np.bool_)
    for t in range(count):
        if best_of_row[t] >= 0:
            n = columns[best_of_row[t]]
            if taken_columns[n]:
                by_rows[find_group(parents, t)] = False
            taken_columns[n] = True
    for n in range(column_count):
        if best_of_column[n] >= 0:
            t = rows[best_of_column[n]]
            if taken_rows[t]:
                by_columns[find_group(parents, count + n)] = False
            taken_rows[t] = True
    group = np.full(rows.shape[0], -1)
    for p in range(rows.shape[0]):
        root = find_group(parents, rows[p])
        if by_rows[root]:
            if best_of_row[rows[p]] == p:
                owner[rows[p]] = columns[p]
        elif by_columns[root]:
            if best_of_column[columns[p]] == p:
                owner[rows[p]] = columns[p]
        else:
            group[p] = root
    return owner, group


@compiled
def open_groups(
    rows: Ints, columns: Ints, gains: Floats, group: Ints, count: int, column_count: int
) -> tuple[Floats, Ints, Ints, Ints]:
    """The gains of each open group of `settle_pairs` as a matrix, -inf where there is no pair.

    All matrices, one after the other; the rows and the columns of the groups, likewise, in their order; and
    (G + 1, 3) where the matrix, the rows and the columns of a group begin.
    """
    number, group_of, position = (
        np.full(count + column_count, -1),
        np.full(count + column_count, -1),
        np.zeros(count + column_count, np.int64),
    )
    groups = 0
    for p in range(rows.shape[0]):
        if group[p] >= 0:
            if number[group[p]] < 0:
                number[group[p]] = groups
                groups += 1
            group_of[rows[p]] = group_of[count + columns[p]] = number[group[p]]
    sizes, starts = np.zeros((groups, 2), np.int64), np.zeros((groups + 1, 3), np.int64)
    for member in range(count + column_count):
        if group_of[member] >= 0:
            side = 0 if member < count else 1
            position[member] = sizes[group_of[member], side]
            sizes[group_of[member], side] += 1
    for g in range(groups):
        starts[g + 1, 0] = starts[g, 0] + sizes[g, 0] * sizes[g, 1]
        starts[g + 1, 1] = starts[g, 1] + sizes[g, 0]
        starts[g + 1, 2] = starts[g, 2] + sizes[g, 1]
    matrices = np.full(starts[groups, 0], -np.inf)
    own_rows, own_columns = np.empty(starts[groups, 1], np.int64), np.empty(starts[groups, 2], np.int64)
    for member in range(count + column_count):
        g = group_of[member]
        if g >= 0 and member < count:
            own_rows[starts[g, 1] + position[member]] = member
        elif g >= 0:
            own_columns[starts[g, 2] + position[member]] = member - count
    for p in range(rows.shape[0]):
        if group[p] >= 0:
            g = number[group[p]]
            matrices[starts[g, 0] + position[rows[p]] * sizes[g, 1] + position[count + columns[p]]] = gains[p]
    return matrices, own_rows, own_columns, starts


@compiled
def cover_rows(boxes: Floats, existence: Floats, order: Ints, enough: float) -> Floats:
    """(T,) how probable it is that another box covers a box by the share `enough`; less for a smaller share.

    The largest of existence times share / enough over all others, at most 1. `order` sorts the left edges of
    the centre boxes (T, 4).
    """
    count = boxes.shape[0]
    cover = np.zeros(count)
    for place in range(count):
        row = order[place]
        right = boxes[row, 0] + boxes[row, 2] / 2
        for next_place in range(place + 1, count):
            neighbour = order[next_place]
            left = boxes[neighbour, 0] - boxes[neighbour, 2] / 2
            if left >= right:
                break
            low = max(boxes[row, 1] - boxes[row, 3] / 2, boxes[neighbour, 1] - boxes[neighbour, 3] / 2)
            high = min(boxes[row, 1] + boxes[row, 3] / 2, boxes[neighbour, 1] + boxes[neighbour, 3] / 2)
            if high <= low:
                continue
            shared = (min(right, boxes[neighbour, 0] + boxes[neighbour, 2] / 2) - left) * (high - low)
            for first, second in ((row, neighbour), (neighbour, row)):
                share = shared / (boxes[first, 2] * boxes[first, 3])
                cover[first] = max(cover[first], existence[second] * min(share / enough, 1.0))
    return cover


@compiled
def mix_row(
    mean: Floats, covariance: Floats, boxes: Floats, variances: Floats, weights: Floats, missed: float
) -> float:
    """Update a row by detections (K, 4), each its own with `weights` (K,), in place; its log evidence.

    Each gives a Kalman update, `missed` leaves the prediction; mean and covariance are those of the mixture.
    """
    size, count = mean.shape[0], boxes.shape[0]
    work, innovation = np.empty((3, size, size)), np.empty(4)
    means, shares = np.empty((count + 1, size)), np.empty(count + 1)
    spread, updated = np.empty((size, size)), np.empty((size, size))
    shares[count], evidence = missed, missed
    for i in range(size):
        means[count, i] = mean[i]
        for k in range(size):
            spread[i, k] = missed * covariance[i, k]
    for n in range(count):
        shares[n] = weights[n]
        for i in range(size):
            means[n, i] = mean[i]
            for k in range(size):
                updated[i, k] = covariance[i, k]
        for k in range(4):
            innovation[k] = boxes[n, k] - mean[k]
        log = correct_row(means[n], updated, innovation, variances[n], work)
        if count == 1 and missed == 0.0:
            for i in range(size):
                mean[i] = means[0, i]
                for k in range(size):
                    covariance[i, k] = updated[i, k]
            return log
        evidence += weights[n] * math.exp(log)
        for i in range(size):
            for k in range(size):
                spread[i, k] += weights[n] * updated[i, k]
    for i in range(size):
        value = 0.0
        for n in range(count + 1):
            value += shares[n] * means[n, i]
        mean[i] = value
    for i in range(size):
        for k in range(i + 1):
            value = spread[i, k]
            for n in range(count + 1):
                value += shares[n] * (means[n, i] - mean[i]) * (means[n, k] - mean[k])
            covariance[i, k], covariance[k, i] = value, value
    return math.log(evidence)


@compiled
def mix_rows(
    mean: Floats,
    covariance: Floats,
    starts: Ints,
    boxes: Floats,
    variances: Floats,
    weights: Floats,
    missed: Floats,
) -> None:
    """`mix_row` for rows (T, D), (T, D, D): row t by the detections from `starts[t]` to `starts[t + 1]`."""
    for t in range(mean.shape[0]):
        a, b = starts[t], starts[t + 1]
        if b > a:
            mix_row(mean[t], covariance[t], boxes[a:b], variances[a:b], weights[a:b], missed[t])
        mean[t, 2], mean[t, 3] = max(mean[t, 2], 1.0), max(mean[t, 3], 1.0)


@compiled
def measure_and_mix_rows(
    moments: tuple[Floats, Floats],
    starts: Ints,
    boxes: Floats,
    variances: Floats,
    shares: tuple[Floats, Floats],
    samples: Floats,
    limits: tuple[float, float],
    image: Floats,
    counts: Bools,
) -> Floats:
    """Mix as `mix_rows` does, with (T, 10) measures of each row as of `row_kernels.update_rows`.

    `shares` are the weights of the boxes and (T,) `missed`, `limits` the floor of a likelihood and the share
    of its sd below which a field is known from others.
    """
    (mean, covariance), (weights, missed), (floor, least_share) = moments, shares, limits
    count, size = mean.shape
    measures = np.zeros((count, MEASURES))
    lower, remainder, scale = np.zeros((size, size)), np.empty((size, size)), np.empty(size)
    capacity = max(2 * size + 1, samples.shape[1])
    points_at = np.empty((capacity, 4))
    log, prior = np.empty(capacity), np.empty(capacity)
    for t in range(count):
        a, b = starts[t], starts[t + 1]
        points = samples.shape[1]
        if points == 0:
            points = place_row(
                mean[t], covariance[t], image, least_share, (points_at, prior), (lower, remainder, scale)
            )
        else:
            for n in range(points):
                prior[n] = -math.log(points)
                for k in range(4):
                    points_at[n, k] = samples[t, n, k]
        likeliest, top = 0, -np.inf
        for n in range(points):
            likelihood = missed[t] if b > a else 1.0
            for e in range(a, b):
                d2 = 0.0
                for k in range(4):
                    d2 += (points_at[n, k] - boxes[e, k]) ** 2 / variances[e, k]
                likelihood += weights[e] * (floor + (1.0 - floor) * math.exp(-0.5 * d2))
            log[n] = min(math.log(likelihood), 0.0)
            if log[n] > log[likeliest]:
                likeliest = n
            top = max(top, prior[n] + log[n])
        total = 0.0
        for n in range(points):
            total += math.exp(prior[n] + log[n] - top)
        total = top + math.log(total)
        nats, squares = 0.0, 0.0
        for n in range(points):
            weight = math.exp(prior[n] + log[n] - total)
            nats += weight * (log[n] - total)
            squares += weight * weight
            for k in range(4):
                if counts[k]:
                    measures[t, AGENT_UD] += weight * (points_at[n, k] - points_at[likeliest, k]) ** 2
        if b > a:
            measures[t, LOG_EVIDENCE] = mix_row(
                mean[t], covariance[t], boxes[a:b], variances[a:b], weights[a:b], missed[t]
            )
            measures[t, NATS] = measures[t, STRENGTH] = max(nats, 0.0)
            measures[t, FIT] = math.exp(log[likeliest])
        measures[t, ESS], measures[t, HYPOTHESES] = 1.0 / squares, points
        mean[t, 2], mean[t, 3] = max(mean[t, 2], 1.0), max(mean[t, 3], 1.0)
        sides = 1.0
        for k in range(4):
            if counts[k]:
                measures[t, UD] += covariance[t, k, k]
        for k in range(2):
            sides *= min(mean[t, k + 2], 2.0 * image[k])
        measures[t, AREA] = sides
    return measures
