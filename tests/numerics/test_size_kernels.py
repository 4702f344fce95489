"""Sizes of detections against the covariance and the density of NumPy and SciPy."""

import numpy as np
import pytest
from scipy import stats

from bayesnet_track.numerics.association import follow_sizes, log_size_densities


def boxes(seed, count):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(0, 900, (count, 2)), rng.lognormal([4, 5], [0.3, 0.2], (count, 2))])


def test_the_first_sizes_are_half_assumed():
    seen = boxes(0, 30)
    logs = np.log(seen[:, 2:])
    mean, covariance = follow_sizes(seen, np.zeros(2), np.eye(2), 0.0, 0.25)
    np.testing.assert_allclose(mean, logs.mean(axis=0))
    np.testing.assert_allclose(covariance, 0.125 * np.eye(2) + np.cov(logs.T, bias=True) / 2)


@pytest.mark.parametrize("count", [1, 20])
def test_further_sizes_weigh_by_how_many_they_are(count):
    first, second = boxes(1, 40), boxes(2, count)
    before, now = np.log(first[:, 2:]), np.log(second[:, 2:])
    known = before.mean(axis=0), np.cov(before.T, bias=True)
    mean, covariance = follow_sizes(second, *known, 40.0, 0.25)
    np.testing.assert_allclose(mean, np.concatenate([before, now]).mean(axis=0))
    np.testing.assert_allclose(covariance, np.cov(np.concatenate([before, now]).T, bias=True), atol=1e-15)


def test_the_density_is_that_of_a_log_normal():
    seen, mean = boxes(3, 25), np.array([4.1, 4.8])
    covariance = np.array([[0.09, 0.03], [0.03, 0.05]])
    logs = np.log(seen[:, 2:])
    expected = stats.multivariate_normal(mean, covariance + 0.01 * np.eye(2)).logpdf(logs) - logs.sum(axis=1)
    np.testing.assert_allclose(log_size_densities(seen, mean, covariance, 0.01), expected, rtol=1e-12)


def test_a_side_below_a_pixel_counts_as_one():
    seen = np.array([[5.0, 5.0, 0.2, 0.0], [5.0, 5.0, 1.0, 1.0]])
    found = log_size_densities(seen, np.zeros(2), np.eye(2), 0.0)
    assert found[0] == found[1]
