"""The first number of many Philox generators: Philox4x64-10 (Salmon et al. 2011) as NumPy's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled

Words = NDArray[np.uint64]

_FACTORS = (np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157))
_STEPS = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B))
_ROUNDS = 10


@compiled
def _high(a: np.uint64, b: np.uint64) -> np.uint64:
    """The upper half of the product of two words."""
    half, low = np.uint64(32), np.uint64(0xFFFFFFFF)
    a0, a1, b0, b1 = a & low, a >> half, b & low, b >> half
    middle = a1 * b0 + ((a0 * b0) >> half)
    other = a0 * b1 + (middle & low)
    return a1 * b1 + (middle >> half) + (other >> half)


@compiled
def first_uniforms(keys: Words) -> Floats:
    """(T,) the first `random()` of the generators with the keys (T, 2), from 0 to below 1."""
    found = np.empty(keys.shape[0])
    for t in range(keys.shape[0]):
        first, second = keys[t, 0], keys[t, 1]
        a, b, c, d = np.uint64(1), np.uint64(0), np.uint64(0), np.uint64(0)  # the first block's counter
        for _ in range(_ROUNDS):
            high, low = _high(_FACTORS[0], a), _FACTORS[0] * a
            other_high, other_low = _high(_FACTORS[1], c), _FACTORS[1] * c
            a, b, c, d = other_high ^ b ^ first, other_low, high ^ d ^ second, low
            first += _STEPS[0]
            second += _STEPS[1]
        found[t] = np.float64(a >> np.uint64(11)) * (1.0 / 9007199254740992.0)
    return found
