"""Divergences between beliefs on the same hypotheses, and the uncertainty deviation UD.

f is a belief, beta its prior weights, L a likelihood; all live on one set of N hypotheses.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from bayesnet_track.numerics.arrays import Floats


def kl(log_f: Floats, log_g: Floats) -> float:
    """KL(f || g) = sum f ln(f / g) in nats, of normalised log-weights (N,) on the same hypotheses.

    At least 0; inf where g is 0 and f is not; hypotheses with f = 0 count nothing.

    >>> round(kl(np.log([0.5, 0.5]), np.log([0.25, 0.75])), 4)
    0.1438
    """
    f, g = log_f, log_g
    if f.min() == -np.inf:  # seldom: picking the others costs as much as all the rest
        alive = log_f > -np.inf
        f, g = log_f[alive], log_g[alive]
    if g.min() == -np.inf:
        return float("inf")
    return max(0.0, float(np.dot(np.exp(f), f - g)))


def select(columns: Sequence[int]) -> slice | list[int]:
    """What selects these columns: a slice, which copies nothing, where they stand side by side."""
    side_by_side = _slice_of(tuple(columns))
    return list(columns) if side_by_side is None else side_by_side


@lru_cache(maxsize=64)
def _slice_of(columns: tuple[int, ...]) -> slice | None:
    first, size = columns[0], len(columns)
    return slice(first, first + size) if columns == tuple(range(first, first + size)) else None


def uncertainty_deviation(states: Floats, weights: Floats, centre: Floats) -> float:
    """UD = sum w d(h, centre)^2 = tr Cov + |mean - centre|^2 (thesis eqs. 2.11-2.13, corrected).

    Args:
        states: (N, k) the fields that count, in px.
        weights: (N,) weights that sum to 1 (not their logarithms).
        centre: (k,) the MAP hypothesis; for an agent its maximum-likelihood hypothesis.

    Returns:
        UD in px^2.

    >>> states = np.array([[-30.0], [30.0]])
    >>> uncertainty_deviation(states, np.array([0.5, 0.5]), np.array([30.0]))
    1800.0
    """
    if len(centre) == 2:  # column by column, in half of the time
        x, y = states[:, 0] - centre[0], states[:, 1] - centre[1]
        return float(np.dot(weights, x * x + y * y))
    away = states - centre
    return float(np.dot(weights, np.einsum("nk,nk->n", away, away)))
