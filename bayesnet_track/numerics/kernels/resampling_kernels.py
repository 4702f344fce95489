"""The compiled look-up of sorted positions in cumulative weights.

For each position: the first index whose cumulative weight, as a share of all, is larger; the last index with
a positive weight where there is none, since a position may round up to 1. Shares are quotients: the last one
is exactly 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.numerics.kernels.copy_kernels import copy_row

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
