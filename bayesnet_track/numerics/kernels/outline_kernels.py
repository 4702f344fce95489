"""Compiled outlines of upright ellipsoids in images without distortion: boxes and their derivatives."""

from __future__ import annotations

import math

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled


@compiled
def straight_outlines(axes: Floats, origin: Floats, ground: Floats) -> tuple[Floats, Floats]:
    """Boxes (N, 4) of targets (N, 4) by a projection [axes origin] to pixels, and derivatives (N, 4, 4).

    As of `numerics.outlines`, whose lens is none: nan in a whole row where a target is not entirely in front
    of the camera.
    """
    count = ground.shape[0]
    boxes, slopes = np.empty((count, 4)), np.empty((count, 4, 4))
    centre, halves, tangent_axes = np.empty(3), np.empty(3), np.empty(3)
    bounds, moves = np.empty((2, 2)), np.empty((2, 2, 4))
    for n in range(count):
        width, height = ground[n, 2], ground[n, 3]
        halves[0] = halves[1] = abs(width) / 2
        halves[2] = abs(height) / 2
        reached = 0.0
        for i in range(3):
            centre[i] = origin[i] + axes[i, 0] * ground[n, 0] + axes[i, 1] * ground[n, 1]
            centre[i] += axes[i, 2] * height / 2
        for k in range(3):
            reached += (halves[k] * axes[2, k]) ** 2
        is_seen = centre[2] > math.sqrt(reached)
        for b in range(2):
            # s_k^2 (a_k - d g_k)^2 = (p - d q)^2 with d = x or y, a its row of the axes, g the depth's
            along = square = 0.0
            middle = centre[b] / centre[2] if is_seen else 0.0
            for k in range(3):
                centred_axis = axes[b, k] - middle * axes[2, k]
                along += halves[k] ** 2 * centred_axis * axes[2, k]
                square += halves[k] ** 2 * centred_axis**2
            depth_term = reached - centre[2] ** 2
            discriminant = along * along - square * depth_term
            is_seen = is_seen and discriminant >= 0.0
            for side in range(2):
                sign = -1.0 if side == 0 else 1.0
                offset = (along - sign * math.sqrt(max(discriminant, 0.0))) / depth_term if is_seen else 0.0
                double_depth = (along - offset * depth_term) * 2.0
                bounds[b, side] = middle + offset
                for k in range(3):
                    tangent_axes[k] = axes[b, k] - (middle + offset) * axes[2, k]
                p = -offset * centre[2]
                if is_seen and double_depth != 0.0:
                    moves[b, side, 0] = -2.0 * p * tangent_axes[0] / double_depth
                    moves[b, side, 1] = -2.0 * p * tangent_axes[1] / double_depth
                    moves[b, side, 2] = (
                        width / 2 * (tangent_axes[0] ** 2 + tangent_axes[1] ** 2) / double_depth
                    )
                    moves[b, side, 3] = (
                        height / 2 * tangent_axes[2] ** 2 - p * tangent_axes[2]
                    ) / double_depth
                else:
                    moves[b, side] = math.nan
        for b in range(2):
            boxes[n, b] = (bounds[b, 0] + bounds[b, 1]) / 2 if is_seen else math.nan
            boxes[n, b + 2] = bounds[b, 1] - bounds[b, 0] if is_seen else math.nan
            for j in range(4):
                slopes[n, b, j] = (moves[b, 0, j] + moves[b, 1, j]) / 2 if is_seen else math.nan
                slopes[n, b + 2, j] = moves[b, 1, j] - moves[b, 0, j] if is_seen else math.nan
    return boxes, slopes
