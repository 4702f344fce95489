"""Tiles of a frame in which a correlation filter is looked for, and its answers there, while the frame lives.

A target that is searched for is asked about the same tiles several times in a frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from weakref import WeakKeyDictionary

import numpy as np

from bayesnet_track.numerics.arrays import Bytes, Singles
from bayesnet_track.observation.planes import Frame
from bayesnet_track.vision.correlation import halves, scaled_answers, tile_spectra
from bayesnet_track.vision.planes.correlation_patches import patch_at, turned_features

SCALE_STEP = 0.08
"""Between levels of scale, in the logarithm."""
TURN_STEP = 15.0
"""Between levels of rotation, degrees."""


@dataclass(eq=False)
class Tile:
    """A square of a frame.

    Attributes:
        x: column of its centre, frame px; likewise `y`.
        cell: side of a cell, frame px.
        spectra: of its features, by `tile_spectra`.
        maps: (level of turn, level of scale) -> (V, V) answers of the filter `kernel`.
        kernel: the filter that was last looked for.
    """

    x: float
    y: float
    cell: float
    spectra: Singles
    maps: dict[tuple[int, int], Singles] = field(default_factory=dict)
    kernel: Singles | None = None


@dataclass(frozen=True)
class Asked:
    """Where a tile is, and for which filters.

    Attributes:
        x: column of its centre, frame px; likewise `y`.
        cell: side of a cell, frame px, about.
        around: side of the tile, cells.
        side: that of the filters, cells.
        signed: whether gradients have their sign.
    """

    x: float
    y: float
    cell: float
    around: int
    side: int
    signed: bool


_OF_FRAME: WeakKeyDictionary[Frame, dict[Asked, Tile]] = WeakKeyDictionary()


def find_tile(frame: Frame, image: Bytes, asked: Asked) -> Tile:
    """The tile of the frame, whose (H, W, 3) BGR `image` is read when it is asked for the first time."""
    tiles = _OF_FRAME.setdefault(frame, {})
    if asked not in tiles:
        patch = patch_at(image, asked.x, asked.y, asked.cell, asked.around, asked.signed)
        tiles[asked] = Tile(patch.x, patch.y, patch.cell, tile_spectra(patch.features, asked.side))
    return tiles[asked]


def find_maps(tile: Tile, kernel: Singles, turn: int, levels: range, parts: dict[int, Singles]) -> Singles:
    """(L, V, V) answers to a tile of a filter (C, S, S) at levels of scale; one array is one filter.

    `parts` are its halves by level of turn, to which those are added that were needed.
    """
    if tile.kernel is not kernel:
        tile.kernel, tile.maps = kernel, {}
    for level in levels:
        if (turn, level) not in tile.maps:
            if turn not in parts:
                parts[turn] = halves(turned_features(kernel, TURN_STEP * turn) if turn else kernel)
            scale = float(np.exp(SCALE_STEP * level))
            tile.maps[turn, level] = scaled_answers(tile.spectra, parts[turn], scale)
    return np.array([tile.maps[turn, level] for level in levels])
