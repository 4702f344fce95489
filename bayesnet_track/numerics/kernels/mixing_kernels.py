"""Compiled kernels for rows that several detections may belong to: covers, and updates by mixtures."""

from __future__ import annotations

import math

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.numerics.gaussian import root_of
from bayesnet_track.numerics.kernels.row_kernels import correct_row


@compiled
def cover_rows(boxes: Floats, existence: Floats, order: Ints, enough: float) -> Floats:
    """(T,) how probable it is that another box covers a box by the share `enough`; less for a smaller share.

    The largest of existence times share / enough over all others, at most 1. `order` sorts the left edges of
    the centre boxes (T, 4).
    """
    count = boxes.shape[0]
    cover = np.zeros(count)
    for at in range(count):
        one = order[at]
        right = boxes[one, 0] + boxes[one, 2] / 2
        for after in range(at + 1, count):
            other = order[after]
            left = boxes[other, 0] - boxes[other, 2] / 2
            if left >= right:
                break
            low = max(boxes[one, 1] - boxes[one, 3] / 2, boxes[other, 1] - boxes[other, 3] / 2)
            high = min(boxes[one, 1] + boxes[one, 3] / 2, boxes[other, 1] + boxes[other, 3] / 2)
            if high <= low:
                continue
            shared = (min(right, boxes[other, 0] + boxes[other, 2] / 2) - left) * (high - low)
            for first, second in ((one, other), (other, one)):
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
    size, several = mean.shape[0], boxes.shape[0]
    work, away = np.empty((3, size, size)), np.empty(4)
    means, shares = np.empty((several + 1, size)), np.empty(several + 1)
    spread, own = np.empty((size, size)), np.empty((size, size))
    shares[several], evidence = missed, missed
    for i in range(size):
        means[several, i] = mean[i]
        for k in range(size):
            spread[i, k] = missed * covariance[i, k]
    for n in range(several):
        shares[n] = weights[n]
        for i in range(size):
            means[n, i] = mean[i]
            for k in range(size):
                own[i, k] = covariance[i, k]
        for k in range(4):
            away[k] = boxes[n, k] - mean[k]
        log = correct_row(means[n], own, away, variances[n], work)
        if several == 1 and missed == 0.0:
            for i in range(size):
                mean[i] = means[0, i]
                for k in range(size):
                    covariance[i, k] = own[i, k]
            return log
        evidence += weights[n] * math.exp(log)
        for i in range(size):
            for k in range(size):
                spread[i, k] += weights[n] * own[i, k]
    for i in range(size):
        value = 0.0
        for n in range(several + 1):
            value += shares[n] * means[n, i]
        mean[i] = value
    for i in range(size):
        for k in range(i + 1):
            value = spread[i, k]
            for n in range(several + 1):
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
    mean: Floats,
    covariance: Floats,
    starts: Ints,
    boxes: Floats,
    variances: Floats,
    weights: Floats,
    missed: Floats,
    floor: float,
    image: Floats,
    counts: Bools,
    alone: float,
) -> Floats:
    """As `mix_rows`, with (T, 8) of each row as `row_kernels.update_rows` has them."""
    count, size = mean.shape
    found = np.zeros((count, 8))
    lower, rest, scale = np.zeros((size, size)), np.empty((size, size)), np.empty(size)
    points_at = np.empty((2 * size + 1, 4))
    log, prior = np.empty(2 * size + 1), np.empty(2 * size + 1)
    for t in range(count):
        a, b = starts[t], starts[t + 1]
        width = root_of(covariance[t], lower, rest, scale, alone)
        points = 2 * width + 1
        far = math.sqrt(width + 1.0)
        log_first, log_other = -math.log(width + 1.0), -math.log(2.0 * (width + 1.0))
        best, top = 0, -np.inf
        for n in range(points):
            prior[n] = log_first if n == 0 else log_other
            for k in range(4):
                value = mean[t, k]
                if n > 0:
                    step = far * lower[k, (n - 1) % width]
                    value = value + step if n <= width else value - step
                extent = image[k % 2]
                low, high = (0.0, extent - 1.0) if k < 2 else (1.0, 2.0 * extent)
                points_at[n, k] = min(max(value, low), high)
            likelihood = missed[t] if b > a else 1.0
            for e in range(a, b):
                d2 = 0.0
                for k in range(4):
                    d2 += (points_at[n, k] - boxes[e, k]) ** 2 / variances[e, k]
                likelihood += weights[e] * (floor + (1.0 - floor) * math.exp(-0.5 * d2))
            log[n] = min(math.log(likelihood), 0.0)
            if log[n] > log[best]:
                best = n
            top = max(top, prior[n] + log[n])
        # The covariance as its root has it, as where agents' likelihoods are fitted.
        for i in range(size):
            for k in range(i + 1):
                value = 0.0
                for j in range(width):
                    value += lower[i, j] * lower[k, j]
                covariance[t, i, k], covariance[t, k, i] = value, value
        total = 0.0
        for n in range(points):
            total += math.exp(prior[n] + log[n] - top)
        total = top + math.log(total)
        moved, squares = 0.0, 0.0
        for n in range(points):
            weight = math.exp(prior[n] + log[n] - total)
            moved += weight * (log[n] - total)
            squares += weight * weight
            for k in range(4):
                if counts[k]:
                    found[t, 4] += weight * (points_at[n, k] - points_at[best, k]) ** 2
        if b > a:
            found[t, 0] = mix_row(mean[t], covariance[t], boxes[a:b], variances[a:b], weights[a:b], missed[t])
            found[t, 1] = max(moved, 0.0)
            found[t, 6] = math.exp(log[best])
        found[t, 2], found[t, 3] = 1.0 / squares, points
        mean[t, 2], mean[t, 3] = max(mean[t, 2], 1.0), max(mean[t, 3], 1.0)
        sides = 1.0
        for k in range(4):
            if counts[k]:
                found[t, 5] += covariance[t, k, k]
        for k in range(2):
            sides *= min(mean[t, k + 2], 2.0 * image[k])
        found[t, 7] = sides
    return found
