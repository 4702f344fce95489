"""The plane of colour cells: which cell of a coarse colour cube each pixel lies in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Array, Floats
from bayesnet_track.observation.geometry import crop_of
from bayesnet_track.observation.planes import FramePair, Plane, Planes, Region, region_of_boxes
from bayesnet_track.observation.shared import for_reading


@dataclass(frozen=True)
class ColorCells:
    """Cell of each pixel, (rows, columns) uint16.

    Attributes:
        space: `rgb`, `levels` values of each channel; or `hsv`, `levels` hues and saturations, half as many
            values (the chapter's 8 x 8 x 8 and 8 x 8 x 4).
        levels: 2 .. 16, even.
    """

    space: Literal["rgb", "hsv"] = "rgb"
    levels: int = 8
    margin: ClassVar[int] = 0
    inputs: ClassVar[tuple[Plane, ...]] = ()
    is_points: ClassVar[bool] = False

    @property
    def size(self) -> int:
        """Number of cells."""
        return self.levels**3 if self.space == "rgb" else self.levels**3 // 2

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """Cells on `region`."""
        image = region.of(frames.current.image)
        if image.size == 0:
            return np.zeros(image.shape[:2], np.uint16)
        # Imported here: a graph is validated without compiling anything.
        from bayesnet_track.vision.kernels.color_kernels import fill_color_cells

        last = self.levels
        if self.space == "hsv":
            import cv2

            image, last = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_BGR2HSV_FULL), self.levels // 2
        cells: NDArray[np.uint16] = fill_color_cells(for_reading(image), _layout(self.levels, last))
        return cells


@lru_cache(maxsize=8)
def _layout(levels: int, last: int) -> NDArray[np.uint16]:
    """(2, 3) levels of each channel, `last` of the third, and what one of them adds to a cell's number."""
    layout = np.array([[levels, levels, last], [levels * last, last, 1]], np.uint16)
    layout.setflags(write=False)  # shared by all who ask for it
    return layout


def seen_cells(planes: Planes, plane: Plane, boxes: Floats) -> tuple[Array, Floats]:
    """The cells inside `boxes` (N, 4), whatever else was computed, and the x, y of their first pixel."""
    cells, first = crop_of(planes, plane, region_of_boxes(boxes).within(planes.frame))
    return for_reading(cells), np.array(first, dtype=np.float64)
