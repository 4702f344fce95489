"""Feature planes of colour: hue, and hue in bins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.planes import FramePair, Plane, Region


@dataclass(frozen=True)
class Hue:
    """Hue of each pixel, (rows, columns) int16: 0..255 round the circle, or -1 where there is no colour.

    Attributes:
        min_chroma: pixels whose largest and smallest channel differ by less than this (of 255, at least 1)
            have no colour: their hue is noise.
        median_px: side of the median filter on each channel before hue is taken: 1 (none), 3 or 5.
    """

    min_chroma: int = 30
    median_px: int = 1
    inputs: ClassVar[tuple[Plane, ...]] = ()
    is_points: ClassVar[bool] = False

    @property
    def margin(self) -> int:
        """Half the median filter."""
        return self.median_px // 2

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """Hue on `region`."""
        from bayesnet_track.vision.kernels.color_kernels import hue_of_bgr

        frame = frames.current
        if self.margin == 0 or region.is_empty:
            return hue_of_bgr(region.of(frame.image), self.min_chroma)
        import cv2

        wide = region.grown(self.margin).within(frame)
        smooth = cv2.medianBlur(np.ascontiguousarray(wide.of(frame.image)), self.median_px)
        left, top = region.x0 - wide.x0, region.y0 - wide.y0
        inner = Region(left, top, left + region.x1 - region.x0, top + region.y1 - region.y0)
        return hue_of_bgr(inner.of(smooth), self.min_chroma)


@dataclass(frozen=True)
class HueBins:
    """Hue in equal bins, (rows, columns) uint8: 0..bins-1, or `bins` where there is no colour.

    Attributes:
        bins: number of bins round the circle, at most 128.
        min_chroma: as in `Hue`.
    """

    bins: int = 32
    min_chroma: int = 30
    margin: ClassVar[int] = 0
    is_points: ClassVar[bool] = False

    @property
    def inputs(self) -> tuple[Plane, ...]:
        """Hue."""
        return (Hue(self.min_chroma),)

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """Bins on `region`."""
        from bayesnet_track.vision.kernels.color_kernels import bins_of_hue

        bin_of_hue = np.append(np.arange(256) * self.bins // 256, self.bins).astype(np.uint8)
        return bins_of_hue(np.ascontiguousarray(inputs[0]), bin_of_hue)
