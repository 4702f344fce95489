"""Compiled kernel: which of many point pairs move together, by the similarities that pairs of them define."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Floats
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.numerics.resampling import copy_row


@compiled
def consensus(source: Floats, target: Floats, tolerance: float, apart: float, most: float) -> Bools:
    """(N,) True for the points that one translation or one similarity takes to within `tolerance` px.

    All are tried: the translation of every point, and the similarity of every two points at least `apart` px
    from each other that changes sizes by a factor of `most` at most. The one with the most points wins, not
    counting those that define it (1 or 2); of two equal ones that with the smaller squares. No randomness.
    """
    size = len(source)
    chosen, trial = np.zeros(size, np.bool_), np.zeros(size, np.bool_)
    best, least = -1, 0.0
    for i in range(size):
        for j in range(i, size):
            dx, dy = source[j, 0] - source[i, 0], source[j, 1] - source[i, 1]
            ex, ey = target[j, 0] - target[i, 0], target[j, 1] - target[i, 1]
            real, imaginary = 1.0, 0.0
            if j > i:
                away = dx * dx + dy * dy
                if away < apart * apart:
                    continue
                real, imaginary = (dx * ex + dy * ey) / away, (dx * ey - dy * ex) / away
                factor = np.sqrt(real * real + imaginary * imaginary)
                if not 1.0 / most <= factor <= most:
                    continue
            count, squares = (-2 if j > i else -1), 0.0
            for k in range(size):
                x, y = source[k, 0] - source[i, 0], source[k, 1] - source[i, 1]
                off_x = target[k, 0] - target[i, 0] - (real * x - imaginary * y)
                off_y = target[k, 1] - target[i, 1] - (imaginary * x + real * y)
                error = off_x * off_x + off_y * off_y
                trial[k] = error <= tolerance * tolerance
                if trial[k]:
                    count += 1
                    squares += error
            if count > best or (count == best and squares < least):
                best, least = count, squares
                copy_row(trial, chosen)
    return chosen
