"""Markov chains of few states: from rates or a matrix to the transition over any time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bayesnet_track.numerics.arrays import Floats

Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Chain:
    """A chain of K states.

    Attributes:
        rows: (K, K) rates per frame interval, each row summing to 0; or the transition matrix of one frame
            interval, each row summing to 1.
        by_rates: whether they are rates.
    """

    rows: Rows
    by_rates: bool

    def over(self, dt: float) -> Floats:
        """(K, K) probabilities of the state `dt` frame intervals later, by the state before; read-only.

        By rates it is exact for any `dt`. A matrix is raised to the whole part of `dt`; what is left of it is
        the share of one more step.
        """
        return _over(self, dt)

    def stationary(self) -> Floats:
        """(K,) shares of time in the long run."""
        matrix = self.over(1.0)
        size = len(matrix)
        system = np.concatenate([matrix.T - np.eye(size), np.ones((1, size))])
        shares = np.linalg.lstsq(system, np.append(np.zeros(size), 1.0), rcond=None)[0]
        shares = np.maximum(shares, 0.0)
        return np.asarray(shares / shares.sum())


@lru_cache(maxsize=256)
def _over(chain: Chain, dt: float) -> Floats:
    matrix = np.array(chain.rows)
    if chain.by_rates:
        from scipy.linalg import expm  # here, because it takes long to import

        found = np.maximum(expm(matrix * dt), 0.0)
    else:
        whole = int(dt)
        step = (1.0 - (dt - whole)) * np.eye(len(matrix)) + (dt - whole) * matrix
        found = np.linalg.matrix_power(matrix, whole) @ step
    found = np.asarray(found / found.sum(axis=1, keepdims=True))
    found.setflags(write=False)
    return found
