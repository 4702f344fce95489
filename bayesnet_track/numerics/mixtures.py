"""Mixtures of Gaussians of one dimension: their quantiles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from bayesnet_track.numerics.arrays import Floats


def mixture_quantiles(
    points: ArrayLike, sds: Sequence[float], shares: Sequence[float], levels: ArrayLike
) -> Floats:
    """(K, L) values with (L,) `levels` of the mass below them, for K mixtures.

    A mixture is its (K, M) equally probable points, each blurred by a Gaussian: of sd `sds[s]` with
    probability `shares[s]`. The sds are above 0, the shares sum to 1.

    >>> mixture_quantiles([[0.0]], (1.0, 5.0), (1.0, 0.0), [0.5, 0.975]).round(4).tolist()
    [[-0.0, 1.96]]
    """
    from bayesnet_track.numerics.kernels.mixture_kernels import quantiles

    centres = np.ascontiguousarray(np.atleast_2d(np.asarray(points, dtype=np.float64)))
    wanted = np.array(levels, dtype=np.float64)
    heard = [(sd, share) for sd, share in zip(sds, shares, strict=True) if share > 0.0]
    widths, weights = np.array(heard, dtype=np.float64).T.copy()
    return quantiles(centres, widths, weights, wanted)
