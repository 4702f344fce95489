"""The conversion of boxes is exact both ways; overlap has its known values."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from bayesnet_track.numerics.boxes import centre_from_corner, corner_from_centre, overlap

boxes = hnp.arrays(np.float64, (5, 4), elements=st.integers(-500, 500).map(lambda v: v / 4)).map(
    lambda b: np.concatenate([b[:, :2], np.abs(b[:, 2:]) + 0.25], axis=1)
)


@given(boxes)
def test_round_trip(corner):
    np.testing.assert_array_equal(corner_from_centre(centre_from_corner(corner)), corner)


def test_the_centre_is_the_mean_of_the_covered_pixels():
    columns, rows = np.arange(10, 10 + 41), np.arange(20, 20 + 32)
    centre = centre_from_corner([10, 20, 41, 32])
    assert centre.tolist() == [columns.mean(), rows.mean(), 41, 32]


@given(boxes, boxes)
def test_overlap_is_symmetric_and_a_share(a, b):
    shared = overlap(a, b)
    np.testing.assert_array_equal(shared, overlap(b, a))
    assert np.all((shared >= 0) & (shared <= 1))
    np.testing.assert_allclose(overlap(a, a), 1.0, rtol=1e-12)


@given(boxes, boxes)
def test_overlap_does_not_move_with_the_origin(a, b):
    shift = np.array([3.0, -7.0, 0.0, 0.0])
    np.testing.assert_allclose(overlap(a + shift, b + shift), overlap(a, b), atol=1e-9)


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ([0, 0, 4, 4], [2, 0, 4, 4], 1 / 3),
        ([0, 0, 4, 4], [0, 0, 2, 2], 1 / 4),
        ([0, 0, 4, 4], [4, 0, 4, 4], 0),
        ([0, 0, 4, 2], [1, 1, 4, 2], 3 / 13),
        ([0, 0, 0, 0], [0, 0, 0, 0], 0),
    ],
)
def test_known_overlaps(a, b, expected):
    assert overlap(a, b) == pytest.approx(expected)


def test_overlap_broadcasts():
    assert overlap(np.zeros((3, 1, 4)) + 1.0, np.ones((2, 4))).shape == (3, 2)
