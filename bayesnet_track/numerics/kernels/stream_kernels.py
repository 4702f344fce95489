"""The numbers of many Philox generators in one call: Philox4x64-10 (Salmon et al. 2011) as NumPy's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.compiled import compiled

Words = NDArray[np.uint64]

_FACTORS = (np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157))
_STEPS = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B))
_ROUNDS = 10
_LOW = np.uint64(0xFFFFFFFF)


@compiled
def _high(a: np.uint64, b: np.uint64) -> np.uint64:
    """The upper half of the product of two words."""
    half = np.uint64(32)
    a0, a1, b0, b1 = a & _LOW, a >> half, b & _LOW, b >> half
    middle = a1 * b0 + ((a0 * b0) >> half)
    other = a0 * b1 + (middle & _LOW)
    return a1 * b1 + (middle >> half) + (other >> half)


@compiled
def _block(keys: Words, count: int, words: Words) -> None:
    """Fill in the four words of block `count`, from 1, of the generator with the keys (2,)."""
    first, second = keys[0], keys[1]
    a, b, c, d = np.uint64(count), np.uint64(0), np.uint64(0), np.uint64(0)
    for _ in range(_ROUNDS):
        high, low = _high(_FACTORS[0], a), _FACTORS[0] * a
        other_high, other_low = _high(_FACTORS[1], c), _FACTORS[1] * c
        a, b, c, d = other_high ^ b ^ first, other_low, high ^ d ^ second, low
        first += _STEPS[0]
        second += _STEPS[1]
    words[0], words[1], words[2], words[3] = a, b, c, d


@compiled
def _fill(keys: Words, words: Words, found: Floats) -> int:
    """Fill in the first `random()` numbers of a generator; how many words they took."""
    for n in range(found.shape[0]):
        if n % 4 == 0:
            _block(keys, n // 4 + 1, words)
        found[n] = np.float64(words[n % 4] >> np.uint64(11)) * (1.0 / 9007199254740992.0)
    return int(found.shape[0])


@compiled
def uniforms_of_each(keys: Words, starts: Ints) -> Floats:
    """The first `random()` numbers of the generators with the keys (T, 2), from 0 to below 1.

    Those of generator t are `starts[t]` to `starts[t + 1] - 1`.
    """
    found, words = np.empty(starts[-1]), np.empty(4, np.uint64)
    for t in range(keys.shape[0]):
        _fill(keys[t], words, found[starts[t] : starts[t + 1]])
    return found


@compiled
def shuffled_of_each(keys: Words, starts: Ints, rounds: Ints) -> tuple[Floats, Ints]:
    """As `uniforms_of_each`, and then permutations.

    Generator t has as many numbers as `rounds[t]` permutations of equal length. These are the rows that its
    `permuted` of 0, 1, ... gives after its `random`, by the shuffle of Fisher and Yates.
    """
    found, turns = np.empty(starts[-1]), np.empty(starts[-1], np.int64)
    words, held = np.empty(4, np.uint64), np.uint64(0)
    for t in range(keys.shape[0]):
        used = _fill(keys[t], words, found[starts[t] : starts[t + 1]])
        size = (starts[t + 1] - starts[t]) // rounds[t]
        is_held = False
        for r in range(rounds[t]):
            row = turns[starts[t] + r * size : starts[t] + (r + 1) * size]
            for n in range(size):
                row[n] = n
            for n in range(size - 1, 0, -1):
                mask = np.uint64(n)  # all bits up to the highest one of n
                for shift in (1, 2, 4, 8, 16):
                    mask |= mask >> np.uint64(shift)
                chosen = np.int64(n + 1)
                while chosen > n:
                    if is_held:
                        value, is_held = held, False
                    else:
                        if used % 4 == 0:
                            _block(keys[t], used // 4 + 1, words)
                        value, held, is_held = words[used % 4] & _LOW, words[used % 4] >> np.uint64(32), True
                        used += 1
                    chosen = np.int64(value & mask)
                row[n], row[chosen] = row[chosen], row[n]
    return found, turns
