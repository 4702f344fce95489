"""A stand-in for a Siamese network without model files: for trying out a graph, not for tracking."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Bytes, Floats, Singles
from bayesnet_track.vision.siamese.crops import context_side
from bayesnet_track.vision.siamese.networks import TEMPLATE, Networks, Response

CELL = 4
"""Side of the cells of `plain`, px of the network."""
CHANCE = 0.5
"""Correlations below this are chance: nothing is said to be there."""


def plain() -> Networks:
    """A stand-in without model files: correlation of the pixels in the template's middle."""
    import cv2

    def cells(crop: Bytes) -> Singles:
        side = len(crop) // CELL
        return np.asarray(cv2.resize(crop, (side, side), interpolation=cv2.INTER_AREA), np.float32)

    def describe(crop: Bytes) -> Singles:
        quarter = TEMPLATE // CELL // 4
        return np.ascontiguousarray(cells(crop)[quarter:-quarter, quarter:-quarter])

    def compare(template: Singles, crop: Bytes, size: Floats) -> Response:
        wanted = max(round(len(template) * context_side(size) / TEMPLATE), 2)
        if abs(wanted - len(template)) > 1:  # the crop is not at the template's scale
            template = np.asarray(cv2.resize(template, (wanted, wanted), interpolation=cv2.INTER_AREA))
        likeness = cv2.matchTemplate(cells(crop), template, cv2.TM_CCOEFF_NORMED)
        likeness = np.nan_to_num(np.asarray(likeness, np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        if np.ptp(template, axis=(0, 1)).max() < 1.0:  # OpenCV says 1 where both are flat
            likeness[:] = 0.0
        likeness[likeness < CHANCE] = 0.0
        sides = np.empty((4, *likeness.shape), np.float32)
        sides[:] = np.tile(size / 2, 2)[:, None, None]
        return Response(np.clip(likeness, 0.0, 1.0) ** 2, sides, CELL)

    return Networks(describe, compare)
