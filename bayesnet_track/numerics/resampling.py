"""Resampling: which hypotheses survive, drawn so that each survives N w times on average.

`systematic` has the least variance and is the usual choice; `multinomial` is the textbook one. All are
O(N): sorted positions in [0, 1) are looked up in the cumulative weights.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats

Ancestors = NDArray[np.int64]


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
    from bayesnet_track.numerics.kernels.resampling_kernels import (
        look_up_even,  # a graph is validated without
    )

    return look_up_even(weights, rng.random(), count)


def multinomial(weights: Floats, count: int, rng: np.random.Generator) -> Ancestors:
    """Independent draws (tracking chapter, Algorithm 1, its index kept in range)."""
    from bayesnet_track.numerics.kernels.resampling_kernels import look_up

    # Normalised sums of exponential draws are sorted uniform draws, without sorting.
    gaps = np.cumsum(rng.standard_exponential(count + 1))
    return look_up(weights, gaps[:-1] / gaps[-1])


SCHEMES: Mapping[str, Callable[[Floats, int, np.random.Generator], Ancestors]] = MappingProxyType(
    {"systematic": systematic, "multinomial": multinomial}
)
