"""Diagonal Gaussians and their mixtures: log-densities, and where a mixture is largest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def log_gaussians(points: Floats, means: Floats, sds: Floats) -> Floats:
    """(M, N) log N(points_m; means_n, diag sds_n^2) of points (M, K), means (N, K), positive sds (N, K).

    K = 0 gives zeros.
    """
    size = points.shape[1]
    result = np.tile(-np.log(sds).sum(axis=1) - 0.5 * size * np.log(2.0 * np.pi), (len(points), 1))
    for k in range(size):
        result -= 0.5 * ((points[:, k, None] - means[None, :, k]) / sds[None, :, k]) ** 2
    return result


def mixture_log_density(points: Floats, log_weights: Floats, means: Floats, sds: Floats) -> Floats:
    """(M,) log sum_n w_n N(points_m; means_n, diag sds_n^2); O(M N)."""
    return np.asarray(np.logaddexp.reduce(log_gaussians(points, means, sds) + log_weights, axis=1))
