"""Resampling: the hypotheses that survive, and compiled copies of their rows.

Numba compiles `to[:] = values` with the text of the error for unequal shapes, which takes seconds.

For each position: the first index whose cumulative weight, as a share of all, is larger; the last index with
a positive weight where there is none, since a position may round up to 1. Shares are quotients: the last one
is exactly 1.

`systematic` has the least variance and is the usual choice; `multinomial` is the textbook one. All are
O(N): sorted positions in [0, 1) are looked up in the cumulative weights.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
    total, last = 0.0, 0
    for n in range(weights.shape[0]):
        total += weights[n]
        if weights[n] > 0.0:
            last = n
    return total, last


@compiled
def look_up(weights: Floats, positions: Floats) -> Ancestors:
    """(M,) indices into `weights` (N,), not negative, of ascending `positions`: one walk through both."""
    total, last = _total_and_last(weights)
    found = np.empty(positions.shape[0], np.int64)
    n, cumulative = 0, weights[0]
    for m in range(positions.shape[0]):
        while n < last and cumulative / total <= positions[m]:
            n += 1
            cumulative += weights[n]
        found[m] = n
    return found


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
    total, last = _total_and_last(weights)
    positions, first_of = np.empty(count), np.empty(count + 1, np.int64)
    for m in range(count):
        positions[m] = (m + shift) / count
    first_of[:] = 0
    cumulative = 0.0
    for n in range(last):
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
    found = np.empty((weights.shape[0], count), np.int64)
    for t in range(weights.shape[0]):
        copy_row(look_up_even(weights[t], shifts[t], count), found[t])
    return found


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
