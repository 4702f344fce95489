"""p-values are uniform under the model, for one Gaussian and for mixtures."""

import numpy as np
from scipy import stats

from bayesnet_track.numerics.distributions import p_after, p_value
from bayesnet_track.numerics.gaussian import linear_update

COVARIANCE = np.array([[4.0, 1.5], [1.5, 2.0]])


def test_of_one_gaussian_it_is_chi_square():
    value = np.array([3.0, -1.0])
    d2 = value @ np.linalg.solve(COVARIANCE, value)
    found = p_value(value, np.ones(1), np.zeros((1, 2)), COVARIANCE[None])
    np.testing.assert_allclose(found, stats.chi2.sf(d2, 2), atol=1e-6)


def test_of_one_gaussian_said_as_many_it_is_the_same():
    value, weights = np.array([3.0, -1.0]), np.array([0.2, 0.8])
    many = p_value(value, weights, np.zeros((2, 2)), COVARIANCE[None])
    np.testing.assert_allclose(
        many, p_value(value, np.ones(1), np.zeros((1, 2)), COVARIANCE[None]), atol=2e-6
    )


def test_draws_of_a_mixture_have_uniform_p_values():
    rng = np.random.default_rng(0)
    weights, means = np.array([0.5, 0.3, 0.2]), np.array([[0.0, 0.0], [9.0, 1.0], [3.0, -8.0]])
    covariances = np.array([COVARIANCE, np.diag([0.5, 9.0]), 3 * COVARIANCE])
    found = []
    for k in rng.choice(3, 400, p=weights):
        value = rng.multivariate_normal(means[k], covariances[k])
        found.append(p_value(value, weights, means, covariances))
    assert stats.kstest(found, "uniform").pvalue > 1e-3
    assert p_value(np.array([30.0, 30.0]), weights, means, covariances) < 1e-6


def test_the_update_tells_what_was_predicted():
    mean, spread, noise = np.array([1.0, 2.0]), 2 * COVARIANCE, np.diag([1.0, 3.0])
    value = np.array([4.0, 0.0])
    after = linear_update(mean, spread, value - mean, np.eye(2), noise)
    before = p_value(value, np.ones(1), mean[None], (spread + noise)[None])
    found = p_after(value[None], noise[None], after.mean[None], after.covariance[None])
    np.testing.assert_allclose(found, [before], atol=2e-6)
