"""Random streams keyed by what does not shift, so that no draw depends on what else was drawn.

A key names the seed, whose draws these are, the node, the moment and the purpose. In a run the owner is a
target's birth and the moment the nominal time of the frame. Neither a target's id nor the frame's index is in
it: both shift when another target starts earlier or a frame comes late.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Any

import numpy as np
from numpy.random.bit_generator import ISeedSequence
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.compiled import compiled


def moment_of(time: float) -> int:
    """Moment of a key: a time in billionths of a frame interval, so that rounding does not tell.

    >>> moment_of(3.0), moment_of(0.1 + 0.2) == moment_of(0.3)
    (3000000000, True)
    """
    return round(time * 1e9)


def birth_key(time: float, plate: str, detection: int | str, camera: str = "") -> str:
    """Key of a target's draws: the detection that it was first seen in.

    Args:
        time: time of that frame, frame intervals.
        plate: its plate: several may start targets from one detection.
        detection: number of the detection in its frame, the best first; - and the id of a start by hand.
        camera: name of the camera; empty where there is only one.

    >>> birth_key(3.0, "person", 2)
    '3000000000//person/2'
    """
    return f"{moment_of(time)}/{camera}/{plate}/{detection}"


@dataclass(frozen=True)
class Streams:
    """Independent generators for one run.

    >>> streams = Streams(seed=7)
    >>> birth = birth_key(0.0, "square", -1)
    >>> a = streams.of(birth, "square", moment_of(3.0), "propagate").normal()
    >>> b = streams.of(birth, "square", moment_of(3.0), "propagate").normal()
    >>> a == b
    True
    """

    seed: int

    def of(self, owner: str, node: str, moment: int, purpose: str) -> np.random.Generator:
        """A Philox generator whose key is a stable hash of the seed and the four names."""
        digest = self._digest(owner, node, moment, purpose)
        seed: Any = _Key(digest)  # the stubs of NumPy know no such seed, its documentation does
        return np.random.Generator(np.random.Philox(seed))

    def of_each(
        self, owners: Iterable[str], node: str, moment: int, purpose: str
    ) -> Iterator[np.random.Generator]:
        """`of(owner, node, moment, purpose)` of each owner in turn: one object, for use before the next.

        >>> streams = Streams(seed=7)
        >>> one = streams.of("2", "square", 3, "shift").normal()
        >>> [own.normal() == one for own in streams.of_each(["1", "2"], "square", 3, "shift")]
        [False, True]
        """
        generator: np.random.Generator | None = None
        for owner in owners:
            if generator is None:
                generator = self.of(owner, node, moment, purpose)
                bits: Any = generator.bit_generator
                state = bits.state
            else:  # a new one takes four times as long
                state["state"]["key"] = np.frombuffer(self._digest(owner, node, moment, purpose), "<u8")
                bits.state = state
            yield generator

    def keys(self, names: Iterable[tuple[str, str]], moment: int, purpose: str) -> NDArray[np.uint64]:
        """(K, 2) keys of the generators of K owners and nodes."""
        digests = b"".join(self._digest(owner, node, moment, purpose) for owner, node in names)
        return np.frombuffer(digests, "<u8").astype(np.uint64).reshape(-1, 2)

    def uniforms(
        self, owners: Iterable[str], node: str, moment: int, purpose: str, counts: Sequence[int] | None = None
    ) -> NDArray[np.float64]:
        """Draws of `of(owner, node, moment, purpose).random()`, or `random(count)`, for each of T owners.

        >>> streams = Streams(seed=7)
        >>> one = streams.of("2", "square", 3, "shift").random()
        >>> float(streams.uniforms(["1", "2"], "square", 3, "shift")[1]) == one
        True
        """

        keys = self.keys(zip(owners, repeat(node), strict=False), moment, purpose)
        starts = np.arange(len(keys) + 1) if counts is None else np.cumsum([0, *counts])
        return uniforms_of_each(keys, starts)

    def _digest(self, owner: str, node: str, moment: int, purpose: str) -> bytes:
        text = "\x1f".join((str(self.seed), owner, node, str(moment), purpose))
        return hashlib.blake2b(text.encode(), digest_size=16).digest()


class _Key(ISeedSequence):
    """The key of a Philox generator: `Philox(key=...)` would also ask the system for entropy, to no use."""

    def __init__(self, digest: bytes) -> None:
        self._words = np.frombuffer(digest, "<u8").astype(np.uint64)

    def generate_state(self, n_words: int, dtype: object = np.uint64) -> NDArray[np.uint64]:
        """The (2,) words."""
        return self._words


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
    cross = a0 * b1 + (middle & _LOW)
    return a1 * b1 + (middle >> half) + (cross >> half), (cross << half) | (lowest & _LOW)


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
    key_0, key_1 = keys[0], keys[1]
    for _ in range(_ROUNDS):
        for k in range(size):
            high, low = _product(_FACTORS[0], a[k])
            other_high, other_low = _product(_FACTORS[1], c[k])
            a[k], b[k], c[k], d[k] = other_high ^ b[k] ^ key_0, other_low, high ^ d[k] ^ key_1, low
        key_0 += _STEPS[0]
        key_1 += _STEPS[1]
    for k in range(size):
        words[4 * k], words[4 * k + 1], words[4 * k + 2], words[4 * k + 3] = a[k], b[k], c[k], d[k]


@compiled
def _fill(keys: Words, words: Words, numbers: Floats) -> None:
    """Fill in the first `random()` numbers of a generator."""
    for first in range(0, numbers.shape[0], _WORDS):
        count = min(_WORDS, numbers.shape[0] - first)
        _fill_blocks(keys, first // 4, words[: (count + 3) // 4 * 4])
        for n in range(count):
            numbers[first + n] = np.float64(words[n] >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@compiled
def uniforms_of_each(keys: Words, starts: Ints) -> Floats:
    """The first `random()` numbers of the generators with the keys (T, 2), from 0 to below 1.

    Those of generator t are `starts[t]` to `starts[t + 1] - 1`.
    """
    numbers, words = np.empty(starts[-1]), np.empty(_WORDS, np.uint64)
    for t in range(keys.shape[0]):
        _fill(keys[t], words, numbers[starts[t] : starts[t + 1]])
    return numbers


@compiled
def shuffled_of_each(keys: Words, starts: Ints, rounds: Ints) -> tuple[Floats, Ints]:
    """Draw as `uniforms_of_each` does, and then permutations.

    Generator t has as many numbers as `rounds[t]` permutations of equal length. These are the rows that its
    `permuted` of 0, 1, ... gives after its `random`, by the shuffle of Fisher and Yates.
    """
    numbers, turns = np.empty(starts[-1]), np.empty(starts[-1], np.int64)
    words, swaps = np.empty(_WORDS, np.uint64), np.empty(np.diff(starts).max(), np.uint32)
    halves, end = words.view(np.uint32), np.uint64(2 * _WORDS)  # the lower half first
    for t in range(keys.shape[0]):
        generated = numbers[starts[t] : starts[t + 1]]
        _fill(keys[t], words, generated)
        count = generated.shape[0]
        block, half, size = count // 4, np.uint64(2 * (count % 4)), count // rounds[t]
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
                    swaps[n] = value
                    half += _ONE
                    n -= np.uint64(value <= n)
                mask = low
            row = turns[starts[t] + r * size : starts[t] + (r + 1) * size]
            for k in range(size):
                row[k] = k
            for k in range(size - 1, 0, -1):
                row[k], row[swaps[k]] = row[swaps[k]], row[k]
    return numbers, turns
