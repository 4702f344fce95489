"""The edge plane: Canny's edges of the frame as a list of points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.planes import FramePair, Plane, Region
from bayesnet_track.vision.planes.gray_plane import GrayPlane

SOBEL = 8.0
"""What a 3x3 Sobel filter makes of a slope of one gray level per pixel."""

CONTRASTS = (1.0, 0.5, 2.0)
"""The thresholds of the three edge sets, as factors of the plane's own; the first is used at first."""


@dataclass(frozen=True)
class EdgePlane:
    """Canny's edges of the whole frame: (points, 3) int64 x, y, bits, ordered by row, then column.

    Bit k of `bits` is set where the pixel is an edge at the threshold ``min_gradient_gray * CONTRASTS[k]``.
    An edge starts at that gradient and goes on down to half of it. Always the whole frame, because an edge
    may go on as far as it likes.

    Attributes:
        min_gradient_gray: gradient at which an edge starts, gray levels per pixel.
        blur_px: standard deviation of the Gaussian that smooths the picture first; 0 for none.
    """

    min_gradient_gray: float = 8.0
    blur_px: float = 1.0
    margin: ClassVar[None] = None
    is_points: ClassVar[bool] = True

    @property
    def inputs(self) -> tuple[Plane, ...]:
        """Made from the brightness."""
        return (GrayPlane(),)

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """The edge points of the frame."""
        import cv2

        smooth = np.ascontiguousarray(inputs[0])
        if self.blur_px > 0:
            smooth = cv2.GaussianBlur(smooth, (0, 0), self.blur_px)
        dx, dy = (
            cv2.Sobel(smooth, cv2.CV_16S, *order, borderType=cv2.BORDER_REPLICATE)
            for order in ((1, 0), (0, 1))
        )
        bits = np.zeros(smooth.shape, dtype=np.uint8)
        for k, factor in enumerate(CONTRASTS):
            high = SOBEL * factor * self.min_gradient_gray
            bits |= cv2.Canny(dx, dy, 0.5 * high, high, L2gradient=True) & np.uint8(1 << k)
        found = cv2.findNonZero(bits)
        if found is None:
            return np.empty((0, 3), dtype=np.int64)
        points = found.reshape(-1, 2).astype(np.int64)
        return np.column_stack([points, bits[points[:, 1], points[:, 0]]])
