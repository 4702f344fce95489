"""Dense flow there and back, and its sums over boxes, against plain NumPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.observation.planes import for_reading
from bayesnet_track.vision.kernels.dense_flow_kernels import dense_in_boxes, there_and_back, valid_vectors
from bayesnet_track.vision.kernels.flow_kernels import flow_in_boxes


@given(st.integers(0, 10_000), st.integers(1, 30), st.integers(1, 30), st.integers(-5, 40))
def test_the_same_counts_and_means_as_point_by_point(seed, width, height, left):
    """Bit for bit, also for boxes with edges on pixels, beyond the region, and of no size."""
    rng = np.random.default_rng(seed)
    top = left + 3
    y, x = np.nonzero(rng.random((height, width)) < 0.4)
    points = np.column_stack([x + left, y + top, rng.normal(0, 9, (len(x), 2))])
    boxes = np.column_stack([rng.uniform(left - 9, left + width + 9, (40, 2)), rng.uniform(0.1, 40, (40, 2))])
    boxes[:20] = np.rint(boxes[:20])
    expected, found = ((np.zeros(40), np.zeros((40, 2))) for _ in range(2))
    flow_in_boxes(for_reading(points), boxes, *expected)
    dense_in_boxes(points, left, top, width, height, boxes, *found)
    assert np.array_equal(expected[0], found[0])
    assert np.array_equal(expected[1], found[1])


def test_a_vector_is_valid_when_it_returns():
    there, back = np.zeros((6, 8, 2), np.float32), np.zeros((6, 8, 2), np.float32)
    there[..., 0], back[..., 0] = 2.5, -2.5
    back[2, 5:, 0] = -1.0  # row 2: comes back 1.5 px off, from column 3 and, half, from column 2
    there[4, 1] = 0.0, 9.0  # out of the frame
    scores = np.ones((6, 8))
    scores[0, 0] = 0.0
    out = np.empty((6, 8, 3), np.float32)
    there_and_back(there, back, 0, 0, scores, 4.0, 1.0, out)
    expected = np.zeros((6, 8))
    expected[:, :5] = 1  # further right it came from outside
    expected[0, 0] = expected[4, 1] = expected[2, 3] = expected[2, 4] = 0
    assert np.array_equal(out[..., 2], expected)
    assert np.array_equal(out[expected == 1][:, :2], np.tile(np.float32([-2.5, 0]), (int(expected.sum()), 1)))
    assert not out[expected == 0].any()
    there_and_back(there, back, 0, 0, scores, 2.4, 1.0, out)
    assert not out.any()


def test_a_part_of_the_field():
    rng = np.random.default_rng(0)
    there, back = (rng.normal(0, 1, (20, 30, 2)).astype(np.float32) for _ in range(2))
    scores = rng.random((20, 30)) - 0.2
    whole, part = np.empty((20, 30, 3), np.float32), np.empty((7, 9, 3), np.float32)
    there_and_back(there, back, 0, 0, scores, 5.0, 1.5, whole)
    there_and_back(there, back, 11, 4, np.ascontiguousarray(scores[4:11, 11:20]), 5.0, 1.5, part)
    assert whole[..., 2].sum() > 50
    assert np.array_equal(part, whole[4:11, 11:20])


def test_the_list_of_valid_vectors():
    field = np.zeros((2, 3, 3), np.float32)
    field[1, 2] = 0.5, -1.5, 1
    field[0, 1] = 3, 4, 1
    found = np.empty((6, 4))
    assert valid_vectors(field, 10, 20, found) == 2
    assert found[:2] == pytest.approx(np.array([[11, 20, 3, 4], [12, 21, 0.5, -1.5]]))
