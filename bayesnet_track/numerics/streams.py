"""Random streams keyed by what they are for, so that no draw depends on what else was drawn."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random.bit_generator import ISeedSequence
from numpy.typing import NDArray


@dataclass(frozen=True)
class Streams:
    """Independent generators for one run.

    >>> streams = Streams(seed=7)
    >>> a = streams.of("1", "square", frame=3, purpose="propagate").normal()
    >>> b = streams.of("1", "square", frame=3, purpose="propagate").normal()
    >>> a == b
    True
    """

    seed: int

    def of(self, target: str, node: str, frame: int, purpose: str) -> np.random.Generator:
        """A Philox generator whose key is a stable hash of the seed and the four names."""
        digest = self._digest(target, node, frame, purpose)
        seed: Any = _Key(digest)  # the stubs of NumPy know no such seed, its documentation does
        return np.random.Generator(np.random.Philox(seed))

    def of_each(
        self, targets: Iterable[str], node: str, frame: int, purpose: str
    ) -> Iterator[np.random.Generator]:
        """`of(target, node, frame, purpose)` of each target in turn: one object, for use before the next.

        >>> streams = Streams(seed=7)
        >>> one = streams.of("2", "square", frame=3, purpose="shift").normal()
        >>> [own.normal() == one for own in streams.of_each(["1", "2"], "square", 3, "shift")]
        [False, True]
        """
        generator: np.random.Generator | None = None
        for target in targets:
            if generator is None:
                generator = self.of(target, node, frame, purpose)
                bits: Any = generator.bit_generator
                state = bits.state
            else:  # a new one takes four times as long
                state["state"]["key"] = np.frombuffer(self._digest(target, node, frame, purpose), "<u8")
                bits.state = state
            yield generator

    def keys(self, names: Iterable[tuple[str, str]], frame: int, purpose: str) -> NDArray[np.uint64]:
        """(K, 2) keys of the generators of K targets and nodes."""
        digests = b"".join(self._digest(target, node, frame, purpose) for target, node in names)
        return np.frombuffer(digests, "<u8").astype(np.uint64).reshape(-1, 2)

    def uniforms(
        self, targets: Iterable[str], node: str, frame: int, purpose: str, counts: Sequence[int] | None = None
    ) -> NDArray[np.float64]:
        """What `of(target, node, frame, purpose).random()` gives for each of T targets, or `random(count)`.

        >>> streams = Streams(seed=7)
        >>> one = streams.of("2", "square", frame=3, purpose="shift").random()
        >>> float(streams.uniforms(["1", "2"], "square", frame=3, purpose="shift")[1]) == one
        True
        """
        from bayesnet_track.numerics.kernels.stream_kernels import uniforms_of_each

        keys = self.keys(((target, node) for target in targets), frame, purpose)
        starts = np.arange(len(keys) + 1) if counts is None else np.cumsum([0, *counts])
        return uniforms_of_each(keys, starts)

    def _digest(self, target: str, node: str, frame: int, purpose: str) -> bytes:
        text = "\x1f".join((str(self.seed), target, node, str(frame), purpose))
        return hashlib.blake2b(text.encode(), digest_size=16).digest()


class _Key(ISeedSequence):
    """The key of a Philox generator: `Philox(key=...)` would also ask the system for entropy, to no use."""

    def __init__(self, digest: bytes) -> None:
        self._words = np.frombuffer(digest, "<u8").astype(np.uint64)

    def generate_state(self, n_words: int, dtype: object = np.uint64) -> NDArray[np.uint64]:
        """The (2,) words."""
        return self._words
