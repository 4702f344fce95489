"""The binomial test: what share of a whole can be vouched for, when so much of a sample has a property."""

from __future__ import annotations

import math
from functools import lru_cache

_TINY = 1e-300
_TERMS = 10_000
_EXACT = 1e12
"""Trials from which on the sampling error, below 1e-6, counts for nothing."""


def binomial_tail(successes: float, trials: float, share: float) -> float:
    """P(X >= successes) for X of Binomial(trials, share): the p-value of the one-sided test.

    Between whole numbers it goes on as the incomplete beta function I_share(k, n - k + 1), so that effective
    sample sizes can be trials.

    >>> round(binomial_tail(29, 29, 0.9), 4), round(0.9 ** 29, 4)
    (0.0471, 0.0471)
    """
    if successes <= 0.0:
        return 1.0
    return incomplete_beta(successes, trials - successes + 1.0, share)


@lru_cache(maxsize=64)
def vouched_share(inside: float, trials: float, confidence: float) -> float:
    """The largest share p0 that the test with `confidence` still grants: the lower Clopper-Pearson bound.

    Args:
        inside: share of the sample that has the property, 0 to 1.
        trials: its effective size, above 0; inf when `inside` is exact.
        confidence: one-sided, 0.5 to 1.

    Returns:
        p with `binomial_tail(inside * trials, trials, p) == 1 - confidence`; `inside` itself when exact.

    >>> round(vouched_share(1.0, 29, 0.95), 4), vouched_share(0.7, math.inf, 0.95)
    (0.9019, 0.7)
    """
    inside = min(max(inside, 0.0), 1.0)
    successes = inside * trials
    if trials >= _EXACT or successes < _TINY:
        return inside
    a, b, level = successes, trials - successes + 1.0, 1.0 - confidence
    log_beta = math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)
    low, high, p = 0.0, 1.0, min(max((a - 0.5) / (a + b - 1.0), 0.25 * a / (a + b)), 0.999)
    for _ in range(100):
        excess = incomplete_beta(a, b, p) - level
        low, high = (p, high) if excess < 0.0 else (low, p)
        slope = math.exp((a - 1.0) * math.log(p) + (b - 1.0) * math.log1p(-p) - log_beta)
        step = excess / slope if slope > _TINY else math.inf
        new = p - step
        if not low < new < high:
            new = 0.5 * (low + high)
        if abs(new - p) <= 1e-12 or not 0.0 < new < 1.0:
            return min(max(new, 0.0), 1.0)
        p = new
    return p


def incomplete_beta(a: float, b: float, x: float) -> float:
    """I_x(a, b), regularised, for a, b > 0, by its continued fraction (Lentz)."""
    if x <= 0.0 or x >= 1.0:
        return 0.0 if x <= 0.0 else 1.0
    if x > (a + 1.0) / (a + b + 2.0):
        return 1.0 - incomplete_beta(b, a, 1.0 - x)
    front = a * math.log(x) + b * math.log1p(-x) + math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)
    c, d = 1.0, _not_zero(1.0 - (a + b) * x / (a + 1.0))
    d = 1.0 / d
    fraction = d
    for m in range(1, _TERMS):
        even = m * (b - m) * x / ((a + 2 * m - 1.0) * (a + 2 * m))
        d, c = 1.0 / _not_zero(1.0 + even * d), _not_zero(1.0 + even / c)
        fraction *= d * c
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1.0))
        d, c = 1.0 / _not_zero(1.0 + odd * d), _not_zero(1.0 + odd / c)
        fraction *= d * c
        if abs(d * c - 1.0) < 1e-15:
            break
    return min(math.exp(front) * fraction / a, 1.0)


def _not_zero(value: float) -> float:
    return value if abs(value) > _TINY else _TINY
