"""The gray plane: one brightness per pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.planes import FramePair, Plane, Region


@dataclass(frozen=True)
class GrayPlane:
    """Brightness (rows, columns) uint8: .299 R + .587 G + .114 B, rounded in fixed point.

    A gray source gives its own values back: the three weights sum to 1.
    """

    margin: ClassVar[int] = 0
    inputs: ClassVar[tuple[Plane, ...]] = ()
    is_points: ClassVar[bool] = False

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """(rows, columns) uint8 of the current frame on `region`."""
        return gray(region.of(frames.current.image))


def gray(image: Array) -> Array:
    """(H, W) uint8 brightness of an (H, W, 3) uint8 BGR image, which may be empty."""
    import cv2

    if image.size == 0:
        return np.zeros(image.shape[:2], dtype=np.uint8)
    converted: Array = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return converted
