"""Compiled kernel: quantiles of mixtures of Gaussians by halving."""

from __future__ import annotations

import math

import numpy as np

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
