"""A plane of a region is that part of the plane of the whole frame, with the margin that it declares."""

import numpy as np
import pytest

from bayesnet_track import GrayPlane
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region
from bayesnet_track.vision.planes import Hue, HueBins, TextureCodes, WholeFrame, gray

PLANES = [GrayPlane(), Hue(), Hue(median_px=5), HueBins(bins=16), TextureCodes(), TextureCodes("patterns")]


@pytest.fixture(scope="module")
def pair():
    noise = np.random.default_rng(3).integers(0, 256, (40, 60, 3), dtype=np.uint8)
    return FramePair(Frame(0, 0.0, noise), None)


@pytest.mark.parametrize("plane", PLANES, ids=str)
@pytest.mark.parametrize("corners", [(0, 0, 9, 7), (20, 11, 31, 29), (51, 33, 60, 40)])
def test_a_region_is_a_part_of_the_whole(plane, corners, pair):
    region = Region(*corners)
    whole = PlaneCache(pair).planes([plane], Region(0, 0, 60, 40))[plane]
    part = PlaneCache(pair).planes([plane], region)[plane]
    assert part.shape == (region.y1 - region.y0, region.x1 - region.x0) and part.dtype == whole.dtype
    np.testing.assert_array_equal(part, whole[region.y0 : region.y1, region.x0 : region.x1])
    assert len(np.unique(whole)) > 2, "or nothing is compared"


def test_the_whole_frame_is_the_picture_whatever_the_region(pair):
    plane = WholeFrame()
    assert PlaneCache(pair).planes([plane], Region(3, 4, 5, 6))[plane] is pair.current.image


def test_gray_keeps_a_gray_picture_and_weights_the_channels():
    levels = np.arange(256, dtype=np.uint8).reshape(16, 16)
    np.testing.assert_array_equal(gray(np.repeat(levels[:, :, None], 3, axis=2)), levels)
    pure = np.zeros((1, 3, 3), np.uint8)
    pure[0, range(3), range(3)] = 255
    assert gray(pure).tolist() == [[29, 150, 76]]  # of 255: .114, .587, .299
    assert gray(np.zeros((0, 4, 3), np.uint8)).shape == (0, 4)


def test_a_pixel_without_chroma_has_no_hue():
    image = np.array([[[100, 100, 129], [100, 100, 130]]], np.uint8)  # BGR
    planes = PlaneCache(FramePair(Frame(0, 0.0, image), None)).planes([Hue(), HueBins(8)], Region(0, 0, 2, 1))
    assert planes[Hue()].tolist() == [[-1, 0]] and planes[HueBins(8)].tolist() == [[8, 0]]
