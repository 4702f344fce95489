"""Kernels of what is remembered of detections, against the same in NumPy."""

import numpy as np

from bayesnet_track.numerics.boxes import overlap
from bayesnet_track.numerics.kernels.judging_kernels import (
    append_detections,
    cosines_of,
    earlier_rows,
    overlaps_of,
    units_of,
    weigh_angles,
)

RNG = np.random.default_rng(5)
NAN = np.nan


def test_the_earliest_detection_comes_first_and_the_last_stands_in():
    rows = np.array(
        [
            [1.0, 1, 1, 1, 2, NAN, NAN, NAN, NAN, 7, 7, 7, 7],  # last, count, two frames
            [1.0, 1, 1, 1, 2, 5, 5, 5, 5, 7, 7, 7, 7],
            [1.0, 1, 1, 1, 2, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN],
            [1.0, 1, 1, 1, 0, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN],
        ]
    )
    found = earlier_rows(rows, 4, 5, 2)
    assert found[:3, 0].tolist() == [7.0, 5.0, 1.0]
    assert np.isnan(found[3]).all()


def test_overlaps_are_those_of_boxes_bit_by_bit():
    first, second = (RNG.uniform([0, 0, 0, 0], [50, 50, 40, 40], (count, 4)) for count in (9, 12))
    first[0, 2:] = second[0, 2:] = 0.0  # no union
    assert np.array_equal(overlaps_of(first, second), overlap(first[:, None], second[None]))


def test_cosines_and_units_are_those_of_vectors():
    origin, boxes = RNG.normal(0, 9, (5, 4)), RNG.normal(0, 9, (7, 4))
    heading = units_of(RNG.normal(0, 9, (5, 2)))
    np.testing.assert_allclose(np.linalg.norm(heading, axis=1), 1.0, rtol=1e-5)
    ways = boxes[None, :, :2] - origin[:, None, :2]
    expected = (ways * heading[:, None]).sum(axis=2) / np.linalg.norm(ways, axis=2)
    np.testing.assert_allclose(cosines_of(heading, origin, boxes), expected, rtol=1e-5, atol=1e-6)
    assert units_of(np.zeros((1, 2))).tolist() == [[0.0, 0.0]]


def test_angles_are_weighed_and_unknown_ones_are_nothing():
    found = weigh_angles(np.array([[0.0, np.pi / 2], [np.pi, NAN]]), np.array([2.0, 4.0]))
    assert found.tolist() == [[1.0, 0.0], [-1.0, 0.0]]


def test_a_detection_is_appended_where_there_is_one():
    # The last one, gap, count, those of two frames, the direction
    rows = np.array([[1.0, 1, 1, 1, 0, 3, 5, 5, 5, 5, 7, 7, 7, 7, 0.6, 0.8]] * 2)
    own, heading = np.full((2, 4), 9.0), np.array([[0.0, 1.0], [NAN, NAN]])
    append_detections(rows, own, np.array([True, False]), 6, 2, heading, 1.0)
    np.testing.assert_equal(rows[0], [9, 9, 9, 9, 0, 4, 7, 7, 7, 7, 9, 9, 9, 9, 0.0, 1.0])
    np.testing.assert_equal(rows[1], [1, 1, 1, 1, 1, 3, 7, 7, 7, 7, NAN, NAN, NAN, NAN, 0.6, 0.8])
