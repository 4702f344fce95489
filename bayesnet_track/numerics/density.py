"""Mixtures of diagonal Gaussians: log-density, and where among many points a weighted mixture is largest."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats


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


def mixture_argmax(
    log_factors: Floats, points: Floats, log_weights: Floats, means: Floats, sds: Floats
) -> int:
    """argmax_m of log_factors_m + `mixture_log_density`_m, the first of equals; exact, seldom O(M N).

    Args:
        log_factors: (M,) finite or -inf.
        points: (M, K).
        log_weights: (N,) -inf for a weight of zero.
        means: (N, K) of the components.
        sds: (N, K), positive.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.kernels.density_kernels import likeliest

    # One compiled version only: writable and in C order.
    arrays = (log_factors, points, log_weights, means, 1.0 / sds)
    best = int(likeliest(*(plain(array) for array in arrays)))
    if best >= 0:
        return best
    # Every point is so far from every component that all densities are 0 in floating point.
    return int(np.argmax(log_factors + mixture_log_density(points, log_weights, means, sds)))
