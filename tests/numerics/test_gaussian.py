"""Roots, samples, quantiles and the linear update against scipy and closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from bayesnet_track.numerics.gaussian import (
    chi_square_cdf,
    chi_square_quantile,
    linear_update,
    root,
    roots,
    sigma_points,
    standard_normals,
    update_by_fields,
    weighted_moments,
)


def covariance_of(seed, size, rank):
    rng = np.random.default_rng(seed)
    sides = rng.normal(size=(size, rank)) * 10.0 ** rng.uniform(-3, 3, size)[:, None]
    return sides @ sides.T


@given(st.integers(0, 10_000), st.integers(1, 8), st.data())
def test_root_has_the_rank_of_the_covariance(seed, size, data):
    rank = data.draw(st.integers(1, size))
    covariance = covariance_of(seed, size, rank)
    lower = root(covariance)
    scale = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    # Nearly parallel draws may be of a lower rank within 1e-12 of the variance, 1e-6 of the sd.
    assert lower.shape[1] <= rank
    np.testing.assert_allclose(lower @ lower.T / scale, covariance / scale, atol=1e-6)


def test_root_leaves_out_what_does_not_vary():
    assert root(np.zeros((3, 3))).shape == (3, 0)
    np.testing.assert_allclose(root(np.diag([0.0, 4.0, 0.0])), [[0], [2], [0]])


def test_roots_of_many_are_those_of_each_whatever_their_ranks():
    many = np.array([np.diag([4.0, 1.0]), np.diag([0.0, 9.0]), np.zeros((2, 2)), [[4.0, 2.0], [2.0, 5.0]]])
    found = [lower.tolist() for lower in roots(many)]
    assert found == [[[2, 0], [0, 1]], [[0], [3]], [[], []], [[2, 0], [1, 2]]]


@pytest.mark.parametrize("size", [20, 21, 200])
@pytest.mark.parametrize("width", [1, 6, 8])
def test_draws_have_the_moments_of_the_standard_normal_exactly(size, width):
    points = standard_normals(size, width, np.random.default_rng(3))
    mean, covariance = weighted_moments(points, np.full(size, 1 / size))
    np.testing.assert_allclose(mean, 0, atol=1e-14)
    np.testing.assert_allclose(covariance, np.eye(width), atol=1e-13)
    assert points.shape == (size, width)


def test_draws_are_normal():
    points = standard_normals(20_000, 2, np.random.default_rng(5))
    # 10,000 independent pairs: the test sees one of each.
    assert stats.kstest(points[:10_000, 0], "norm").pvalue > 1e-3
    assert abs(stats.spearmanr(points[:10_000, 0], points[:10_000, 1])[0]) < 4 / np.sqrt(10_000)


def test_too_few_draws_are_refused():
    with pytest.raises(ValueError, match="at least 14"):
        standard_normals(13, 6, np.random.default_rng(0))


def test_sigma_points_match_two_moments():
    points = sigma_points(4, 4 + 1.0)
    weights = np.r_[1 / 5, np.full(8, 1 / 10)]
    mean, covariance = weighted_moments(points, weights)
    np.testing.assert_allclose(mean, 0, atol=1e-15)
    np.testing.assert_allclose(covariance, np.eye(4), atol=1e-15)


@pytest.mark.parametrize("degrees", [1, 2, 3, 4, 7, 8, 40])
def test_chi_square_is_scipys(degrees):
    for share in (1e-6, 0.01, 0.5, 0.95, 0.99, 0.999999):
        x = stats.chi2.ppf(share, degrees)
        assert chi_square_cdf(x, degrees) == pytest.approx(share, rel=1e-9)
        assert chi_square_quantile(share, degrees) == pytest.approx(x, rel=1e-9)
    assert chi_square_cdf(0.0, degrees) == 0.0
    assert chi_square_quantile(1.0, degrees) == np.inf


@given(st.integers(0, 10_000), st.integers(1, 6), st.data())
def test_update_is_that_of_information(seed, size, data):
    """P^-1 and P^-1 m add up: the textbook's other form, which shares no step with Joseph's."""
    seen = data.draw(st.integers(1, size))
    rng = np.random.default_rng(seed)
    prior, noise = (np.cov(rng.normal(size=(n, 3 * n))) * np.eye(n) + np.eye(n) for n in (size, seen))
    mean, measured, observe = rng.normal(size=size), rng.normal(size=seen), rng.normal(size=(seen, size))
    after = linear_update(mean, prior, measured - observe @ mean, observe, noise)
    information = np.linalg.inv(prior) + observe.T @ np.linalg.inv(noise) @ observe
    weighed = np.linalg.solve(prior, mean) + observe.T @ np.linalg.solve(noise, measured)
    np.testing.assert_allclose(after.covariance, np.linalg.inv(information), atol=1e-10)
    np.testing.assert_allclose(after.mean, np.linalg.solve(information, weighed), atol=1e-10)
    expected = stats.multivariate_normal(observe @ mean, observe @ prior @ observe.T + noise)
    density = np.atleast_1d(expected.logpdf(measured))[0]
    peak = -0.5 * np.linalg.slogdet(2 * np.pi * noise)[1]
    assert after.log_likelihood == pytest.approx(density - peak, abs=1e-9)


def test_update_stays_positive_where_the_short_form_does_not():
    """A sharp measurement of a vague state: (I - K H) P loses all digits, Joseph's form none that matter."""
    covariance, observe = np.diag([1e12, 1.0]), np.array([[1.0, 1e-3]])
    for _ in range(50):
        covariance = linear_update(
            np.zeros(2), covariance, np.zeros(1), observe, np.array([[1e-8]])
        ).covariance
        assert np.linalg.eigvalsh(covariance).min() > 0
        covariance = covariance + np.diag([1e3, 0.0])


@given(st.integers(0, 10_000), st.integers(1, 8), st.data())
def test_fields_with_independent_errors_taken_one_by_one_are_one_update(seed, size, data):
    columns = data.draw(st.lists(st.integers(0, size - 1), min_size=1, unique=True))
    rng = np.random.default_rng(seed)
    covariance, mean = covariance_of(seed, size, size + 2), rng.normal(size=size)
    sds = np.sqrt(np.diag(covariance))
    variances = (sds[columns] * 10.0 ** rng.uniform(-2, 2, len(columns))) ** 2
    measured = mean[columns] + sds[columns] * rng.normal(size=len(columns))
    observe = np.eye(size)[columns]
    whole = linear_update(mean, covariance, measured - mean[columns], observe, np.diag(variances))
    found = update_by_fields(mean, covariance, columns, measured, variances.tolist())
    np.testing.assert_allclose(found.mean / sds, whole.mean / sds, atol=1e-9)
    scale = np.outer(sds, sds)
    np.testing.assert_allclose(found.covariance / scale, whole.covariance / scale, atol=1e-9)
    np.testing.assert_array_equal(found.covariance, found.covariance.T)
    assert found.d2 == pytest.approx(whole.d2, rel=1e-7)
    assert found.log_likelihood == pytest.approx(whole.log_likelihood, rel=1e-7)


def test_the_root_of_one_covariance_is_that_among_many():
    for seed in range(20):
        covariance = covariance_of(seed, 6, 8)
        np.testing.assert_allclose(root(covariance), roots(covariance[None])[0], rtol=1e-8, atol=1e-12)
