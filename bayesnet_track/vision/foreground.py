"""Which colours are the target's and which its surroundings': histograms and the posterior of each colour."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Bytes, Floats
from bayesnet_track.observation.planes import Frame, region_of_boxes
from bayesnet_track.vision.kernels.foreground_kernels import (
    box_and_ring_means,
    count_cells,
    integral_of_cells,
)

TOP = 255
"""Level of a colour that is surely the target's."""
UNSEEN = 0.0005
"""Share of pixels below which the prior decides about a colour."""


@dataclass(frozen=True)
class Cells:
    """How pixels fall into cells.

    Attributes:
        levels: of each channel, or of gray.
        gray: the three channels are copies of one.
    """

    levels: int
    gray: bool

    @property
    def count(self) -> int:
        """Number of cells."""
        return self.levels if self.gray else self.levels**3

    @property
    def tables(self) -> NDArray[np.int32]:
        """(3, 256) each channel's part of a cell's number."""
        return _tables(self)


@cache
def _tables(cells: Cells) -> NDArray[np.int32]:
    value = np.arange(256, dtype=np.int32) * cells.levels // 256
    strides = (1, 0, 0) if cells.gray else (cells.levels**2, cells.levels, 1)
    return np.stack([value * stride for stride in strides]).astype(np.int32)


def count_pixels(frame: Frame, cells: Cells, box: Floats) -> Floats:
    """(cells,) visible pixels of the centre box (4,) in each cell."""
    counts = np.zeros(cells.count)
    count_cells(region_of_boxes(box[None]).within(frame).of(frame.image), cells.tables, counts)
    return counts


def shares(counts: Floats) -> Floats:
    """Counts divided by their sum; all 0 where nothing was counted."""
    return np.asarray(counts / max(counts.sum(), 1.0))


def grow_boxes(boxes: Floats, ring: float) -> Floats:
    """Centre boxes (..., 4) with a ring of `ring` mean sides around them."""
    more = ring * (boxes[..., 2:3] + boxes[..., 3:4])
    return np.concatenate([boxes[..., :2], boxes[..., 2:] + more], axis=-1)


def means(frame: Frame, cells: Cells, levels: Bytes, boxes: Floats, ring: float) -> Floats:
    """(N, 2) mean posterior, 0..1, inside each centre box (N, 4) and in a ring of `ring` mean sides."""
    boxes = np.ascontiguousarray(boxes, dtype=np.float64)
    crop = region_of_boxes(grow_boxes(boxes, ring)).grown(1).within(frame)
    found = np.zeros((len(boxes), 2))
    if crop.is_empty:
        return found
    image = crop.of(frame.image)
    integral = np.empty((image.shape[0] + 1, image.shape[1] + 1), np.int64)
    integral_of_cells(image, cells.tables, levels, integral)
    box_and_ring_means(integral, boxes, ring, crop.x0, crop.y0, frame.width, frame.height, found)
    return found / TOP


def posterior(foreground: Floats, background: Floats, prior: float) -> Bytes:
    """(cells,) 0..TOP: probability of the target given a colour, f / (f + b) for shares f and b.

    `prior` is that of a colour which neither has; it counts as a share of `UNSEEN`.
    """
    found = (foreground + prior * UNSEEN) / (foreground + background + UNSEEN)
    return np.asarray(np.rint(TOP * found), dtype=np.uint8)
