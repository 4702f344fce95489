"""Kernels of noise against their moments, the detector against its closed form, working points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.numerics.distributions import (
    _peak_error,
    false_reset_level,
    feasibility,
    flatten,
    gaussian_taps,
    nearest_probable,
    spreading_matrix,
)


def gaussian(at, mean, sd):
    return np.exp(-0.5 * ((at - mean) / sd) ** 2) / (sd * np.sqrt(2 * np.pi))


@given(st.floats(-40, 40), st.floats(0, 8))
def test_a_kernel_keeps_mass_mean_and_variance(shift, sd):
    first, taps = gaussian_taps(shift, sd)
    cells = first + np.arange(len(taps))
    assert abs(taps.sum() - 1) < 1e-12
    assert abs(taps @ cells - shift) < 1e-7  # 2 exp(-2 pi^2 sd^2), at most 5e-9 sd-wide, times the reach
    assert abs(taps @ (cells - shift) ** 2 - sd**2) < 3e-7 * max(1.0, sd**2)


@pytest.mark.parametrize("shift", [-0.5, 0.25, 0.43, 1.5])
def test_a_pure_shift_moves_a_smooth_density_and_not_its_width(shift):
    """The seven taps err by at most |prod(shift - k)| / 7! times the seventh derivative: 3e-6 at sd 4."""
    cells = np.arange(-60.0, 61.0)
    first, taps = gaussian_taps(shift, 0.0)
    moved = np.convolve(gaussian(cells, 0.0, 4.0), taps)
    at = cells[0] + first + np.arange(len(moved))
    np.testing.assert_allclose(moved, gaussian(at, shift, 4.0), atol=3e-6)
    assert moved @ at == pytest.approx(shift, abs=1e-12)
    assert moved @ (at - shift) ** 2 == pytest.approx(16.0, rel=1e-9)


def test_whole_cells_shift_exactly():
    first, taps = gaussian_taps(-3.0, 0.0)
    assert first + int(np.argmax(taps)) == -3
    np.testing.assert_allclose(taps, np.arange(len(taps)) == np.argmax(taps), atol=1e-15)


@given(st.floats(0.2, 1), st.floats(0, 3))
def test_velocities_decay_and_spread_without_loss(factor, sd):
    matrix = spreading_matrix(61, factor, sd)
    np.testing.assert_allclose(matrix.sum(axis=0), 1.0, atol=1e-12)
    cells = np.arange(-30.0, 31.0)
    moved = matrix @ gaussian(cells, 2.0, 3.0)
    assert moved @ cells == pytest.approx(2.0 * factor, abs=1e-6)
    assert moved @ (cells - 2 * factor) ** 2 == pytest.approx(9 * factor**2 + sd**2, abs=1e-6)


def test_flattening_acts_on_densities():
    """P^(1/2) of sd 1 has sd 1.41; the same power of equal weights of samples changes nothing."""
    at = np.linspace(-12, 12, 2401)
    flat = flatten(gaussian(at, 0.0, 1.0), 2.0)
    assert np.sqrt(flat @ at**2) == pytest.approx(np.sqrt(2), rel=1e-9)
    assert flat.sum() == pytest.approx(1.0)
    known = gaussian(at, 0.0, 1.0)
    assert flatten(known, 1.0) is known
    samples = np.random.default_rng(0).standard_normal(4000)
    weights = flatten(np.full(4000, 1 / 4000), 2.0)
    assert np.sqrt(weights @ samples**2) == pytest.approx(1.0, abs=0.04)  # 3.5 sds of 1 / sqrt(2 N)


@pytest.mark.parametrize(("width", "gamma"), [(100, 0.28), (320, 0.66), (1000, 2.07)])
def test_gamma_depends_on_the_region(width, gamma):
    """One innovation, three regions: the same data is not feasible in two of them and is in the third.

    gamma = |U| N(z; 0, S) over what of the likelihood lies inside U: all but a quarter in the smallest.
    """
    at = np.arange(-(width // 2), width // 2) + 0.5
    prior, likelihood = gaussian(at, 0.0, 10.8), gaussian(at, 40.0, 15.0)
    found = feasibility(prior / prior.sum(), likelihood, likelihood.sum() / width)
    assert found == pytest.approx(gamma, abs=0.01)


def test_a_right_model_falls_below_one_only_beyond_seven_over_a_wide_region():
    """|U| = 1000, innovation sd 10: gamma = 1 at z^2 / S = 2 ln(1000 / (sqrt(2 pi) 10)) = 7.4."""
    at = np.arange(-500, 500) + 0.5
    prior = gaussian(at, 0.0, 6.0)

    def gamma(z):
        likelihood = gaussian(at, z, 8.0)
        return feasibility(prior / prior.sum(), likelihood, likelihood.sum() / 1000)

    z2 = 2 * np.log(1000 / (np.sqrt(2 * np.pi) * 10))
    assert z2 == pytest.approx(7.4, abs=0.05)
    assert gamma(np.sqrt(100 * (z2 - 0.05))) > 1 > gamma(np.sqrt(100 * (z2 + 0.05)))


@pytest.mark.parametrize("rate", [0.05, 0.0066, 0.001])
def test_the_level_of_a_false_reset_rate(rate):
    """In one dimension gamma falls below gamma(z) with chance P(chi2_1 > z^2 / S), whatever was measured."""
    from scipy.stats import chi2

    at = np.arange(-500, 500, 0.25)
    prior = gaussian(at, 0.0, 6.0)
    expected = 1000 / (np.sqrt(2 * np.pi) * 10) * np.exp(-0.5 * chi2.isf(rate, 1))
    for measured in (0.5, 40.5):
        level = false_reset_level(prior / prior.sum(), gaussian(at, measured, 8.0), rate)
        assert level == pytest.approx(expected, rel=0.09)  # a cell is z / S / 4 = 8 % in gamma at z = 33


def test_no_level_for_evidence_that_says_nothing():
    assert false_reset_level(np.full((3, 4), 1 / 12), np.ones((3, 4)), 0.01) == 0.0
    assert np.isnan(feasibility(np.ones(2), np.zeros(2), 0.0))


def test_working_points_of_a_bimodal_density():
    """Figure 3.16 of the tracking chapter: the mean lies between; x_opt takes the mode that is meant."""
    at = np.linspace(0, 10, 1001)
    density = gaussian(at, 2.0, 0.5) + 0.8 * gaussian(at, 7.0, 0.5)
    points = at[:, None]
    assert at[np.argmax(density)] == pytest.approx(2.0)
    assert density @ at / density.sum() == pytest.approx((2 + 0.8 * 7) / 1.8, abs=1e-3)

    def chosen(toward, epsilon):
        return at[nearest_probable(points, density, np.array([toward]), epsilon)]

    assert chosen(9.0, 1.0) == pytest.approx(2.0)  # epsilon 1: the maximum, wherever the vector points
    # epsilon .5: up to sd sqrt(2 ln(.8 / .5)) around the lesser mode
    assert chosen(9.0, 0.5) == pytest.approx(7 + 0.5 * np.sqrt(2 * np.log(1.6)), abs=0.01)
    assert chosen(0.0, 0.5) == pytest.approx(2 - 0.5 * np.sqrt(2 * np.log(2)), abs=0.01)
    assert chosen(4.5, 1e-300) == pytest.approx(4.5)  # epsilon 0: the external vector itself


def test_the_peaks_error_is_the_gaussian_with_the_same_cells_above_half():
    """A slanted line of five cells: its scatter and 1 / 12 per axis, around cell 0 and wrapped."""
    above = np.zeros((7, 9))
    for step, height in zip((-2, -1, 0, 1, 2), (0.5, 0.7, 1.0, 0.8, 0.6), strict=True):
        above[3 + step, 4 + step] = height
    above[0, 0] = 0.499  # below half: not counted
    found = _peak_error(above, (np.intp(3), np.intp(4)), (14, 18))
    assert found.shape == (14, 18)
    spread = 4 / (2 * np.log(2)) * np.full((2, 2), 2.0) + np.eye(2) / 12
    for row, column in ((0, 0), (1, 1), (-1, -1), (1, 0), (0, 1), (-1, 1), (3, 2)):
        off = np.array([row, column], dtype=float)
        expected = np.exp(-0.5 * off @ np.linalg.solve(spread, off))
        assert found[row, column] == pytest.approx(expected, rel=1e-9)


def test_an_axis_of_one_cell_has_no_error():
    above = np.array([[[0.2, 1.0, 0.6]]])
    found = _peak_error(above, (np.intp(0), np.intp(0), np.intp(1)), (2, 2, 6))
    variance = 3 / (2 * np.log(2)) * 0.5 + 1 / 12  # offsets 0 and 1 above half, one dimension
    np.testing.assert_allclose(found[0, 0], np.exp(-0.5 * np.array([0, 1, 2, -3, -2, -1]) ** 2 / variance))
    np.testing.assert_array_equal(found[1, 1], found[0, 0])
    np.testing.assert_array_equal(_peak_error(np.ones((1, 1)), (np.intp(0), np.intp(0)), (2, 2)), 1.0)
