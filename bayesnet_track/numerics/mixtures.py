"""Mixtures of Gaussians of one dimension: their quantiles."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bayesnet_track.numerics.arrays import Floats


def mixture_quantiles(
    points: ArrayLike, sds: tuple[float, float], shares: tuple[float, float], levels: ArrayLike
) -> Floats:
    """(K, L) values with (L,) `levels` of the mass below them, for K mixtures.

    A mixture is its (K, M) equally probable points, each blurred by a Gaussian: of sd `sds[0]` with
    probability `shares[0]`, of `sds[1]` with `shares[1]`. The sds are above 0.

    >>> mixture_quantiles([[0.0]], (1.0, 5.0), (1.0, 0.0), [0.5, 0.975]).round(4).tolist()
    [[-0.0, 1.96]]
    """
    from bayesnet_track.numerics.kernels.mixture_kernels import quantiles

    centres = np.ascontiguousarray(np.atleast_2d(np.asarray(points, dtype=np.float64)))
    wanted = np.array(levels, dtype=np.float64)
    return quantiles(centres, float(sds[0]), float(sds[1]), float(shares[0]), float(shares[1]), wanted)
