"""Random streams keyed by what they are for, so that no draw depends on what else was drawn."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np


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
        text = "\x1f".join((str(self.seed), target, node, str(frame), purpose))
        digest = hashlib.blake2b(text.encode(), digest_size=16).digest()
        return np.random.Generator(np.random.Philox(key=int.from_bytes(digest, "little")))
