"""Cells are counted pixel by pixel; means of boxes and rings are those of an image sixteen times finer."""

import numpy as np
import pytest

from bayesnet_track.vision.kernels.color_kernels import (
    STEPS,
    box_and_ring_means,
    color_posterior,
    count_cells,
    fill_cells,
    integral_of_cells,
    ring_shares,
)
from bayesnet_track.vision.kernels.mean_shift_kernels import CellLayout

LAYOUT = np.array([[4, 4, 4], [16, 4, 1]], np.uint16)


@pytest.fixture
def image():
    return np.random.default_rng(1).integers(0, 256, (5, 7, 3), dtype=np.uint8)


def cells_of(image):
    b, g, r = np.moveaxis(image.astype(int) // 64, 2, 0)
    return 16 * b + 4 * g + r


@pytest.mark.parametrize(
    ("levels", "is_gray"), [(2, False), (16, False), (32, False), (5, True), (256, True)]
)
def test_a_cell_has_one_level_of_each_channel(levels, is_gray):
    line = np.concatenate([np.repeat(np.arange(256), 3), np.random.default_rng(2).integers(0, 256, 300)])
    cells = np.empty(len(line) // 3, np.uint16)
    fill_cells(line.astype(np.uint8), CellLayout(levels, is_gray).layout, cells)
    blue, green, red = (line * levels // 256).reshape(-1, 3).T
    expected = blue if is_gray else (blue * levels + green) * levels + red
    np.testing.assert_array_equal(cells, expected)


def test_every_pixel_is_counted_in_its_cell(image):
    counts = np.full((4, 64), np.nan)
    boxes = np.array([[3.0, 2, 40, 40], [3, 2, 5.5, 3], [3, 2, 5, 1.5], [3, 2, 1, 1]])
    count_cells(image, LAYOUT, boxes, counts)
    inside = (np.s_[:, :], np.s_[1:4, 0:7], np.s_[1:4, 1:6], np.s_[2:3, 3:4])
    for own, of in zip(counts, inside, strict=True):
        np.testing.assert_array_equal(own, np.bincount(cells_of(image[of]).ravel(), minlength=64))


def test_the_integral_sums_levels_above_and_left(image):
    levels = np.random.default_rng(3).integers(0, 256, 64).astype(np.uint8)
    integral = integral_of_cells(image, LAYOUT, levels, np.array([1, 6, 2, 5]))
    expected = np.zeros((4, 6), np.int64)
    expected[1:, 1:] = levels[cells_of(image[2:5, 1:6])].astype(int).cumsum(0).cumsum(1)
    np.testing.assert_array_equal(integral, expected)


@pytest.mark.parametrize(
    ("box", "ring"),
    [
        ((10.0, 8.0, 5.0, 4.0), 0.5),
        ((10.125, 8.25, 5.5, 3.5), 0.25),
        ((1.0, 0.5, 6.0, 5.0), 0.5),  # over the frame's corner
        ((18.5, 15.0, 5.0, 6.0), 0.5),  # over the opposite one
        ((-30.0, 8.0, 4.0, 4.0), 0.5),  # outside
        ((10.0, 8.0, 40.0, 40.0), 0.5),  # around the frame: no ring is left
    ],
)
def test_means_of_a_box_and_its_ring(box, ring):
    width, height = 20, 16
    levels = np.random.default_rng(4).integers(0, 256, (height, width))
    fine = np.kron(levels, np.ones((STEPS, STEPS), int))

    def inside(grown):
        x, y, w, h = box
        edges = [
            x + 0.5 - w / 2 - grown,
            y + 0.5 - h / 2 - grown,
            x + 0.5 + w / 2 + grown,
            y + 0.5 + h / 2 + grown,
        ]
        left, top, right, bottom = (round(edge * STEPS) for edge in edges)
        return np.s_[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)]

    own, grown = fine[inside(0.0)], fine[inside(ring * (box[2] + box[3]) / 2)]
    around = grown.size - own.size
    expected = [
        own.sum() / (box[2] * box[3] * STEPS**2),
        (grown.sum() - own.sum()) / around if around else 0.0,
    ]
    gray = np.array([[256, 256, 256], [1, 0, 0]], np.uint16)
    image, values = np.repeat(levels[:, :, None], 3, 2).astype(np.uint8), np.arange(256, dtype=np.uint8)
    for boxes in ([box], [box, (3.0, 12.0, 4.0, 4.0)]):  # whatever else is asked, in a larger crop
        means = np.full((len(boxes), 2), np.nan)
        box_and_ring_means(image, gray, values, np.array(boxes), ring, means)
        np.testing.assert_allclose(means[0], expected, rtol=1e-12)


def test_the_posterior_of_colours():
    f, b, old = np.random.default_rng(5).random((3, 100))
    expected = (f + 0.25) / (f + (0.7 * b + 0.3 * old) + 0.5)
    found = np.empty(len(f), np.uint8)
    color_posterior(f, b, old, 0.3, (0.25, 0.5), found)
    np.testing.assert_array_equal(found, np.rint(255 * expected))


def test_shares_are_of_the_pixels_around_a_box_and_of_those_in_the_last():
    counts = np.array([[9.0, 5, 0], [4, 4, 0], [3, 1, 0], [1, 1, 0]])
    shares = np.empty((3, 3))
    ring_shares(counts, shares)
    np.testing.assert_array_equal(shares, [[0.6, 0.4, 0], [0.25, 0.75, 0], [0.5, 0.5, 0]])
    ring_shares(np.ones((4, 3)), shares)
    np.testing.assert_array_equal(shares[:2], 0.0)
