"""Tables of many short arrays, a row each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesnet_track.numerics.arrays import Floats


def stack(arrays: Sequence[Floats], *shape: int) -> Floats:
    """(T, *shape) arrays as one, also when there are none."""
    return np.array(arrays, dtype=np.float64).reshape(len(arrays), *shape)
