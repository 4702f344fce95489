"""Compiled kernels for histograms of oriented gradients over square cells.

After Dalal and Triggs (2005) and Felzenszwalb et al. (2010), without an arctangent: a gradient votes for each
orientation by the fourth power of its cosine, which needs scalar products only. The powers sum to the same
for every direction. Votes are shared between the nearest cells.
"""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Bytes, Singles
from bayesnet_track.numerics.compiled import compiled

CELL = 4
"""Side of a cell, px."""
TRUNCATED = np.float32(0.2)
"""Largest value of a cell: one strong edge must not decide alone."""


@compiled
def oriented_gradients(gray: Bytes, half: int, histograms: Singles) -> None:
    """Add up magnitudes of gradients by cell and orientation.

    Args:
        gray: (4 R, 4 K) uint8, C order.
        half: orientations of half a circle, at least 3.
        histograms: (R, K, N) float32, filled. With N = 2 `half` those of the full circle, k + `half` points
            away from k; with N = `half` both count alike. The first and last column are 0, the first and
            last row hold their own votes only: take them as a rim.
    """
    height, width = gray.shape
    rows, columns, count = histograms.shape
    share = np.array([0.625, 0.875, 0.875, 0.625], np.float32)  # of the own cell; the rest is the neighbour's
    directions = np.empty((half, 2), np.float32)
    for k in range(half):
        directions[k, 0], directions[k, 1] = np.cos(np.pi * k / half), np.sin(np.pi * k / half)
    pooled = np.zeros((rows, count, width), np.float32)
    gx, gy, per = np.zeros(width, np.float32), np.zeros(width, np.float32), np.zeros(width, np.float32)
    for y in range(1, height - 1):
        above, here, below = gray[y - 1], gray[y], gray[y + 1]
        for x in range(1, width - 1):
            a = np.float32(here[x + 1]) - np.float32(here[x - 1])
            b = np.float32(below[x]) - np.float32(above[x])
            energy = a * a + b * b + np.float32(1e-6)
            gx[x] = a
            gy[x] = b
            per[x] = np.float32(1.0) / (energy * np.sqrt(energy))
        own = y // 4
        other = own - 1 if y % 4 < 2 else own + 1
        mine, theirs = share[y % 4], np.float32(1.0) - share[y % 4]
        if other < 0 or other >= rows:
            other, theirs = own, np.float32(0.0)
        for k in range(half):
            across, down = directions[k, 0], directions[k, 1]
            if count == half:
                alike, alike_beside = pooled[own, k], pooled[other, k]
                for x in range(width):
                    dot = across * gx[x] + down * gy[x]
                    square = dot * dot
                    vote = square * square * per[x]
                    alike[x] += mine * vote
                    alike_beside[x] += theirs * vote
                continue
            plus, minus = pooled[own, k], pooled[own, k + half]
            plus_beside, minus_beside = pooled[other, k], pooled[other, k + half]
            for x in range(width):  # without branches, so that it becomes vector instructions
                dot = across * gx[x] + down * gy[x]
                square = dot * dot
                vote = square * square * per[x]
                with_it = vote if dot > 0 else np.float32(0.0)
                against = vote - with_it
                plus[x] += mine * with_it
                minus[x] += mine * against
                plus_beside[x] += theirs * with_it
                minus_beside[x] += theirs * against
    for j in range(rows):
        for k in range(count):
            line = pooled[j, k]
            for i in range(1, columns - 1):
                x = 4 * i
                histograms[j, i, k] = (
                    np.float32(0.125) * (line[x - 2] + line[x + 5])
                    + np.float32(0.375) * (line[x - 1] + line[x + 4])
                    + np.float32(0.625) * (line[x] + line[x + 3])
                    + np.float32(0.875) * (line[x + 1] + line[x + 2])
                )
            histograms[j, 0, k] = histograms[j, columns - 1, k] = np.float32(0.0)


@compiled
def normalised_cells(histograms: Singles, half: int, noise: float, features: Singles) -> None:
    """Fill the first channels of `features` with cells relative to the root of the energy around them.

    Args:
        histograms: (R + 2, K + 2, N) float32 of `oriented_gradients`, which says N; likewise `half`.
        noise: energy that is added, so that the grain of flat places does not become a pattern.
        features: (C, R, K) float32: with N = 2 `half` first N channels in which light to dark differs from
            dark to light; then `half` in which it does not.
    """
    rows, columns, count = features.shape[1], features.shape[2], histograms.shape[2]
    energy = np.empty((rows + 2, columns + 2), np.float32)
    for j in range(rows + 2):
        for i in range(columns + 2):
            total = np.float32(0.0)
            for k in range(half):
                both = histograms[j, i, k]
                if count > half:
                    both += histograms[j, i, k + half]
                total += both * both
            energy[j, i] = total
    scale = np.empty(columns, np.float32)
    quarter, middle = np.float32(0.25), np.float32(0.5)
    for j in range(rows):
        above, own, below = energy[j], energy[j + 1], energy[j + 2]
        for i in range(columns):
            around = np.float32(noise) + quarter * above[i] + middle * above[i + 1] + quarter * above[i + 2]
            around += middle * own[i]
            around += own[i + 1]
            around += middle * own[i + 2]
            around += quarter * below[i]
            around += middle * below[i + 1]
            around += quarter * below[i + 2]
            scale[i] = np.float32(1.0) / np.sqrt(around)
        for k in range(half):
            for i in range(columns):
                one = histograms[j + 1, i + 1, k] * scale[i]
                if count == half:
                    features[k, j, i] = min(one, TRUNCATED)
                    continue
                other = histograms[j + 1, i + 1, k + half] * scale[i]
                features[k, j, i] = min(one, TRUNCATED)
                features[k + half, j, i] = min(other, TRUNCATED)
                features[k + count, j, i] = min(one + other, TRUNCATED)


@compiled
def cell_means(pixels: Bytes, means: Bytes) -> None:
    """Fill `means` (R, 3 K) uint8 with the means over cells of `pixels` (4 R, 12 K), three channels a pixel.

    Rounded to the nearest, halves to the even one, as OpenCV does.
    """
    width = pixels.shape[1]
    sums = np.empty(width, np.int32)
    for j in range(means.shape[0]):
        a, b, c, d = pixels[4 * j], pixels[4 * j + 1], pixels[4 * j + 2], pixels[4 * j + 3]
        for x in range(width):
            sums[x] = np.int32(a[x]) + np.int32(b[x]) + np.int32(c[x]) + np.int32(d[x])
        for i in range(width // 12):
            for channel in range(3):
                x = 12 * i + channel
                total = sums[x] + sums[x + 3] + sums[x + 6] + sums[x + 9]
                means[j, 3 * i + channel] = (total + 7 + ((total >> 4) & 1)) >> 4
