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


def p_after(values: Floats, noises: Floats, means: Floats, covariances: Floats) -> Floats:
    """(T,) as `p_value`, from the Gaussians of the measured fields after Kalman updates by one value each.

    With r = value - mean, d^2 = r' (R - P)^-1 r is the squared distance of the innovation before the update.

    Args:
        values: (T, K).
        noises: (T, K, K) R.
        means: (T, K) after.
        covariances: (T, K, K) P, after.
    """
    from scipy.special import chdtrc

    residual = values - means
    d2 = np.einsum("tk,tk->t", residual, np.linalg.solve(noises - covariances, residual[..., None])[..., 0])
    return np.asarray(np.round(chdtrc(values.shape[1], np.maximum(d2, 0.0)), DIGITS))
