"""Resampling: how many hypotheses a posterior needs, which survive, and compiled copies of their rows.

Numba compiles `to[:] = values` with the text of the error for unequal shapes, which takes seconds.

For each position: the first index whose cumulative weight, as a share of all, is larger; the last index with
a positive weight where there is none, since a position may round up to 1. Shares are quotients: the last one
is exactly 1.

`systematic` has the least variance and is the usual choice; `multinomial` is the textbook one. All are
O(N): sorted positions in [0, 1) are looked up in the cumulative weights.

The weights w of N hypotheses x_i need no scale: every formula is in a form that stays the same when all of
them are multiplied by a number. E = sum w x / sum w is the mean of the posterior. What is returned is a real
number of hypotheses: not rounded, not kept in bounds, 0 where a formula asks for none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from statistics import NormalDist
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled


@compiled
def copy_row(values: NDArray[Any], to: NDArray[Any]) -> None:
    """Fill `to` (N,) with the first N of `values`."""
    for n in range(to.shape[0]):
        to[n] = values[n]


@compiled
def copy_rows(values: NDArray[Any], to: NDArray[Any]) -> None:
    """Fill `to` (N, K) with the first N rows and K columns of `values`."""
    for n in range(to.shape[0]):
        for k in range(to.shape[1]):
            to[n, k] = values[n, k]


Ancestors = NDArray[np.int64]


@compiled
def _total_and_last(weights: Floats) -> tuple[float, int]:
    """The sum, added up from the first to the last, and the last index with a positive weight."""
    total, last_index = 0.0, 0
    for n in range(weights.shape[0]):
        total += weights[n]
        if weights[n] > 0.0:
            last_index = n
    return total, last_index


@compiled
def look_up(weights: Floats, positions: Floats) -> Ancestors:
    """(M,) indices into `weights` (N,), not negative, of ascending `positions`: one walk through both."""
    total, last_index = _total_and_last(weights)
    indices = np.empty(positions.shape[0], np.int64)
    n, cumulative = 0, weights[0]
    for m in range(positions.shape[0]):
        while n < last_index and cumulative / total <= positions[m]:
            n += 1
            cumulative += weights[n]
        indices[m] = n
    return indices


@compiled
def look_up_even(weights: Floats, shift: float, count: int) -> Ancestors:
    """The same for the positions (m + shift) / count, m = 0 to count - 1.

    How many of them lie below a share is known but for three, so that no branch depends on the weights: a
    walk waits for most of its branches, which cannot be foreseen.

    Args:
        weights: (N,) not negative.
        shift: from 0 to 1.
        count: number of positions.
    """
    total, last_index = _total_and_last(weights)
    positions, first_of = np.empty(count), np.empty(count + 1, np.int64)
    for m in range(count):
        positions[m] = (m + shift) / count
    first_of[:] = 0
    cumulative = 0.0
    for n in range(last_index):
        cumulative += weights[n]
        share = cumulative / total
        k = int(share * count)
        if 1 <= k < count - 1:
            k += int(positions[k - 1] < share) + int(positions[k] < share) + int(positions[k + 1] < share) - 1
        else:
            k = min(max(k - 1, 0), count)
            while k < count and positions[k] < share:
                k += 1
        first_of[k] = n + 1  # from position k on; where several weights end, the last one counts
    largest = 0
    for m in range(count):
        largest = max(largest, first_of[m])
        first_of[m] = largest
    return first_of[:count]


@compiled
def look_up_even_of_each(weights: Floats, shifts: Floats, count: int) -> Ancestors:
    """(T, count) `look_up_even` of the weights (T, N) of each of T targets with its own shift."""
    indices = np.empty((weights.shape[0], count), np.int64)
    for t in range(weights.shape[0]):
        copy_row(look_up_even(weights[t], shifts[t], count), indices[t])
    return indices


def resample(scheme: str, weights: Floats, count: int, rng: np.random.Generator) -> Ancestors:
    """Ancestors of `count` new hypotheses: ``E[times i is drawn] = count * weights[i]``.

    Args:
        scheme: systematic or multinomial.
        weights: (N,) not negative, summing to 1 up to rounding.
        count: how many to draw; need not be N.
        rng: source of randomness.

    Returns:
        (count,) int64 indices into `weights`, in ascending order.

    Raises:
        ValueError: unknown scheme.

    >>> resample("systematic", np.array([0.25, 0.0, 0.75]), 4, np.random.default_rng(0)).tolist()
    [0, 2, 2, 2]
    """
    if scheme not in SCHEMES:
        raise ValueError(f"unknown resampling scheme {scheme!r}; one of {', '.join(SCHEMES)}")
    return SCHEMES[scheme](weights, count, rng)


def systematic(weights: Floats, count: int, rng: np.random.Generator) -> Ancestors:
    """One uniform draw shifts a comb: each hypothesis is drawn ``count * w`` times, rounded up or down."""

    return look_up_even(weights, rng.random(), count)


def multinomial(weights: Floats, count: int, rng: np.random.Generator) -> Ancestors:
    """Independent draws (tracking chapter, Algorithm 1, its index kept in range)."""

    # Normalised sums of exponential draws are sorted uniform draws, without sorting.
    gaps = np.cumsum(rng.standard_exponential(count + 1))
    return look_up(weights, gaps[:-1] / gaps[-1])


SCHEMES: Mapping[str, Callable[[Floats, int, np.random.Generator], Ancestors]] = MappingProxyType(
    {"systematic": systematic, "multinomial": multinomial}
)


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
    _, bins = np.unique(np.floor(values / width), return_inverse=True)
    return int(np.count_nonzero(np.bincount(bins, weights) > NEGLIGIBLE * weights.mean()))


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
    deviations = _from_mean(values, weights)
    return float(len(values) * np.sum((weights * deviations) ** 2) / weights.sum() ** 2)


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


def kld_revised(bins: float, error: float, confidence: float, factor: float) -> float:
    """KLD-sampling for hypotheses from an importance function: `factor` times `kld`, thesis eq. 5.10.

    With `inflation` as the factor it is eq. 5.10, with `simple_inflation` eq. 5.14.
    """
    return factor * kld(bins, error, confidence)


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
