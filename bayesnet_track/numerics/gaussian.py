"""Gaussians: their roots, samples and quantiles, the linear update of one, and moments of weighted points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bayesnet_track.numerics.arrays import Floats

ALONE = 1e-12
"""A field whose variance is less than this share of it when the fields before are known follows from them."""


@dataclass(frozen=True, eq=False)
class Updated:
    """A Gaussian after a measurement.

    Attributes:
        mean: (D,).
        covariance: (D, D), symmetric.
        d2: squared Mahalanobis distance of the innovation.
        log_likelihood: log of the prior's mean of exp(-e' R^-1 e / 2), e the measurement's error: 0 for a
            measurement of unlimited width. The density of the measurement is this over sqrt(|2 pi R|).
    """

    mean: Floats
    covariance: Floats
    d2: float
    log_likelihood: float


def symmetric(matrix: Floats) -> Floats:
    """(..., D, D) the mean of each matrix and its transpose."""
    return np.asarray(0.5 * (matrix + matrix.swapaxes(-1, -2)))


def root(covariance: Floats) -> Floats:
    """(D, K) A with A A' = covariance, K its rank: Cholesky's, without columns that would be 0.

    The first axis is along the first field and what it predicts of the others, and so on.

    >>> root(np.diag([4.0, 0.0])).tolist()
    [[2.0], [0.0]]
    """
    variances = covariance.diagonal()
    if variances.min(initial=1.0) > 0.0:  # the usual case, in a fifth of the time
        sds = np.sqrt(variances)
        try:
            lower = np.linalg.cholesky(covariance / (sds[:, None] * sds))
        except np.linalg.LinAlgError:
            return roots(covariance[None])[0]
        if lower.diagonal().min(initial=1.0) > math.sqrt(ALONE):
            return np.asarray(lower * sds[:, None])
    return roots(covariance[None])[0]


def roots(covariances: Floats) -> list[Floats]:
    """(T,) arrays (D, K), as `root` of each covariance (T, D, D).

    >>> [lower.shape for lower in roots(np.array([np.eye(2), np.diag([4.0, 0.0])]))]
    [(2, 2), (2, 1)]
    """
    sds = np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0))
    # Of the correlations: px and px per frame may differ by orders of magnitude.
    scale = np.where(sds > 0, sds, 1.0)
    rest = covariances / (scale[:, :, None] * scale[:, None, :])
    columns, kept = np.empty_like(rest), np.empty(sds.shape, dtype=np.bool_)  # (T, K, D), (T, K)
    for k in range(sds.shape[1]):
        has = rest[:, k, k] > ALONE
        by = np.sqrt(np.where(has, rest[:, k, k], np.inf))
        columns[:, k], kept[:, k] = rest[:, :, k] / by[:, None], has
        rest = rest - columns[:, k, :, None] * columns[:, k, None, :]
    columns *= scale[:, None, :]
    return [one[own].T for one, own in zip(columns, kept, strict=True)]


def linear_update(
    mean: Floats, covariance: Floats, innovation: Floats, observe: Floats, noise: Floats
) -> Updated:
    """The Kalman update, covariance in Joseph's form: a sum of squares, so that it stays positive.

    Args:
        mean: (D,) before.
        covariance: (D, D) before.
        innovation: (K,) measured less expected.
        observe: (K, D) H, what is measured of a state.
        noise: (K, K) R of the measurement, positive definite.
    """
    across = covariance @ observe.T
    expected = symmetric(observe @ across + noise)
    gain = np.linalg.solve(expected, across.T).T
    kept = np.eye(len(mean)) - gain @ observe
    d2, log_likelihood = innovation_likelihood(innovation, expected, noise)
    after = symmetric(kept @ covariance @ kept.T + gain @ noise @ gain.T)
    return Updated(mean + gain @ innovation, after, d2, log_likelihood)


def update_by_fields(
    mean: Floats, covariance: Floats, columns: Sequence[int], measured: Floats, variances: Sequence[float]
) -> Updated:
    """`linear_update` by K columns of the state whose errors are independent: one after the other, as exact.

    >>> after = update_by_fields(np.zeros(2), np.diag([1.0, 4.0]), [1], np.array([10.0]), [4.0])
    >>> after.mean.tolist(), after.covariance.tolist(), after.d2
    ([0.0, 5.0], [[1.0, 0.0], [0.0, 2.0]], 12.5)
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.kernels.gaussian_kernels import correct_fields

    at, spread = np.array(mean), np.array(covariance, order="C")
    d2, log_likelihood = correct_fields(at, spread, np.array(columns), plain(measured), np.array(variances))
    return Updated(at, spread, d2, log_likelihood)


def innovation_likelihood(innovation: Floats, expected: Floats, noise: Floats) -> tuple[float, float]:
    """d^2 of an innovation (K,) of covariance S, and log sqrt(|R| / |S|) - d^2 / 2."""
    d2 = float(innovation @ np.linalg.solve(expected, innovation))
    log_ratio = np.linalg.slogdet(noise)[1] - np.linalg.slogdet(expected)[1]
    return d2, 0.5 * float(log_ratio) - 0.5 * d2


# ------------------------------------------------------------------------------------ points


def standard_normals(size: int, width: int, rng: np.random.Generator) -> Floats:
    """(size, width) draws whose mean is 0 and whose covariance (divisor `size`) is the identity exactly.

    Antithetic pairs, so that every odd moment vanishes (an odd `size` has one draw at 0), then whitened.

    Raises:
        ValueError: fewer than 2 (width + 1) draws, which might not span the space.
    """
    if size < 2 * (width + 1):
        raise ValueError(f"{size} draws cannot stand for {width} dimensions; at least {2 * (width + 1)}")
    return whiten(rng.standard_normal((size // 2, width)), size)


def whiten(half: Floats, size: int) -> Floats:
    """(size, K) draws `half` (size // 2, K), their negatives, and 0 for an odd `size`; covariance I."""
    lower = np.linalg.cholesky((half.T @ half) * (2.0 / size))
    white = half @ np.linalg.inv(lower).T
    middle = (np.zeros((1, half.shape[1])),) if size % 2 else ()
    return np.concatenate([white, -white, *middle])


def sigma_points(width: int, scale: float) -> Floats:
    """(2 width + 1, width) the points of the unscented transform: 0 and +-sqrt(scale) on each axis."""
    away = math.sqrt(scale) * np.eye(width)
    return np.concatenate([np.zeros((1, width)), away, -away])


def weighted_moments(points: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """(D,) mean and (D, D) covariance of points (N, D) of weights (N,) that sum to 1."""
    mean = weights @ points
    away = points - mean
    return np.asarray(mean), np.asarray((away * weights[:, None]).T @ away)


# ------------------------------------------------------------------------------------ chi-square


def chi_square_cdf(x: float, degrees: int) -> float:
    """Probability that a chi-square variable of `degrees` of freedom is at most x.

    >>> round(chi_square_cdf(9.2103, 2), 4)
    0.99
    """
    from scipy.special import chdtr  # here, because it takes long to import

    return float(chdtr(degrees, x)) if x > 0 else 0.0


@lru_cache(maxsize=64)
def chi_square_quantile(probability: float, degrees: int) -> float:
    """x below which a chi-square variable of `degrees` of freedom lies with a probability.

    >>> round(chi_square_quantile(0.95, 1), 4)
    3.8415
    """
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(0.5 * degrees, probability))
