"""How many hypotheses a posterior needs: bounds on the error of its histogram or of its mean (thesis 5.4).

The weights w of N hypotheses x_i need no scale: every formula is in a form that stays the same when all of
them are multiplied by a number. E = sum w x / sum w is the mean of the posterior. What is returned is a real
number of hypotheses: not rounded, not kept in bounds, 0 where a formula asks for none.
"""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from bayesnet_track.numerics.arrays import Floats

NEGLIGIBLE = 1e-5
"""A bin counts when it holds at least this share of a hypothesis' average weight."""


def normal_quantile(probability: float) -> float:
    """The standard normal quantile.

    >>> round(normal_quantile(0.95), 3)
    1.645
    """
    return NormalDist().inv_cdf(probability)


def wilson_hilferty_quantile(probability: float, degrees: float) -> float:
    """The approximate chi-square quantile of at least one degree of freedom, whole or not.

    d (1 - a + z sqrt(a))^3 with a = 2 / (9 d) and z the normal quantile. Within 0.05 of the exact
    one (`gaussian.chi_square_quantile`, of whole degrees) for probabilities from .9 to .99 and three
    degrees or more; 0.1 below it at one degree and .95.

    >>> round(wilson_hilferty_quantile(0.95, 72), 1)
    92.8
    """
    a = 2.0 / (9.0 * degrees)
    return degrees * (1.0 - a + math.sqrt(a) * normal_quantile(probability)) ** 3


def occupied_bins(values: Floats, weights: Floats, width: float) -> int:
    """The number k of bins of a width that hold weight worth counting.

    A bin counts when it holds more than `NEGLIGIBLE` of the hypotheses' average weight. Bins begin at
    multiples of the width. 0 when there is no weight.

    Args:
        values: (N,) of one field.
        weights: (N,) not negative.
        width: of a bin, in the unit of the field.

    >>> occupied_bins(np.array([0.1, 0.9, 1.1, 7.0]), np.array([1.0, 1.0, 2.0, 0.0]), 1.0)
    2
    """
    _, which = np.unique(np.floor(values / width), return_inverse=True)
    return int(np.count_nonzero(np.bincount(which, weights) > NEGLIGIBLE * weights.mean()))


def kld(bins: float, error: float, confidence: float) -> float:
    """KLD-sampling: N = chi2(k - 1; confidence) / (2 error), thesis eq. 5.6.

    Keeps the KL divergence of the estimate from the posterior, both in bins, below the error (nats) with
    the confidence, if hypotheses came from the posterior itself. 0 for k <= 1, where the bound is undefined:
    one bin says nothing that a sample could get wrong.

    >>> round(kld(72, 0.01, 0.95)), kld(1, 0.01, 0.95)
    (4583, 0.0)
    """
    return wilson_hilferty_quantile(confidence, bins - 1) / (2.0 * error) if bins > 1 else 0.0


def variance(values: Floats, weights: Floats) -> float:
    """Var_p = sum w (x - E)^2 / sum w, thesis eq. 5.11."""
    return float(weights @ _from_mean(values, weights) ** 2 / weights.sum())


def importance_variance(values: Floats, weights: Floats) -> float:
    """sigma^2_IS = N sum w^2 (x - E)^2 / (sum w)^2: N times the variance of the estimated mean.

    Thesis eqs. 5.8 and 5.11, corrected to a form in which the scale of the weights drops out.
    """
    away = _from_mean(values, weights)
    return float(len(values) * np.sum((weights * away) ** 2) / weights.sum() ** 2)


def _from_mean(values: Floats, weights: Floats) -> Floats:
    # Taken from the first one before the mean is, so that values that do not vary leave exact zeros.
    values = values - values[0]
    return np.asarray(values - weights @ values / weights.sum())


def inflation(values: Floats, weights: Floats) -> float:
    """sigma^2_IS / Var_p: hypotheses that are worth one drawn from the posterior, thesis eq. 5.9.

    0 when the values do not vary: there is no mean to be estimated. It may be below 1.
    """
    spread = variance(values, weights)
    return importance_variance(values, weights) / spread if spread > 0 else 0.0


def simple_inflation(weights: Floats) -> float:
    """N sum w^2 / (sum w)^2 = N / ESS: `inflation` if weights did not depend on values, eq. 5.13, corrected.

    >>> simple_inflation(np.array([3.0, 3.0])), simple_inflation(np.array([5.0, 0.0]))
    (1.0, 2.0)
    """
    return float(len(weights) * (weights @ weights) / weights.sum() ** 2)


def kld_revised(bins: float, error: float, confidence: float, worth: float) -> float:
    """KLD-sampling for hypotheses from an importance function: `worth` times `kld`, thesis eq. 5.10.

    With `inflation` as the worth it is eq. 5.10, with `simple_inflation` eq. 5.14.
    """
    return worth * kld(bins, error, confidence)


def asymptotic_normal(spread: float, error: float, confidence: float) -> float:
    """N = z^2 sigma^2_IS / error^2 with z = quantile(1 - alpha / 2), thesis eq. 5.17, corrected.

    Keeps the error of the mean below `error` with the confidence. The error is in the unit of the field, or,
    with sigma^2_IS / Var_p as the spread, a share of the posterior's sd. The thesis divides by the mean
    instead, so that its number depends on where the origin lies.

    >>> round(asymptotic_normal(100.0, 1.0, 0.95))
    384
    """
    return spread * (normal_quantile((1.0 + confidence) / 2.0) / error) ** 2


def likelihood_sum(likelihood: Floats, threshold: float) -> float:
    """N at which likelihoods (N,) as large as these on average add up to the threshold, thesis 5.4.1.

    Infinite when none is positive.
    """
    mean = float(np.mean(likelihood))
    return threshold / mean if mean > 0 else math.inf
