"""Kernels of mean shift against brute force, and the climb that they promise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.observation.planes import for_reading
from bayesnet_track.vision.kernels.mean_shift_kernels import kernel_histogram, shift, window_moments

BINS = 6
PLACES = st.tuples(st.floats(-8.0, 30.0), st.floats(-8.0, 25.0), st.floats(0.3, 12.0), st.floats(0.3, 12.0))


def shifted(cells, model, *how):
    """`shift` of arrays as the cue gives them."""
    return shift(for_reading(cells), for_reading(model), *how)


def picture(seed, rows=20, columns=24):
    return np.random.default_rng(seed).integers(0, BINS, (rows, columns)).astype(np.uint16)


def weights_of(x, y, rx, ry, rows, columns, margin=30):
    """1 - |d|^2 of every pixel of a picture with a margin all round."""
    down, across = np.mgrid[-margin : rows + margin, -margin : columns + margin]
    square = ((across - x) / max(rx, 1.0)) ** 2 + ((down - y) / max(ry, 1.0)) ** 2
    return np.clip(1.0 - square, 0.0, None), margin


@given(st.integers(0, 99), PLACES)
def test_the_histogram_is_the_kernels_share_of_each_cell(seed, place):
    cells = picture(seed)
    weights, margin = weights_of(*place, *cells.shape)
    inner = weights[margin:-margin, margin:-margin]
    expected = np.array([inner[cells == u].sum() for u in range(BINS)])
    found = kernel_histogram(cells, *place, BINS)
    np.testing.assert_allclose(found, expected / max(weights.sum(), 1e-300), rtol=1e-10, atol=1e-13)


@given(st.integers(0, 99), PLACES)
def test_moments_are_sums_over_the_window(seed, place):
    cells = picture(seed)
    x, y, half_w, half_h = place
    half_w, half_h = max(half_w, 0.51), max(half_h, 0.51)  # a pixel's centre is inside
    probability = np.linspace(0.0, 1.0, BINS)
    down, across = np.mgrid[0 : cells.shape[0], 0 : cells.shape[1]]
    inside = (across >= x - half_w) & (across < x + half_w) & (down >= y - half_h) & (down < y + half_h)
    p, dx, dy = probability[cells] * inside, across - x, down - y
    expected = [(p * f).sum() for f in (1.0, dx, dy, dx * dx, dx * dy, dy * dy)]
    np.testing.assert_allclose(
        window_moments(cells, probability, x, y, half_w, half_h), expected, rtol=1e-9, atol=1e-9
    )


def test_a_window_smaller_than_a_pixel_sees_the_nearest():
    cells = picture(1)
    assert window_moments(cells, np.ones(BINS), 5.3, 7.4, 0.05, 0.05)[0] == 1.0
    assert kernel_histogram(cells, 5.0, 7.0, 0.1, 0.1, BINS)[cells[7, 5]] == 1.0


@given(st.integers(0, 99), st.floats(8.0, 16.0), st.floats(8.0, 12.0))
def test_every_shift_climbs_the_bhattacharyya_coefficient(seed, x, y):
    model = np.random.default_rng(seed).dirichlet(np.ones(BINS))
    cells = picture(seed)
    place = (x, y)

    def rho(at):
        return np.sqrt(kernel_histogram(cells, *at, 6.0, 5.0, BINS) * model).sum()

    for _ in range(8):
        before = rho(place)
        *place, steps = shifted(cells, model, *place, 6.0, 5.0, 1e-6, 1)
        assert steps == 1
        assert rho(place) >= before - 1e-12


def test_it_ends_on_the_patch_of_its_colour():
    cells = np.zeros((40, 60), np.uint16)
    cells[12:21, 30:43] = 3
    model = np.eye(BINS)[3]
    x, y, steps = shifted(cells, model, 26.0, 20.0, 9.0, 7.0, 1e-6, 100)
    assert 1 < steps < 100
    assert abs(x - 36.0) < 0.05 and abs(y - 16.0) < 0.05


def test_without_a_pixel_of_its_colours_it_stays():
    cells = np.zeros((40, 60), np.uint16)
    assert shifted(cells, np.eye(BINS)[3], 26.0, 20.0, 9.0, 7.0, 1e-6, 100) == (26.0, 20.0, 0)
    assert shifted(np.zeros((0, 0), np.uint16), np.eye(BINS)[0], 5.0, 5.0, 9.0, 7.0, 1e-6, 9)[2] == 0


def test_a_histogram_worked_by_hand():
    """Radii 2 about the middle of 3 x 3: 1 there, 3/4 beside it, 1/2 at the corners; 6 in all."""
    cells = np.array([[0, 1, 2], [3, 4, 5], [2, 1, 0]], np.uint16)
    found = kernel_histogram(cells, 1.0, 1.0, 2.0, 2.0, 7)
    np.testing.assert_allclose(found * 6.0, [1.0, 1.5, 1.0, 0.75, 1.0, 0.75, 0.0], rtol=1e-12)
    narrow = kernel_histogram(cells, 1.0, 1.0, 0.2, 2.0, 7)  # 1 px across: the middle column alone
    np.testing.assert_allclose(narrow, [0.0, 0.6, 0.0, 0.0, 0.4, 0.0, 0.0], rtol=1e-12)


@pytest.mark.parametrize(("x", "y", "cell"), [(0.0, 0.0, 0), (2.0, 0.0, 2), (0.0, 2.0, 2), (2.0, 2.0, 0)])
def test_the_corners_belong_to_the_picture(x, y, cell):
    cells = np.array([[0, 1, 2], [3, 4, 5], [2, 1, 0]], np.uint16)
    found = kernel_histogram(cells, x, y, 1.0, 1.0, 7)
    assert found[cell] == 1.0 == found.sum()
    outside = kernel_histogram(cells, x + (x > 0) - (x == 0), y, 1.0, 1.0, 7)
    assert outside.sum() == 0.0
