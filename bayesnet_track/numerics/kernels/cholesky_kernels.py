"""Compiled kernels: factors of covariances, in a fixed order of arithmetic."""

from __future__ import annotations

import math

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled


@compiled
def factor(matrix: Floats, lower: Floats, size: int) -> float:
    """Fill `lower` with Cholesky's factor of the first `size` rows and columns; half the log determinant."""
    half = 0.0
    for j in range(size):
        for i in range(j, size):
            value = matrix[i, j]
            for k in range(j):
                value -= lower[i, k] * lower[j, k]
            if i == j:
                lower[j, j] = math.sqrt(max(value, 1e-300))
                half += math.log(lower[j, j])
            else:
                lower[i, j] = value / lower[j, j]
    return half


@compiled
def root_of(covariance: Floats, lower: Floats, rest: Floats, scale: Floats, alone: float) -> int:
    """Fill `lower` (D, K) as `numerics.gaussian.root` does; K."""
    size = covariance.shape[0]
    along = np.empty(size)  # a column of `lower`, its values one apart in memory
    for i in range(size):
        sd = math.sqrt(max(covariance[i, i], 0.0))
        scale[i] = sd if sd > 0 else 1.0
    for i in range(size):
        for j in range(size):
            rest[i, j] = covariance[i, j] / (scale[i] * scale[j])
    width = 0
    for k in range(size):
        if rest[k, k] > alone:
            by = math.sqrt(rest[k, k])
            for i in range(size):
                along[i] = rest[i, k] / by
                lower[i, width] = along[i]
            for i in range(size):
                for j in range(size):
                    rest[i, j] -= along[i] * along[j]
            width += 1
    for i in range(size):
        for k in range(width):
            lower[i, k] *= scale[i]
    return width
