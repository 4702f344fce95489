"""Compiled kernel of a background model: a mixture of Gaussians at each pixel, with shadows told apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Singles
from bayesnet_track.numerics.compiled import compiled

BACKGROUND, SHADOW, FOREGROUND = 0, 64, 128
"""Evidence below `SHADOW` is background; from `FOREGROUND` on, a target, up to 255 the surer it is."""


@compiled
def update_mixture(
    image: NDArray[np.uint8],
    gain: float,
    rate: float,
    weights: Singles,
    means: Singles,
    variances: Singles,
    match: float,
    background_share: float,
    min_variance: float,
    first_variance: float,
    darkest: float,
    chroma: float,
    evidence: NDArray[np.uint8],
) -> None:
    """Compare each pixel with its background, then learn it; in place.

    Args:
        image: (H, W, 3) uint8 BGR.
        gain: the means are multiplied by it first (255 at most), to compare and not to learn.
        rate: share of this frame in what is learnt.
        weights: (H, W, K) of the modes, largest first; they sum to 1.
        means: (H, W, K, 3) gray levels.
        variances: (H, W, K) of each channel.
        match: a pixel belongs to a mode within this squared distance, in the mode's variances.
        background_share: modes are background until those before them have this weight together.
        min_variance, first_variance: lower bound, and what a new mode starts with.
        darkest: a shadow has at least this share of the background's brightness; 1 for no shadows.
        chroma: and differs in colour by this at most, mean square, gray levels squared.
        evidence: (H, W) is filled in.
    """
    rows, columns, modes = weights.shape
    value, seen = np.empty(3), np.empty(3)
    for y in range(rows):
        for x in range(columns):
            for c in range(3):
                value[c] = float(image[y, x, c])
            before, matched, is_background, nearest = 0.0, -1, False, np.inf
            for k in range(modes):
                weight = float(weights[y, x, k])
                if weight <= 0.0:
                    break
                away = 0.0
                for c in range(3):
                    away += (value[c] - min(gain * means[y, x, k, c], 255.0)) ** 2
                distance = away / variances[y, x, k]
                if before < background_share:
                    nearest = min(nearest, distance)
                if distance < match:
                    matched, is_background = k, before < background_share
                    break
                before += weight
            evidence[y, x] = BACKGROUND
            if not is_background:
                evidence[y, x] = min(128.0 * np.sqrt(max(nearest / match, 1.0)), 255.0)
                product, square = 0.0, 0.0
                for c in range(3):
                    seen[c] = min(gain * means[y, x, 0, c], 255.0)
                    product += value[c] * seen[c]
                    square += seen[c] * seen[c]
                ratio = product / max(square, 1.0)
                if darkest <= ratio < 1.0:
                    off = 0.0
                    for c in range(3):
                        off += (value[c] - ratio * seen[c]) ** 2
                    if off < 3.0 * chroma:
                        evidence[y, x] = SHADOW
            _learn(
                value,
                rate,
                matched,
                weights[y, x],
                means[y, x],
                variances[y, x],
                min_variance,
                first_variance,
            )


@compiled
def _learn(
    value: NDArray[np.float64],
    rate: float,
    matched: int,
    weights: Singles,
    means: Singles,
    variances: Singles,
    min_variance: float,
    first_variance: float,
) -> None:
    modes = weights.shape[0]
    k = matched
    if k < 0:  # a new mode instead of the weakest
        k = modes - 1
        weights[k] = 0.0
        for c in range(3):
            means[k, c] = value[c]
        variances[k] = first_variance
    total = 0.0
    for m in range(modes):
        weights[m] = weights[m] * (1.0 - rate) + (rate if m == k else 0.0)
        total += weights[m]
    for m in range(modes):
        weights[m] /= total
    if matched >= 0:
        own = min(rate / weights[k], 1.0)
        away = 0.0
        for c in range(3):
            step = value[c] - means[k, c]
            away += step * step
            means[k, c] += own * step
        # the part of the squared step that is scatter: with a share `own` of the new mean it is shorter
        variances[k] = max((1.0 - own) * (variances[k] + own * away / 3.0), min_variance)
    while k > 0 and weights[k] > weights[k - 1]:
        weights[k], weights[k - 1] = weights[k - 1], weights[k]
        variances[k], variances[k - 1] = variances[k - 1], variances[k]
        for c in range(3):
            means[k, c], means[k - 1, c] = means[k - 1, c], means[k, c]
        k -= 1
