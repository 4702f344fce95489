"""Compiled kernels of one Gaussian: points that stand for it, and measurements of some of its fields.

Sums run in a fixed order, so that results do not depend on the linear algebra library or its threads.
"""

from __future__ import annotations

import math

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.numerics.kernels.cholesky_kernels import factor


@compiled
def carry(
    transition: Floats, noise: Floats, mean: Floats, covariance: Floats, moved: Floats, spread: Floats
) -> None:
    """Fill `moved` (D,) with F m and `spread` (D, D) with F P F' + Q, exactly symmetric."""
    width = mean.shape[0]
    across = np.empty((width, width))
    for i in range(width):
        value = 0.0
        for k in range(width):
            value += transition[i, k] * mean[k]
        moved[i] = value
        for j in range(width):
            value = 0.0
            for k in range(width):
                value += transition[i, k] * covariance[k, j]
            across[i, j] = value
    for i in range(width):
        for j in range(width):
            value = 0.0
            for k in range(width):
                value += across[i, k] * transition[j, k]
            spread[i, j] = value + noise[i, j]
    for i in range(width):
        for j in range(i):
            value = 0.5 * (spread[i, j] + spread[j, i])
            spread[i, j], spread[j, i] = value, value


@compiled
def stand_for(
    mean: Floats,
    covariance: Floats,
    half: Floats,
    bounds: tuple[float, float, float],
    unit: Floats,
    filled: tuple[Floats, Floats],
) -> bool:
    """Fill states (N, D) that stand for a Gaussian, by draws `half` (N // 2, D) of N(0, I).

    Their mean and covariance are its own, until centres are moved onto an image of the width and height in
    `bounds` (infinite: they go anywhere), and sizes to 1 px .. twice the image's. `filled` are the Gaussian's
    root (D, D) and the states; `unit` (N, D) is them in units of the root. True where each field keeps more
    than the share of its sd that is last in `bounds` when those before it are known; else all is worthless.
    """
    (lower, states), (across, down, alone) = filled, bounds
    size, width, pairs = unit.shape[0], mean.shape[0], half.shape[0]
    white, room = np.zeros((width, width)), np.empty((width, width))
    for i in range(width):
        unit[size - 1, i] = 0.0  # that of an odd number has no opposite
        for k in range(i + 1, width):
            lower[i, k] = 0.0
        for k in range(i + 1):
            room[i, k] = covariance[i, k] / (math.sqrt(covariance[i, i]) * math.sqrt(covariance[k, k]))
    factor(room, lower, width)
    is_full = True
    for i in range(width):
        is_full = is_full and lower[i, i] > alone  # not where it is NaN
        for k in range(i + 1):
            lower[i, k] *= math.sqrt(covariance[i, i])
            value = 0.0
            for n in range(pairs):
                value += half[n, i] * half[n, k]
            room[i, k] = 2.0 * value / size
    factor(room, white, width)
    for n in range(pairs):
        for i in range(width):
            value = half[n, i]
            for k in range(i):
                value -= white[i, k] * unit[n, k]
            unit[n, i] = value / white[i, i]
            unit[pairs + n, i] = -unit[n, i]
    for n in range(size):
        for i in range(width):
            value = mean[i]
            for k in range(i + 1):
                value += unit[n, k] * lower[i, k]
            states[n, i] = value
        for i in range(4):
            extent = down if i % 2 else across
            least = 0.0 if extent < np.inf else -np.inf
            low, high = (least, extent - 1.0) if i < 2 else (1.0, 2.0 * extent)
            if states[n, i] < low:
                states[n, i] = low
            elif states[n, i] > high:
                states[n, i] = high
    return is_full


@compiled
def correct_fields(
    mean: Floats, covariance: Floats, columns: Ints, measured: Floats, variances: Floats
) -> tuple[float, float]:
    """Update the mean (D,) and covariance (D, D) in place by K columns whose errors are independent.

    They are taken one after the other. Squared Mahalanobis distance of all, and their log-likelihood, as
    `numerics.gaussian.linear_update` has them.
    """
    size, own, d2, log_ratio = mean.shape[0], np.empty(mean.shape[0]), 0.0, 0.0
    for i in range(columns.shape[0]):
        k = columns[i]
        expected = covariance[k, k] + variances[i]
        innovation, kept = measured[i] - mean[k], variances[i] / expected
        for a in range(size):
            own[a] = covariance[a, k]
        for a in range(size):
            gain = own[a] / expected
            mean[a] += gain * innovation
            for b in range(a + 1):
                # Of the field itself without the difference, which would round most there.
                value = kept * own[a + b - k] if a == k or b == k else covariance[a, b] - gain * own[b]
                covariance[a, b], covariance[b, a] = value, value
        d2 += innovation * innovation / expected
        log_ratio += math.log(kept)
    return d2, 0.5 * log_ratio - 0.5 * d2


@compiled
def independent_log(away: Floats, variances: Floats, most: float, log: Floats) -> None:
    """Fill `log` (N,) with -d^2 / 2 of errors (N, K) of the variances (K,), each at most sqrt(`most`) sds."""
    for n in range(away.shape[0]):
        d2 = 0.0
        for k in range(away.shape[1]):
            sds = away[n, k] / math.sqrt(variances[k])
            square = sds * sds
            d2 += square if square < most else most  # also where it is NaN
        log[n] = -0.5 * d2
