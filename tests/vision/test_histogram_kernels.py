"""Boxes and their pixels, distances of histograms and prices: worked by hand."""

import numpy as np
import pytest

from bayesnet_track.numerics.kernels.box_kernels import pixels_of_boxes
from bayesnet_track.vision.kernels.histogram_kernels import (
    color_distances,
    count_by_integral,
    count_directly,
    count_in_boxes,
)


@pytest.mark.parametrize(
    ("box", "corners", "visible", "nominal"),
    [
        ((15.0, 25.0, 4.0, 2.0), (3, 4, 7, 6), 8, 8),  # columns 13 .. 16, rows 24 and 25
        ((15.25, 25.25, 4.0, 2.0), (4, 5, 8, 7), 8, 8),
        ((10.0, 20.0, 4.0, 4.0), (0, 0, 2, 2), 4, 16),  # half out on the left and above
        ((19.0, 26.0, 6.0, 6.0), (6, 3, 8, 7), 8, 36),  # and on the right and below
        ((15.25, 25.25, 0.25, 0.25), (5, 5, 6, 6), 1, 1),  # the nearest pixel
        ((15.5, 25.5, 0.0, 0.0), (6, 6, 7, 7), 1, 1),
        ((0.0, 25.0, 4.0, 2.0), (0, 4, 0, 6), 0, 8),  # outside
        ((90.0, 25.0, 4.0, 2.0), (8, 4, 8, 6), 0, 8),
    ],
)
def test_pixels_of_a_box_in_a_crop(box, corners, visible, nominal):
    found = pixels_of_boxes(np.array([box]), 10, 20, 8, 7)
    assert found[0][0].tolist() == list(corners)
    assert (found[1][0], found[2][0]) == (visible, nominal)


def test_a_box_that_is_not_a_number_has_no_index_outside():
    corners, visible, _ = pixels_of_boxes(np.array([[np.nan, 25.0, 4.0, 2.0]]), 10, 20, 8, 7)
    assert corners[0, 0] == corners[0, 2] == 0 and visible[0] == 0.0


def test_three_ways_of_counting_are_one():
    binned = np.random.default_rng(0).integers(0, 5, (7, 8)).astype(np.uint8)
    corners = np.array([[0, 0, 8, 7], [1, 2, 4, 6], [3, 3, 3, 5], [7, 6, 8, 7]])
    expected = [np.bincount(binned[y0:y1, x0:x1].ravel(), minlength=5)[:4] for x0, y0, x1, y1 in corners]
    for way in (count_directly, count_by_integral, count_in_boxes):
        assert way(binned, corners, 4).tolist() == np.array(expected).tolist()
    many = np.tile(corners[:1], (30, 1))  # 1,680 pixels of boxes, 56 of the crop
    assert count_in_boxes(binned, many, 4).tolist() == np.tile(expected[0], (30, 1)).tolist()


def test_sums_that_outgrow_their_bits_leave_the_counts_of_other_bins_as_they_are():
    binned = np.random.default_rng(1).integers(0, 6, (400, 400)).astype(np.uint8)
    binned[:300] = 2  # 120,000 pixels above the boxes, 16 bits have room for 65,535
    corners = np.array([[10, 310, 90, 390], [0, 250, 200, 400], [150, 0, 350, 300]])
    expected = count_directly(binned, corners, 5)
    assert count_by_integral(binned, corners, 5).tolist() == expected.tolist()
    assert count_by_integral(binned, np.array([[0, 0, 400, 400]]), 5)[0, 2] > 2**16


def test_circular_distances_of_four_bins():
    shares = np.array([1.0, 0.0, 0.0, 0.0, 0.0])  # all in the first bin
    counts = np.array([[8, 0, 0, 0], [0, 8, 0, 0], [0, 0, 8, 0], [0, 0, 0, 8], [4, 0, 4, 0]], np.int32)
    pixels = np.full(5, 8.0)
    found, _ = color_distances(counts, pixels, pixels, shares, 1.0)
    np.testing.assert_allclose(found, [0.0, 0.5, 1.0, 0.5, 0.5])


def test_prices_of_what_is_moved_changed_and_outside():
    """Half of the reference is of the first hue, a quarter of the last but one, a quarter without colour."""
    shares = np.array([0.5, 0.0, 0.25, 0.0, 0.25])
    counts = np.array([[8, 0, 4, 0], [8, 0, 4, 0], [0, 0, 0, 0], [16, 0, 0, 0], [2, 0, 1, 0]], np.int32)
    visible, nominal = np.array([16.0, 12.0, 16.0, 16.0, 4.0]), np.full(5, 16.0)
    found, outside = color_distances(counts, visible, nominal, shares, 0.6)
    np.testing.assert_allclose(outside, [0.0, 0.25, 0.0, 0.0, 0.75])
    # a third of the hue's mass moves half way round: 1/3 of 0.75; the rest changes between colour and none
    alike = [0.0, 0.25, 0.6 * 0.75, 0.75 / 3 + 0.6 * 0.25, 0.75]
    np.testing.assert_allclose(found, alike, atol=1e-12)
    none = color_distances(counts[:1], visible[:1], nominal[:1], np.array([0.0, 0.0, 0.0, 0.0, 1.0]), 0.6)[0]
    np.testing.assert_allclose(none, [0.6 * 0.75])
