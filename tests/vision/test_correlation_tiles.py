"""Tiles are made once a frame, forgotten with it, and hold the answers of one filter."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest

from bayesnet_track.observation.planes import Frame
from bayesnet_track.vision import correlation
from bayesnet_track.vision.correlation import TileKey, find_maps, find_tile

ASKED = TileKey(60.0, 40.0, 1.5, 32, 16, False)


def frame(seed: int) -> Frame:
    return Frame(0, 0.0, np.random.default_rng(seed).integers(0, 256, (90, 120, 3), dtype=np.uint8))


def test_a_tile_is_made_once_a_frame():
    one, other = frame(1), frame(2)
    tile = find_tile(one, one.image, ASKED)
    assert find_tile(one, one.image, TileKey(60.0, 40.0, 1.5, 32, 16, False)) is tile
    for asked in (TileKey(61.0, 40.0, 1.5, 32, 16, False), TileKey(60.0, 40.0, 1.5, 32, 16, True)):
        assert find_tile(one, one.image, asked) is not tile
    assert not np.array_equal(find_tile(other, other.image, ASKED).spectra, tile.spectra)


@pytest.mark.slow
def test_tiles_are_forgotten_with_their_frame():
    one = frame(1)
    tile, before = weakref.ref(find_tile(one, one.image, ASKED)), len(correlation._OF_FRAME)
    del one
    gc.collect()
    assert tile() is None and len(correlation._OF_FRAME) < before


def test_answers_of_another_filter_are_forgotten():
    one, rng = frame(1), np.random.default_rng(4)
    tile, kernel = find_tile(one, one.image, ASKED), rng.normal(size=(7, 16, 16)).astype(np.float32)
    parts: dict[int, np.ndarray] = {}
    first = find_maps(tile, kernel, 0, range(-1, 2), parts)
    assert first.shape == (3, 17, 17) and [*parts] == [0]
    more = find_maps(tile, kernel, 0, range(0, 3), {0: np.full_like(parts[0], np.nan)})
    np.testing.assert_array_equal(more[:2], first[1:])
    assert np.isnan(more[2]).all()  # the only one that was not known
    np.testing.assert_array_equal(find_maps(tile, kernel.copy(), 0, range(-1, 2), {}), first)
