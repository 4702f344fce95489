"""Compiled kernel of one Gaussian: points that stand for it.

Sums run in a fixed order, so that results do not depend on the linear algebra library or its threads.
"""

from __future__ import annotations

import math

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.numerics.kernels.cholesky_kernels import factor


@compiled
def stand_for(
    mean: Floats, covariance: Floats, half: Floats, size: int, image: tuple[float, float], alone: float
) -> tuple[Floats, Floats, Floats, bool]:
    """States (size, D) that stand for a Gaussian, by draws `half` (size // 2, D) of N(0, I).

    Their mean and covariance are its own, until centres are moved onto an image (width, height; infinite:
    they go anywhere), and sizes to 1 px .. twice the image's. Before them come its root (D, D) and the states
    in units of it (size, D); after them, whether each field keeps more than the share `alone` of its sd when
    those before it are known. Else all the others are worthless.
    """
    width, pairs = mean.shape[0], half.shape[0]
    lower, white = np.zeros((width, width)), np.zeros((width, width))
    unit, states, room = np.zeros((size, width)), np.empty((size, width)), np.empty((width, width))
    for i in range(width):
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
            extent = image[i % 2]
            least = 0.0 if extent < np.inf else -np.inf
            low, high = (least, extent - 1.0) if i < 2 else (1.0, 2.0 * extent)
            if states[n, i] < low:
                states[n, i] = low
            elif states[n, i] > high:
                states[n, i] = high
    return lower, unit, states, is_full
