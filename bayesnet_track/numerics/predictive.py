"""How probable a measurement as far off as this one was: p-values under a mixture of Gaussians."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats

DIGITS = 6
"""Decimals of a p-value."""


def p_value(value: Floats, weights: Floats, means: Floats, covariances: Floats) -> float:
    """Probability that a draw lies farther out than `value` (K,), 0 to 1; uniform where it is a draw.

    Of one Gaussian, far out means a large Mahalanobis distance. Of a mixture, fields are taken one after the
    other: u_k = P(draw_k <= value_k | draw_1..k-1 = value_1..k-1) are uniform and independent (Rosenblatt
    1952). The sum of their squared normal quantiles takes the place of the squared distance, which it is of
    one Gaussian.

    Args:
        value: (K,).
        weights: (N,) of the components, which sum to 1.
        means: (N, K).
        covariances: (N, K, K), or (1, K, K) of all.
    """
    from scipy.special import chdtrc, ndtr, ndtri  # here, because it takes long to import

    lower = np.linalg.cholesky(covariances)
    away = np.linalg.solve(lower, (value - means)[..., None])[..., 0]
    if len(means) == 1:
        return round(float(chdtrc(len(value), away[0] @ away[0])), DIGITS)
    squared, log = 0.0, np.log(np.maximum(weights, 1e-300))
    for k in range(len(value)):
        shares = np.exp(log - log.max())
        shares /= shares.sum()
        below, above = float(shares @ ndtr(away[:, k])), float(shares @ ndtr(-away[:, k]))
        squared += float(ndtri(max(min(below, above), 1e-300))) ** 2
        log = log - 0.5 * away[:, k] ** 2 - np.log(lower[:, k, k])
    return round(float(chdtrc(len(value), squared)), DIGITS)


def p_after(value: Floats, noise: Floats, mean: Floats, covariance: Floats) -> float:
    """As `p_value`, from the Gaussian of the measured fields after a Kalman update by `value` alone.

    With r = value - mean, d^2 = r' (R - P)^-1 r is the squared distance of the innovation before the update.

    Args:
        value: (K,).
        noise: (K, K) R.
        mean: (K,) after.
        covariance: (K, K) P, after.
    """
    from scipy.special import chdtrc

    residual = value - mean
    d2 = residual @ np.linalg.solve(noise - covariance, residual)
    return round(float(chdtrc(len(value), max(float(d2), 0.0))), DIGITS)
