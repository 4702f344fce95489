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
_WORDS = 256
"""How many are made at once."""
_ONE = np.uint64(1)
_LOW = np.uint64(0xFFFFFFFF)


@compiled
def _product(a: np.uint64, b: np.uint64) -> tuple[np.uint64, np.uint64]:
    """The upper and the lower half of the product of two words."""
    half = np.uint64(32)
    a0, a1, b0, b1 = a & _LOW, a >> half, b & _LOW, b >> half
    lowest = a0 * b0
    middle = a1 * b0 + (lowest >> half)
    other = a0 * b1 + (middle & _LOW)
    return a1 * b1 + (middle >> half) + (other >> half), (other << half) | (lowest & _LOW)


@compiled
def _fill_blocks(keys: Words, first: int, words: Words) -> None:
    """Fill in the words of the blocks from `first`, counted from 0, of the generator with the keys (2,).

    The inner loop runs over blocks, so that the compiler can use vector instructions.
    """
    size = words.shape[0] // 4
    lanes = np.zeros((4, size), np.uint64)
    a, b, c, d = lanes[0], lanes[1], lanes[2], lanes[3]
    for k in range(size):
        a[k] = np.uint64(first + k + 1)
    one, other = keys[0], keys[1]
    for _ in range(_ROUNDS):
        for k in range(size):
            high, low = _product(_FACTORS[0], a[k])
            other_high, other_low = _product(_FACTORS[1], c[k])
            a[k], b[k], c[k], d[k] = other_high ^ b[k] ^ one, other_low, high ^ d[k] ^ other, low
        one += _STEPS[0]
        other += _STEPS[1]
    for k in range(size):
        words[4 * k], words[4 * k + 1], words[4 * k + 2], words[4 * k + 3] = a[k], b[k], c[k], d[k]


@compiled
def _fill(keys: Words, words: Words, found: Floats) -> None:
    """Fill in the first `random()` numbers of a generator."""
    for first in range(0, found.shape[0], _WORDS):
        count = min(_WORDS, found.shape[0] - first)
        _fill_blocks(keys, first // 4, words[: (count + 3) // 4 * 4])
        for n in range(count):
            found[first + n] = np.float64(words[n] >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@compiled
def uniforms_of_each(keys: Words, starts: Ints) -> Floats:
    """The first `random()` numbers of the generators with the keys (T, 2), from 0 to below 1.

    Those of generator t are `starts[t]` to `starts[t + 1] - 1`.
    """
    found, words = np.empty(starts[-1]), np.empty(_WORDS, np.uint64)
    for t in range(keys.shape[0]):
        _fill(keys[t], words, found[starts[t] : starts[t + 1]])
    return found


@compiled
def shuffled_of_each(keys: Words, starts: Ints, rounds: Ints) -> tuple[Floats, Ints]:
    """Draw as `uniforms_of_each` does, and then permutations.

    Generator t has as many numbers as `rounds[t]` permutations of equal length. These are the rows that its
    `permuted` of 0, 1, ... gives after its `random`, by the shuffle of Fisher and Yates.
    """
    found, turns = np.empty(starts[-1]), np.empty(starts[-1], np.int64)
    words, chosen = np.empty(_WORDS, np.uint64), np.empty(np.diff(starts).max(), np.uint32)
    halves, end = words.view(np.uint32), np.uint64(2 * _WORDS)  # the lower half first
    for t in range(keys.shape[0]):
        own = found[starts[t] : starts[t + 1]]
        _fill(keys[t], words, own)
        block, half, size = own.shape[0] // 4, np.uint64(2 * (own.shape[0] % 4)), own.shape[0] // rounds[t]
        _fill_blocks(keys[t], block, words)
        for r in range(rounds[t]):
            n, mask = np.uint64(size - 1), np.uint64(1)  # all bits up to the highest one of n
            while mask < n:
                mask = np.uint64(mask << _ONE | _ONE)
            while mask > 0:  # one that is too large is written over: no processor foresees such a branch
                low = np.uint64(mask >> _ONE)
                while n > low:
                    if half == end:
                        block, half = block + _WORDS // 4, np.uint64(0)
                        _fill_blocks(keys[t], block, words)
                    value = np.uint64(halves[half]) & mask
                    chosen[n] = value
                    half += _ONE
                    n -= np.uint64(value <= n)
                mask = low
            row = turns[starts[t] + r * size : starts[t] + (r + 1) * size]
            for k in range(size):
                row[k] = k
            for k in range(size - 1, 0, -1):
                row[k], row[chosen[k]] = row[chosen[k]], row[k]
    return found, turns
