"""Histograms under an Epanechnikov kernel: the sums over pixels that they are in closed form."""

import numpy as np
import pytest

from bayesnet_track.observation.planes import for_reading
from bayesnet_track.vision.kernels.mean_shift_kernels import coefficients, kernel_shares

BINS = 5
LEFT, TOP = 4, 3
CELLS = for_reading(np.random.default_rng(0).integers(0, BINS, (11, 13)).astype(np.uint16))


def plainly(box, step):
    """Weights by cell of what lies in the array, and the weight of all pixels of the lattice, one by one."""
    x, y, rx, ry = box[0], box[1], max(box[2] / 2, 1.0), max(box[3] / 2, 1.0)
    histogram, whole = np.zeros(BINS), 0.0
    for row in range(-60, 60, step):
        for column in range(-60, 60, step):
            weight = max(1 - ((column - x) / rx) ** 2 - ((row - y) / ry) ** 2, 0.0)
            whole += weight
            if TOP <= row < TOP + 11 and LEFT <= column < LEFT + 13:
                histogram[CELLS[row - TOP, column - LEFT]] += weight
    return histogram, whole


BOXES = [
    ((9.3, 7.6, 6.0, 8.0), 100, 1),
    ((9.0, 8.0, 0.5, 0.5), 100, 1),  # radii of 1 px at least: one pixel
    ((4.2, 3.1, 9.0, 7.0), 100, 1),  # over the upper left corner
    ((16.0, 13.5, 9.0, 7.0), 100, 1),  # over the lower right one
    ((9.3, 7.6, 11.0, 10.0), 30, 2),  # 110 px, at most 30: every second row and column
    ((10.0, 8.0, 24.0, 18.0), 50, 3),
    ((10.0, 8.0, 3.0, 50.0), 50, 2),  # narrow, with many rows
    ((9.3, 7.6, 30.0, 2.0), 100, 1),
    ((40.0, 8.0, 6.0, 6.0), 100, 1),  # outside
    ((9.0, -20.0, 6.0, 6.0), 100, 1),
]


@pytest.mark.parametrize(("box", "most", "step"), BOXES)
def test_shares_and_coefficients_are_those_of_single_pixels(box, most, step):
    histogram, whole = plainly(box, step)
    total = histogram.sum()
    expected = histogram / total if total > 0 else np.zeros(BINS)
    np.testing.assert_allclose(
        kernel_shares(CELLS, LEFT, TOP, np.array(box), most, BINS), expected, atol=1e-12
    )
    roots = np.sqrt([0.0, 0.1, 0.2, 0.3, 0.4])
    rho = coefficients(CELLS, LEFT, TOP, np.array([box, BOXES[0][0]]), most, roots)
    reached = total > 0
    expected_rho = np.sqrt(histogram / whole) @ roots if reached else 0.0
    np.testing.assert_allclose(rho[0], expected_rho, atol=1e-12)
    assert rho[1] > 0
