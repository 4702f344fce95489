"""A plane of a region is that part of the plane of the whole frame, with the margin that it declares."""

import numpy as np
import pytest

from bayesnet_track import GrayPlane
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region
from bayesnet_track.vision.planes import Hue, HueBins, PixelGrid, TextureCodes, WholeFrame, gray, step_of

PLANES = [GrayPlane(), Hue(), Hue(median_px=5), HueBins(bins=16)]


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


@pytest.mark.parametrize(("side", "step"), [(1, 1), (127, 1), (128, 2), (191, 2), (192, 3), (1000, 15)])
def test_a_large_target_is_read_on_a_grid_of_64_to_128_pixels_a_side(side, step):
    assert step_of(np.array([side * 4.0, side / 4.0])) == step
    assert side < 128 or 64 <= side / step < 128


BOXES = [(30.0, 20.0, 21.0, 11.0), (30.5, 19.5, 200.0, 200.0), (1.0, 38.0, 9.0, 7.0), (58.0, 2.0, 6.0, 3.0)]


@pytest.mark.parametrize("box", BOXES)
@pytest.mark.parametrize("step", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("form", ["gradients", "patterns"])
def test_a_grid_holds_what_the_frame_has_on_its_lines(pair, form, step, box):
    """Whichever boxes are asked for; and a box of the grid holds the pixels that it holds in the frame."""
    frame, boxes, size = pair.current, np.array([box]), np.full(2, 64.0 * step)
    codes = TextureCodes(form)
    all_codes = codes.grid(frame, np.array([[29.5, 19.5, 60.0, 40.0]]), np.ones(2)).values
    for grid, whole in (
        (codes.grid(frame, boxes, size), all_codes),
        (PixelGrid.of_image(frame, boxes, size), frame.image),
    ):
        rows, columns = grid.values.shape[:2]
        expected = whole[grid.y :: grid.step, grid.x :: grid.step][:rows, :columns]
        assert grid.step == step and rows > 0 and columns > 0
        np.testing.assert_array_equal(grid.values, expected)
        assert step == 1 or (grid.x % step, grid.y % step) == (step // 2, step // 2)
        x, y, w, h = grid.boxes(boxes)[0]
        for place, side, lines, first, length in ((x, w, columns, grid.x, 60), (y, h, rows, grid.y, 40)):
            centre, full = (box[0], box[2]) if length == 60 else (box[1], box[3])
            in_frame = np.arange(step // 2 if step > 1 else 0, length, step)
            inside = in_frame[np.abs(in_frame - centre) < full / 2 - 1e-9]
            in_grid = first + step * np.flatnonzero(np.abs(np.arange(lines) - place) < side / 2 - 1e-9 / step)
            assert in_grid.tolist() == inside.tolist()


def test_rings_lie_on_the_grid(pair):
    """1.2 px x 0.5 mean sides around a box of 8 x 4: 11 x 7 px more of the frame."""
    size, box = np.full(2, 128.0), np.array([[30.0, 20.0, 8.0, 4.0]])
    grid = PixelGrid.of_image(pair.current, box, size, ring=0.5)
    assert grid.values.shape == PixelGrid.of_image(pair.current, box + [0, 0, 6, 6], size).values.shape
