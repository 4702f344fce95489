"""The plane of a pan: how far the whole picture moved, however fast it did."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.planes import FramePair, Plane, Region
from bayesnet_track.vision.planes.motion_planes import interval_of, smaller_gray

LEAST_RESPONSE = 0.1
"""Share of the correlation around its peak that a picture has at least which moved, and was not replaced."""


@dataclass(frozen=True)
class PanPlane:
    """Where most of the picture moved since the previous frame: (2,) float64 x, y, px.

    The peak of the phase correlation of the whole frames in gray, halved until no side exceeds 160 px. It
    follows moves of up to half the picture, which points that are tracked do not, and no turn or zoom. 0
    without a previous frame, where the peak holds less than LEAST_RESPONSE, as between different scenes, and
    in a picture so long that its other side shrinks to one pixel.
    """

    margin: ClassVar[None] = None
    inputs: ClassVar[tuple[Plane, ...]] = ()
    is_points: ClassVar[bool] = True

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """The shift, from the whole frames."""
        import cv2

        if frames.previous is None or not interval_of(frames) > 0:
            return np.zeros(2)
        (now, scale), (then, _) = smaller_gray(frames.current), smaller_gray(frames.previous)
        if min(now.width, now.height) < 2:
            return np.zeros(2)
        window = cv2.createHanningWindow((now.width, now.height), cv2.CV_32F)
        shift, clear = cv2.phaseCorrelate(then.image.astype(np.float32), now.image.astype(np.float32), window)
        if clear < LEAST_RESPONSE:
            return np.zeros(2)
        return np.asarray(shift, dtype=np.float64) * scale
