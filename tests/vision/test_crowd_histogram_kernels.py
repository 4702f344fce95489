"""Histograms of several targets' boxes against those of one target at a time."""

import numpy as np
import pytest

from bayesnet_track.numerics.kernels.box_kernels import pixels_of_boxes
from bayesnet_track.observation.planes import for_reading
from bayesnet_track.vision.kernels.histogram_kernels import (
    color_distances,
    color_distances_of_each,
    count_in_boxes,
    count_of_each,
    distinct_of_each,
)

BINS = 8


@pytest.mark.parametrize("spread_px", [0.5, 40.0])
@pytest.mark.parametrize("side", [3.0, 30.0])
def test_counts_and_distances_are_those_of_each_target_alone(spread_px, side):
    rng = np.random.default_rng(2)
    binned = rng.integers(0, BINS + 3, (60, 80), dtype=np.uint8)
    binned[binned > BINS] = 255
    boxes = np.concatenate(
        [
            np.column_stack([rng.normal(at, spread_px, (60, 2)), np.full((60, 2), side)])
            for at in ((20, 20), (70, 50), (-90, 20))  # the last one is beyond the border
        ]
    )
    starts = np.array([0, 60, 120, 180])
    regions = np.array([[0, 0, 80, 60]] * 3)
    corners, visible, nominal, firsts, places = distinct_of_each(boxes, starts, regions)
    crops = np.array([[0, 80]] * 3)
    counts = count_of_each(for_reading(binned.ravel()), crops, corners, firsts, BINS)
    shares = rng.dirichlet(np.ones(BINS + 1), 3)
    distances, outside = color_distances_of_each(counts, visible, nominal, firsts, shares, 0.5)
    for t in range(3):
        own = slice(starts[t], starts[t + 1])
        alone, seen, whole = pixels_of_boxes(boxes[own], 0, 0, 80, 60)
        expected = count_in_boxes(binned, alone, BINS)
        np.testing.assert_array_equal(counts[places[own]], expected)
        expected_distances = color_distances(expected, seen, whole, shares[t], 0.5)
        assert distances[places[own]].tobytes() == expected_distances[0].tobytes()
        assert outside[places[own]].tobytes() == expected_distances[1].tobytes()
    assert len(corners) < len(boxes) or spread_px > 1
