"""Compiled kernel of patch matching: how well a point's patch fits at every displacement."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Bytes, Floats, Ints
from bayesnet_track.numerics.compiled import compiled


@compiled
def match_patches(
    image: Bytes, origin: Ints, points: Ints, patches: Floats, across: Ints, down: Ints, squares: Floats
) -> None:
    """Fill `squares` (N, K, K) with mean squared differences of `patches` (N, P, P) to the image.

    Entry [n, j, i] is at the point (x, y) displaced by (across[i], down[j]); infinity where the patch leaves
    the image, whose first pixel is at `origin` (x, y).
    """
    side = patches.shape[1]
    half = side // 2
    rows, columns = image.shape
    for n in range(points.shape[0]):
        for j in range(down.shape[0]):
            top = points[n, 1] + down[j] - origin[1] - half
            for i in range(across.shape[0]):
                left = points[n, 0] + across[i] - origin[0] - half
                if top < 0 or left < 0 or top + side > rows or left + side > columns:
                    squares[n, j, i] = np.inf
                    continue
                total = 0.0
                for y in range(side):
                    for x in range(side):
                        away = patches[n, y, x] - np.float64(image[top + y, left + x])
                        total += away * away
                squares[n, j, i] = total / (side * side)
