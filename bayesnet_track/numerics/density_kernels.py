"""Compiled sums of Gaussians at many points: fast with a bounded error, or to floating-point accuracy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.compiled import compiled

Floats = NDArray[np.float64]

FAST_ERROR = 4e-7
"""Largest error of `fast_sums`, as a share of the sum of peaks: exp(-x) is taken to be the 32nd power of the
fourth-order series at x / 32, whose error is about max x^5 e^-x / (32^4 5!) = 1.7e-7."""

_BLOCK = 256


@compiled
def fast_sums(points: Floats, peaks: Floats, means: Floats, precisions: Floats) -> Floats:
    """(M,) sum_n peaks_n exp(-|(point - means_n) precisions_n|^2 / 2), within `FAST_ERROR`.

    `points` is (K, M), one row per dimension: the inner loops run over points, so that the compiler can use
    vector instructions without leave to reorder a sum. Two dimensions a turn: K is even (add a row of zeros).
    peaks (N,), means and precisions (1 / sd) (N, K).
    """
    size, count = points.shape
    sums = np.zeros(count)
    y = np.empty(_BLOCK)
    for first in range(0, count, _BLOCK):
        width = min(_BLOCK, count - first)
        block = sums[first : first + width]
        for n in range(peaks.shape[0]):
            peak = peaks[n]
            for m in range(width):
                y[m] = 0.0
            for k in range(0, size, 2):
                row, other = points[k, first : first + width], points[k + 1, first : first + width]
                mean, scale = means[n, k], precisions[n, k] / 8.0
                other_mean, other_scale = means[n, k + 1], precisions[n, k + 1] / 8.0
                for m in range(width):
                    away, other_away = (row[m] - mean) * scale, (other[m] - other_mean) * other_scale
                    y[m] += away * away + other_away * other_away
            for m in range(width):
                t = min(y[m], 0.6)  # beyond, exp(-32 * 0.6) is below the error
                e = 1.0 - t * (1.0 - t * (1 / 2 - t * (1 / 6 - t * (1 / 24))))
                e *= e
                e *= e
                e *= e
                e *= e
                e *= e
                block[m] += peak * e
    return sums


@compiled
def exact_sums(points: Floats, peaks: Floats, means: Floats, precisions: Floats) -> Floats:
    """(M,) the same sums in full accuracy; `points` is (M, K)."""
    count, size = points.shape
    sums = np.zeros(count)
    for m in range(count):
        for n in range(peaks.shape[0]):
            square = 0.0
            for k in range(size):
                away = (points[m, k] - means[n, k]) * precisions[n, k]
                square += away * away
            sums[m] += peaks[n] * np.exp(-0.5 * square)
    return sums
