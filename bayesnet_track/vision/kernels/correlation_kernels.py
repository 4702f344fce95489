"""Compiled kernels of the correlation filter: resized filters, and answers read at hypotheses."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints, Singles
from bayesnet_track.numerics.compiled import compiled


@compiled
def cubic_weights(t: float, weights: Floats) -> None:
    """Fill `weights` (4,) of Catmull and Rom's cubic through four neighbours, `t` in 0..1 past the second."""
    weights[0] = ((-0.5 * t + 1.0) * t - 0.5) * t
    weights[1] = (1.5 * t - 2.5) * t * t + 1.0
    weights[2] = ((-1.5 * t + 2.0) * t + 0.5) * t
    weights[3] = (0.5 * t - 0.5) * t * t


@compiled
def resized_filter(source: Singles, scale: float, target: Singles) -> None:
    """Fill `target` (C, F, F) with `source` (C, S, S) enlarged by `scale` about its middle, zeros elsewhere.

    The first S rows and columns hold it; what no longer fits is cut off. Bicubic; divided by the square of
    the scale, so that a smooth filter's sum stays.
    """
    channels, side = source.shape[0], source.shape[1]
    middle = 0.5 * (side - 1)
    first, weights = np.empty(side, np.int64), np.zeros((side, 4), np.float32)
    exact = np.empty(4)
    for i in range(side):
        place = (i - middle) / scale + middle
        below = int(np.floor(place))
        cubic_weights(place - below, exact)
        first[i] = min(max(below - 1, 0), side - 4)
        for a in range(4):  # beyond the source there is nothing
            tap = below - 1 + a - first[i]
            if 0 <= tap < 4:
                weights[i, tap] = exact[a] / scale
    lines = np.empty((side, side), np.float32)
    target[:] = 0.0
    for c in range(channels):
        for j in range(side):
            at, w = first[j], weights[j]
            a, b, d, e = source[c, at], source[c, at + 1], source[c, at + 2], source[c, at + 3]
            for i in range(side):
                lines[j, i] = w[0] * a[i] + w[1] * b[i] + w[2] * d[i] + w[3] * e[i]
        for j in range(side):
            line = lines[j]
            for i in range(side):
                at, w = first[i], weights[i]
                target[c, j, i] = (
                    w[0] * line[at] + w[1] * line[at + 1] + w[2] * line[at + 2] + w[3] * line[at + 3]
                )


@compiled
def read_answers(
    maps: Singles, lowest: int, columns: Floats, rows: Floats, levels: Floats, which: Ints, answers: Floats
) -> None:
    """Write the answer at each hypothesis of `which` into `answers` (N,): bicubic, linear between levels.

    Args:
        maps: (L, V, V) float32, V >= 4, a map per level of scale.
        lowest: level of the first map.
        columns: (N,) places in the maps, cells, kept to where all neighbours are known; likewise `rows`.
        levels: (N,), those of `which` from `lowest` to `lowest` + L - 1.
    """
    across, down = np.empty(4), np.empty(4)
    bound = maps.shape[1] - 3
    for n in which:
        i = min(max(int(np.floor(columns[n])), 1), bound)
        j = min(max(int(np.floor(rows[n])), 1), bound)
        cubic_weights(min(max(columns[n] - i, 0.0), 1.0), across)
        cubic_weights(min(max(rows[n] - j, 0.0), 1.0), down)
        below = int(np.floor(levels[n]))
        part = levels[n] - below
        total = 0.0
        for step in range(2):
            weight = part if step == 1 else 1.0 - part
            if weight == 0.0:
                continue
            one = maps[below + step - lowest]
            for b in range(4):
                line = 0.0
                for a in range(4):
                    line += across[a] * one[j + b - 1, i + a - 1]
                total += weight * down[b] * line
        answers[n] = total


@compiled
def add_product(one: Singles, other: Singles, total: Singles) -> None:
    """Add the product of the spectra `one` and conj(`other`) to `total`, each (F, F) with even F.

    Packed as OpenCV packs spectra of real images: pairs of real and imaginary part lie along a row, in the
    first and in the last column along the column. Products are taken in double precision, as OpenCV does.
    """
    side = one.shape[0]
    pairs = side // 2 - 1
    for j in range(side):
        a, b, sums = one[j], other[j], total[j]
        for k in range(pairs):
            i = 2 * k + 1
            a_re, a_im = np.float64(a[i]), np.float64(a[i + 1])
            b_re, b_im = np.float64(b[i]), np.float64(b[i + 1])
            sums[i] += np.float32(a_re * b_re + a_im * b_im)
            sums[i + 1] += np.float32(a_im * b_re - a_re * b_im)
    for i in (0, side - 1):
        for j in (0, side - 1):
            total[j, i] += one[j, i] * other[j, i]
        for k in range(pairs):
            j = 2 * k + 1
            a_re, a_im = np.float64(one[j, i]), np.float64(one[j + 1, i])
            b_re, b_im = np.float64(other[j, i]), np.float64(other[j + 1, i])
            total[j, i] += np.float32(a_re * b_re + a_im * b_im)
            total[j + 1, i] += np.float32(a_im * b_re - a_re * b_im)
