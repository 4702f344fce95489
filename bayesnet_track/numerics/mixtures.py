"""Mixtures of Gaussians of one dimension, and Markov chains of few states."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled

HALVINGS = 18
"""Of the bracket in which a quantile lies: 4e-6 of its width is left."""


@compiled
def quantiles(points: Floats, sds: Floats, shares: Floats, levels: Floats) -> Floats:
    """(K, L) quantiles of K mixtures of (K, M) points, blurred by each of (S,) `sds` in its share above 0."""
    count, size = points.shape
    found = np.empty((count, len(levels)))
    reach = 9.0 * sds.max()
    for k in range(count):
        least, most = points[k].min() - reach, points[k].max() + reach
        for n in range(len(levels)):
            low, high = least, most
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                below = 0.0
                for m in range(size):
                    away = (middle - points[k, m]) / math.sqrt(2.0)
                    for s in range(len(sds)):
                        below += shares[s] * 0.5 * math.erfc(-away / sds[s])
                if below < levels[n] * size:
                    low = middle
                else:
                    high = middle
            found[k, n] = 0.5 * (low + high)
    return found


def mixture_quantiles(
    points: ArrayLike, sds: Sequence[float], shares: Sequence[float], levels: ArrayLike
) -> Floats:
    """(K, L) values with (L,) `levels` of the mass below them, for K mixtures.

    A mixture is its (K, M) equally probable points, each blurred by a Gaussian: of sd `sds[s]` with
    probability `shares[s]`. The sds are above 0, the shares sum to 1.

    >>> mixture_quantiles([[0.0]], (1.0, 5.0), (1.0, 0.0), [0.5, 0.975]).round(4).tolist()
    [[-0.0, 1.96]]
    """

    centres = np.ascontiguousarray(np.atleast_2d(np.asarray(points, dtype=np.float64)))
    wanted = np.array(levels, dtype=np.float64)
    heard = [(sd, share) for sd, share in zip(sds, shares, strict=True) if share > 0.0]
    widths, weights = np.array(heard, dtype=np.float64).T.copy()
    return quantiles(centres, widths, weights, wanted)


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
