"""Corners: the smaller eigenvalue of the gradient matrix by NumPy, and the best one of each cell."""

import numpy as np
import pytest

from bayesnet_track.observation.planes import for_reading
from bayesnet_track.vision.kernels.flow_kernels import corner_scores, lattice_corners

GRAY = for_reading(np.random.default_rng(2).integers(0, 256, (14, 17)).astype(np.uint8))


def eigenvalues(gray):
    """(H, W) smaller eigenvalue of the mean over 5 x 5 pixels of the products of Sobel gradients."""
    wide = gray.astype(float)
    gx, gy = np.zeros(gray.shape), np.zeros(gray.shape)
    for j, weight in ((-1, 1), (0, 2), (1, 1)):
        gx[1:-1, 1:-1] += (
            weight / 8 * np.roll(wide, -j, 0)[1:-1, 2:] - weight / 8 * np.roll(wide, -j, 0)[1:-1, :-2]
        )
        gy[1:-1, 1:-1] += (
            weight / 8 * np.roll(wide, -j, 1)[2:, 1:-1] - weight / 8 * np.roll(wide, -j, 1)[:-2, 1:-1]
        )
    found = np.zeros(gray.shape)
    for y in range(3, gray.shape[0] - 3):
        for x in range(3, gray.shape[1] - 3):
            block = np.s_[y - 2 : y + 3, x - 2 : x + 3]
            u, v = gx[block].ravel(), gy[block].ravel()
            found[y, x] = np.linalg.eigvalsh(np.array([[u @ u, u @ v], [u @ v, v @ v]]) / 25)[0]
    return found


@pytest.mark.parametrize("threshold", [0.0, 300.0, 1e6])
def test_scores_are_eigenvalues_above_the_threshold(threshold):
    scores, expected = np.full(GRAY.shape, np.nan), eigenvalues(GRAY)
    corner_scores(GRAY, threshold, scores)
    expected[expected <= threshold] = 0.0
    np.testing.assert_allclose(scores, expected, rtol=1e-9)
    assert (scores > 0).sum() == {0.0: 8 * 11, 1e6: 0}.get(threshold, (expected > 0).sum())
    assert threshold != 300.0 or 10 < (scores > 0).sum() < 88


def test_edges_and_images_without_room_have_no_corner():
    edge = np.tile(np.where(np.arange(17) < 8, 30, 220), (14, 1)).astype(np.uint8)
    for gray in (
        edge,
        np.ascontiguousarray(edge.T),
        np.ascontiguousarray(GRAY[:6]),
        np.ascontiguousarray(GRAY[:, :6]),
    ):
        scores = np.full(gray.shape, np.nan)
        corner_scores(for_reading(gray), 1.0, scores)
        assert not scores.any()
    scores = np.full((7, 7), np.nan)
    corner_scores(for_reading(GRAY[:7, :7]), 0.0, scores)
    np.testing.assert_allclose(scores[3, 3], eigenvalues(GRAY[:7, :7])[3, 3])


def test_the_best_of_each_cell_unless_a_neighbour_outside_is_better():
    scores = np.zeros((8, 10))
    scores[1, 1], scores[2, 2] = 5.0, 7.0  # one cell: the better one
    scores[1, 4], scores[1, 3] = 4.0, 3.0
    scores[3, 7], scores[4, 8] = 6.0, 9.0  # in two cells, and neighbours
    scores[6, 0], scores[6, 1] = 2.0, 2.0  # the first of equals
    found = np.full((9, 2), -1)
    count = lattice_corners(scores, np.array([20, 30]), np.array([20, 30]), np.array([29, 37]), 4, found)
    # cells of 4 x 4 from (20, 30) on; the last row has three, the last column one
    assert found[:count].tolist() == [[22, 32], [20, 36], [28, 34]]
    inner = lattice_corners(scores, np.array([20, 30]), np.array([21, 31]), np.array([27, 35]), 3, found)
    assert found[:inner].tolist() == [[22, 32], [24, 31]]
