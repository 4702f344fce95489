"""Random streams keyed by what does not shift, so that no draw depends on what else was drawn.

A key names the seed, whose draws these are, the node, the moment and the purpose. In a run the owner is a
target's birth and the moment the nominal time of the frame. Neither a target's id nor the frame's index is in
it: both shift when another target starts earlier or a frame comes late.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random.bit_generator import ISeedSequence
from numpy.typing import NDArray


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
        from bayesnet_track.numerics.kernels.stream_kernels import uniforms_of_each

        keys = self.keys(((owner, node) for owner in owners), moment, purpose)
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
