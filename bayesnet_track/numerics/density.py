"""Mixtures of diagonal Gaussians: log-density, and where among many points a weighted mixture is largest."""

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


@np.errstate(divide="ignore")  # a density may be 0 in floating point
def mixture_argmax(
    log_factors: Floats, points: Floats, log_weights: Floats, means: Floats, sds: Floats
) -> int:
    """argmax_m of log_factors_m + `mixture_log_density`_m, the first of equals; exact, seldom O(M N).

    A likely winner sets the value to beat. Points that cannot reach it, by an upper bound of the mixture,
    are given up; sums of a known error give up nearly all that are left; the last few are summed exactly.

    Args:
        log_factors: (M,) finite or -inf.
        points: (M, K).
        log_weights: (N,) -inf for a weight of zero.
        means: (N, K) of the components.
        sds: (N, K), positive.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.density_kernels import FAST_ERROR, exact_sums, fast_sums

    # Constant factors do not move the maximum; the largest peak becomes 1, so that sums stay finite.
    log_peaks = log_weights - np.log(sds).sum(axis=1)
    log_peaks -= log_peaks.max()
    if points.shape[1] % 2:  # the kernels take an even number of dimensions
        points, means = (np.pad(array, ((0, 0), (0, 1))) for array in (points, means))
        sds = np.pad(sds, ((0, 0), (0, 1)), constant_values=1.0)
    peaks, precisions = np.exp(log_peaks), 1.0 / sds

    def exactly(chosen: NDArray[np.int64]) -> Floats:
        return np.asarray(log_factors[chosen] + np.log(exact_sums(points[chosen], peaks, means, precisions)))

    # The likely winner if the mixture were one Gaussian.
    centre = peaks @ means / peaks.sum()
    spread = peaks @ ((means - centre) ** 2 + sds**2) / peaks.sum()
    guess = log_factors - 0.5 * np.sum((points - centre) ** 2 / spread, axis=1)
    beat = float(exactly(np.argmax(guess, keepdims=True))[0])

    chosen = np.flatnonzero(log_factors + np.log(peaks.sum()) >= beat - 1e-9)
    # The heaviest components alone give up most points; the peaks of the others bound what they add.
    for least in (0.1, FAST_ERROR / len(peaks)):
        heavy = peaks > least
        rows = np.ascontiguousarray(points[chosen].T)
        sums = fast_sums(rows, peaks[heavy], means[heavy], precisions[heavy])
        error = peaks.sum() * FAST_ERROR
        upper = sums + error + peaks[~heavy].sum()
        lower = np.log(np.maximum(sums - error, 0.0))
        beat = max(beat, float(np.max(log_factors[chosen] + lower)))
        chosen = chosen[log_factors[chosen] + np.log(upper) >= beat - 1e-9]
    values = exactly(chosen)
    best = int(np.argmax(values))
    if values[best] > -np.inf:
        return int(chosen[best])
    # Every point is so far from every component that all densities are 0 in floating point.
    return int(np.argmax(log_factors + mixture_log_density(points, log_weights, means, sds)))
