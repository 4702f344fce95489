"""Which colours are the target's and which its surroundings': histograms and the posterior of each colour."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Bytes, Floats
from bayesnet_track.numerics.compiled import plain
from bayesnet_track.observation.planes import Frame
from bayesnet_track.observation.shared import for_reading, read_only
from bayesnet_track.vision.kernels.foreground_kernels import (
    box_and_ring_means,
    color_posterior,
    count_cells,
    ring_shares,
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
    def layout(self) -> NDArray[np.uint16]:
        """(2, 3) levels of blue, green and red, and what one of each adds to a cell's number."""
        return _layout(self)


@cache
def _layout(cells: Cells) -> NDArray[np.uint16]:
    strides = (1, 0, 0) if cells.gray else (cells.levels**2, cells.levels, 1)
    return np.array([[cells.levels] * 3, strides], np.uint16)


KEPT = 64
"""Boxes of a frame whose counts are kept: many targets ask for more memory than they save time."""
_OF_FRAME: WeakKeyDictionary[Frame, dict[tuple[Cells, bytes], Floats]] = WeakKeyDictionary()


def count_pixels(frame: Frame, cells: Cells, boxes: Floats) -> Floats:
    """(K, cells) visible pixels of the centre boxes (K, 4) in each cell; each box holds the next.

    They are kept while the frame lives: an agent and a verifier learn in the same box.
    """
    known, asked = _OF_FRAME.setdefault(frame, {}), (cells, boxes.tobytes())
    counts = known.get(asked)
    if counts is None:
        filled = np.empty((len(boxes), cells.count))
        count_cells(for_reading(frame.image), cells.layout, plain(boxes), filled)
        counts = read_only(filled)
        if len(known) >= KEPT:
            known.clear()
        known[asked] = counts
    return counts


def shares_of(counts: Floats) -> Floats:
    """(3, cells) shares of colours in two boxes without what the third holds, and in the last one.

    `counts` (4, cells) are those of `count_pixels`; all 0 where nothing was counted.
    """
    filled = np.empty((3, counts.shape[1]))
    ring_shares(for_reading(counts), filled)
    return filled


def grow_boxes(boxes: Floats, ring: float) -> Floats:
    """Centre boxes (..., 4) with a ring of `ring` mean sides around them."""
    more = ring * (boxes[..., 2:3] + boxes[..., 3:4])
    return np.concatenate([boxes[..., :2], boxes[..., 2:] + more], axis=-1)


def means(frame: Frame, cells: Cells, levels: Bytes, boxes: Floats, ring: float) -> Floats:
    """(N, 2) mean posterior, 0..1, inside each centre box (N, 4) and in a ring of `ring` mean sides."""
    found = np.empty((len(boxes), 2))
    image = for_reading(frame.image)
    box_and_ring_means(image, cells.layout, for_reading(levels), plain(boxes), ring, found)
    return found / TOP


def posterior(shares: Mapping[str, Floats], memory: float, prior: float) -> Bytes:
    """(cells,) 0..TOP: probability of the target given a colour, f / (f + b).

    `shares` of the pixels are f in the `foreground`, and b in the `background` with the share `memory` of the
    `memory`. `prior` is that of a colour which none of them has; it counts as a share of `UNSEEN`.
    """
    f, b, old = (for_reading(shares[name]) for name in ("foreground", "background", "memory"))
    found = np.empty(len(f), np.uint8)
    color_posterior(f, b, old, memory, (prior * UNSEEN, UNSEEN), found)
    return found
