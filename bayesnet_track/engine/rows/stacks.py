"""Tables of many short arrays or tuples, a row each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesnet_track.numerics.arrays import Floats


def stack(arrays: Sequence[Floats], *shape: int) -> Floats:
    """(T, *shape) arrays as one, also when there are none."""
    return np.array(arrays, dtype=np.float64).reshape(len(arrays), *shape)


def right_aligned(values: Sequence[tuple[float, ...]], size: int) -> Floats:
    """(T, size) the values, the last of each at its right end."""
    table = np.zeros((len(values), size))
    for row, several in enumerate(values):
        if several:
            table[row, size - len(several) :] = several
    return table
