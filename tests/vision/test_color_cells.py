"""Colour cells against their definition."""

import cv2
import numpy as np
import pytest

from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region
from bayesnet_track.vision.planes import ColorCells

WHOLE = Region(0, 0, 40, 30)


def cells_of(plane, image, region=WHOLE):
    return PlaneCache(FramePair(Frame(0, 0.0, image), None)).planes([plane], region)[plane]


@pytest.mark.parametrize(("space", "levels", "size"), [("rgb", 8, 512), ("rgb", 16, 4096), ("hsv", 8, 256)])
def test_cells_are_those_of_the_cube(space, levels, size):
    image = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    plane = ColorCells(space, levels)
    found = cells_of(plane, image)
    assert plane.size == size and found.dtype == np.uint16 and found.max() < size
    values = image if space == "rgb" else cv2.cvtColor(image, cv2.COLOR_BGR2HSV_FULL)
    last = levels if space == "rgb" else levels // 2
    a, b = (values[..., k].astype(int) * levels // 256 for k in (0, 1))
    np.testing.assert_array_equal(found, (a * levels + b) * last + values[..., 2].astype(int) * last // 256)


@pytest.mark.parametrize("space", ["rgb", "hsv"])
def test_an_empty_region(space):
    image = np.zeros((30, 40, 3), np.uint8)
    assert cells_of(ColorCells(space), image, Region(50, 50, 60, 60)).size == 0
