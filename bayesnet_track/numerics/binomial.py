"""The binomial test: what share of a whole can be vouched for, when so much of a sample has a property."""

from __future__ import annotations

from functools import lru_cache

_EXACT = 1e12
"""Trials from which on the sampling error, below 1e-6, counts for nothing."""


@lru_cache(maxsize=64)
def vouched_share(inside: float, trials: float, confidence: float) -> float:
    """The largest share p0 that the test with `confidence` still grants: the lower Clopper-Pearson bound.

    Args:
        inside: share of the sample that has the property, 0 to 1.
        trials: its effective size, above 0; inf when `inside` is exact.
        confidence: one-sided, 0.5 to 1.

    Returns:
        p at which P(X >= inside * trials) of X ~ Binomial(trials, p) is 1 - confidence, between whole numbers
        continued as the incomplete beta function; `inside` itself when exact.

    >>> round(vouched_share(1.0, 29, 0.95), 4), vouched_share(0.7, float("inf"), 0.95)
    (0.9019, 0.7)
    """
    inside = min(max(inside, 0.0), 1.0)
    successes = inside * trials
    if trials >= _EXACT or successes == 0.0:
        return inside
    from scipy.special import betaincinv  # here, because it takes long to import

    return float(betaincinv(successes, trials - successes + 1.0, 1.0 - confidence))
