"""Points that stand for a Gaussian, against the same with NumPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.numerics.gaussian import (
    carry,
    correct_fields,
    linear_update,
    root,
    stand_for,
    standard_normals,
    weighted_moments,
)

ANYWHERE = (np.inf, np.inf)


def gaussian(seed, width, rank=None):
    rng = np.random.default_rng(seed)
    sides = rng.normal(size=(width, rank or width + 2)) * 10.0 ** rng.uniform(-2, 2, width)[:, None]
    return rng.normal(size=width) * 100.0 + 500.0, sides @ sides.T


def points(mean, covariance, half, size, image):
    width = len(mean)
    lower, unit, states = np.empty((width, width)), np.empty((size, width)), np.empty((size, width))
    is_full = stand_for(mean, covariance, half, (*image, 1e-6), unit, (lower, states))
    return lower, unit, states, is_full


@given(st.integers(0, 10_000), st.integers(1, 8))
def test_a_gaussian_is_carried_by_a_linear_motion(seed, width):
    mean, covariance = gaussian(seed, width)
    noise, transition = gaussian(seed + 1, width)[1], np.random.default_rng(seed).normal(size=(width, width))
    moved, spread = np.empty(width), np.empty((width, width))
    carry(transition, noise, mean, covariance, moved, spread)
    expected = transition @ covariance @ transition.T + noise
    np.testing.assert_allclose(moved, transition @ mean, rtol=1e-9, atol=1e-9 * np.abs(mean).max())
    np.testing.assert_allclose(spread, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_array_equal(spread, spread.T)


@given(st.integers(0, 10_000), st.integers(4, 8), st.integers(18, 31))
def test_they_are_the_whitened_draws_put_where_the_gaussian_is(seed, width, size):
    mean, covariance = gaussian(seed, width)
    half = np.random.default_rng(seed).standard_normal((size // 2, width))
    lower, unit, states, is_full = points(mean, covariance, half, size, ANYWHERE)
    assert is_full
    np.testing.assert_allclose(unit, standard_normals(size, width, np.random.default_rng(seed)), atol=1e-9)
    sds = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(lower / sds[:, None], root(covariance) / sds[:, None], atol=1e-9)
    free = [*range(2), *range(4, width)]
    expected = mean + unit @ lower.T
    np.testing.assert_allclose(states[:, free], expected[:, free], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(states[:, 2:4], np.maximum(expected[:, 2:4], 1.0), rtol=1e-9, atol=1e-9)
    found, spread = weighted_moments(expected, np.full(size, 1.0 / size))
    np.testing.assert_allclose(found, mean, atol=1e-9 * sds.max())
    np.testing.assert_allclose(spread / np.outer(sds, sds), covariance / np.outer(sds, sds), atol=1e-8)


def test_centres_stay_on_the_image_and_sizes_below_twice_its_own():
    half = np.random.default_rng(0).standard_normal((50, 4))
    mean, covariance = np.array([100.0, 50.0, 100.0, 50.0]), np.eye(4) * 200.0**2
    _, _, states, _ = points(mean, covariance, half, 100, (200.0, 100.0))
    np.testing.assert_array_equal(states.min(axis=0), [0, 0, 1, 1])
    np.testing.assert_array_equal(states.max(axis=0), [199, 99, 400, 200])


@pytest.mark.parametrize(
    "covariance",
    [
        np.diag([4.0, 1.0, 0.0, 1.0]),
        np.ones((4, 4)),
        np.zeros((4, 4)),
        np.full((4, 4), np.nan),
        gaussian(3, 4, rank=3)[1],
    ],
)
def test_a_covariance_without_such_a_root_is_named(covariance):
    half = np.random.default_rng(0).standard_normal((10, 4))
    assert not points(np.zeros(4), covariance, half, 20, ANYWHERE)[3]


@given(st.integers(0, 10_000), st.integers(4, 8))
def test_fields_are_corrected_as_by_the_update_of_all_at_once(seed, width):
    mean, covariance = gaussian(seed, width)
    rng = np.random.default_rng(seed)
    columns, sds = rng.permutation(width)[:3], np.sqrt(np.diag(covariance))
    variances = (sds[columns] * 10.0 ** rng.uniform(-2, 2, 3)) ** 2
    measured = mean[columns] + sds[columns] * rng.normal(size=3)
    whole = linear_update(
        mean, covariance, measured - mean[columns], np.eye(width)[columns], np.diag(variances)
    )
    d2, log_likelihood = correct_fields(mean, covariance, columns, measured, variances)
    np.testing.assert_allclose(mean / sds, whole.mean / sds, rtol=1e-9, atol=1e-9)
    scale = np.outer(sds, sds)
    np.testing.assert_allclose(covariance / scale, whole.covariance / scale, atol=1e-9)
    assert d2 == pytest.approx(whole.d2, rel=1e-7)
    assert log_likelihood == pytest.approx(whole.log_likelihood, rel=1e-7)
