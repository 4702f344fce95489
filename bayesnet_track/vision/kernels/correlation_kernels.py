"""Compiled kernels of the correlation filter: products of spectra, and answers read at hypotheses."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints, Singles
from bayesnet_track.numerics.compiled import compiled, compiled_summing


@compiled
def cubic_weights(t: float, weights: Floats) -> None:
    """Fill `weights` (4,) of Catmull and Rom's cubic through four neighbours, `t` in 0..1 past the second."""
    weights[0] = ((-0.5 * t + 1.0) * t - 0.5) * t
    weights[1] = (1.5 * t - 2.5) * t * t + 1.0
    weights[2] = ((-1.5 * t + 2.0) * t + 0.5) * t
    weights[3] = (0.5 * t - 0.5) * t * t


@compiled_summing
def centre_spectra(every: Singles, turns: Singles, seen: Singles) -> None:
    """Write the spectra of C channels, each frequency turned by its phase, into `seen` (H, C, 4, H).

    Args:
        every: (C, F, F) as OpenCV packs spectra of real images, F even, H = F / 2 + 1: pairs of real and
            imaginary part lie along a row, in the first and in the last column along the column.
        turns: (H, 2, 2, H) cosine and sine of each phase, for vertical frequencies upward and downward.
        seen: [row, channel]: real and imaginary parts at the vertical frequency `row`, then at -`row`.
    """
    side = every.shape[1]
    last = side // 2
    for channel in range(len(every)):
        packed = every[channel]
        for j in range(last + 1):
            for sign in range(2):
                line = packed[j if sign == 0 or j == 0 else side - j]
                cosine, sine = turns[j, sign, 0], turns[j, sign, 1]
                real, imaginary = seen[j, channel, 2 * sign], seen[j, channel, 2 * sign + 1]
                for k in range(1, last):
                    real[k] = line[2 * k - 1] * cosine[k] - line[2 * k] * sine[k]
                for k in range(1, last):
                    imaginary[k] = line[2 * k - 1] * sine[k] + line[2 * k] * cosine[k]
                for k in (0, last):
                    column, other = min(2 * k, side - 1), np.float32(0.0)
                    one = packed[min(max(2 * j - 1, 0), side - 1), column]
                    if 0 < j < last:
                        other = packed[2 * j, column] if sign == 0 else -packed[2 * j, column]
                    real[k] = one * cosine[k] - other * sine[k]
                    imaginary[k] = one * sine[k] + other * cosine[k]


@compiled
def fill_halves(kernel: Singles, parts: Singles) -> None:
    """Write the even and odd part of a filter (C, S, S) by column and row into `parts` (2, 2, H, C, H)."""
    channels, side = kernel.shape[0], kernel.shape[1]
    for j in range(side // 2):
        for c in range(channels):
            above, below = kernel[c, j], kernel[c, side - 1 - j]
            for i in range(side // 2):
                k = side - 1 - i
                even_left, even_right = above[i] + below[i], above[k] + below[k]
                odd_left, odd_right = above[i] - below[i], above[k] - below[k]
                parts[0, 0, j, c, i], parts[1, 0, j, c, i] = even_left + even_right, even_left - even_right
                parts[0, 1, j, c, i], parts[1, 1, j, c, i] = odd_left + odd_right, odd_left - odd_right


@compiled_summing
def pack_row(sums: Singles, j: int, total: Singles) -> None:
    """Put the sums (4, H) of the vertical frequencies `j` and -`j` where OpenCV packs them in `total`."""
    side = total.shape[0]
    last = side // 2
    for k in range(1, last):
        total[j, 2 * k - 1] = sums[0, k]
        total[j, 2 * k] = sums[1, k]
    if 0 < j < last:
        for k in range(1, last):
            total[side - j, 2 * k - 1] = sums[2, k]
            total[side - j, 2 * k] = sums[3, k]
    for k in (0, last):
        column = min(2 * k, side - 1)
        total[min(max(2 * j - 1, 0), side - 1), column] = sums[0, k]
        if 0 < j < last:
            total[2 * j, column] = sums[1, k]


@compiled_summing
def conjugate_product(seen: Singles, waves: Singles, total: Singles) -> None:
    """Fill `total` (F, F), packed, with the sum over channels of a patch times a conjugate filter.

    Args:
        seen: (H, C, 4, H) spectra of the patch by `centre_spectra`.
        waves: (2, 2, H, C, H) of the filter: cosines (0) and sines (1) by column, then by row.
        total: (F, F), F = 2 H - 2.
    """
    rows, channels = seen.shape[0], seen.shape[1]
    sums = np.empty((4, rows), np.float32)
    for j in range(rows):
        sums[:] = np.float32(0.0)
        for c in range(channels):
            even, across = waves[0, 0, j, c], waves[1, 0, j, c]
            down, both = waves[0, 1, j, c], waves[1, 1, j, c]
            patch = seen[j, c]
            for k in range(rows):
                real, imaginary = even[k] - both[k], -down[k] - across[k]
                sums[0, k] += patch[0, k] * real + patch[1, k] * imaginary
                sums[1, k] += patch[1, k] * real - patch[0, k] * imaginary
                real, imaginary = even[k] + both[k], down[k] - across[k]
                sums[2, k] += patch[2, k] * real + patch[3, k] * imaginary
                sums[3, k] += patch[3, k] * real - patch[2, k] * imaginary
        pack_row(sums, j, total)


@compiled
def read_answers(
    maps: Singles,
    lowest: int,
    boxes: Floats,
    tile: tuple[float, float, float],
    which: Ints,
    levels: Floats,
    shares: Floats,
    answers: Floats,
) -> None:
    """Add the answers at the M hypotheses `which` to `answers` (N,): bicubic, linear between levels.

    Args:
        maps: (L, V, V) float32, V >= 4, a map per level of scale.
        lowest: level of the first map.
        boxes: (N, 4) centre boxes, px; where not all neighbours are known, the nearest place is read.
        tile: x and y of the place in the middle of the maps, and the side of a cell, px.
        which: (M,) indices of hypotheses.
        levels: (M,) from `lowest` to `lowest` + L - 1, where there is a share.
        shares: (M,) factors on the answers; those with 0 are not read.
        answers: (N,) added to.
    """
    across, down = np.empty(4), np.empty(4)
    bound, middle = maps.shape[1] - 3, 0.5 * (maps.shape[1] - 1)
    for m in range(len(which)):
        if shares[m] == 0.0:
            continue
        n = which[m]
        x, y = (boxes[n, 0] - tile[0]) / tile[2] + middle, (boxes[n, 1] - tile[1]) / tile[2] + middle
        i = min(max(int(np.floor(x)), 1), bound)
        j = min(max(int(np.floor(y)), 1), bound)
        cubic_weights(min(max(x - i, 0.0), 1.0), across)
        cubic_weights(min(max(y - j, 0.0), 1.0), down)
        below = int(np.floor(levels[m]))
        part = levels[m] - below
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
        answers[n] += shares[m] * total
