"""Estimates, covariance and central regions of weighted sets written out."""

import numpy as np
import pytest

from bayesnet_track.belief.contract import BOX_FIELDS, Evidence, Step, estimate
from bayesnet_track.belief.particles.belief import ParticleSet
from bayesnet_track.graph import spec
from bayesnet_track.numerics.log_weights import LogWeights

STATES = np.array(
    [
        [100.0, 50.0, 40.0, 10.0],
        [104.0, 50.0, 40.0, 10.0],
        [300.0, 50.0, 40.0, 10.0],
        [100.0, 58.0, 40.0, 10.0],
    ]
)
WEIGHTS = np.array([0.4, 0.2, 0.3, 0.1])


def particles(states, weights):
    with np.errstate(divide="ignore"):
        return ParticleSet(states, BOX_FIELDS, LogWeights.normalise(np.log(weights))[0])


def chosen(word, posterior):
    evidence = Evidence(np.zeros(4))
    step = Step(posterior, 0.0, posterior, posterior.weights, evidence, lambda: posterior.states[3])
    return estimate(None if word is None else spec.Estimate.model_validate(word), step)


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        (None, STATES[3]),
        ("map", STATES[3]),
        ("max_weight", STATES[0]),
        ("mean", [160.8, 50.8, 40, 10]),
        # The window is .25 * sqrt(40 * 10) = 5 px: the fourth, 8 px below, is out.
        ("robust_mean", [100 + 4 / 3, 50, 40, 10]),
        ({"robust_mean": {"box": 0.5}}, [100 + 8 / 7, 50 + 8 / 7, 40, 10]),
        ({"robust_mean": {"box": 0.1}}, STATES[0]),
    ],
)
def test_each_estimate(word, expected):
    np.testing.assert_allclose(chosen(word, particles(STATES, WEIGHTS)), expected)


def test_covariance_is_the_weighted_one():
    np.testing.assert_allclose(
        particles(STATES, WEIGHTS).covariance, np.cov(STATES.T, aweights=WEIGHTS, ddof=0), atol=1e-9
    )


def test_covariance_is_zero_when_one_hypothesis_holds_all():
    cov = particles(STATES, np.array([0.0, 1.0, 0.0, 0.0])).covariance
    np.testing.assert_array_equal(cov, np.zeros((4, 4)))


def test_covariance_is_symmetric_and_positive(rng):
    posterior = particles(rng.normal(1e4, 1e-3, (300, 4)), rng.random(300))
    cov = posterior.covariance
    np.testing.assert_allclose(cov, cov.T, rtol=1e-12)
    assert np.linalg.eigvalsh(cov).min() > 0


@pytest.mark.parametrize(("share", "reach"), [(0.5, 0.6745), (0.9, 1.6449)])
def test_central_regions_of_a_gaussian(share, reach, rng):
    """Uniform draws weighted by the density of N((10, 20), (2, 3)^2)."""
    count = 40_000
    states = np.tile([0.0, 0.0, 5.0, 5.0], (count, 1))
    states[:, 0], states[:, 1] = rng.uniform(0, 20, count), rng.uniform(5, 35, count)
    z = (states[:, :2] - [10, 20]) / [2, 3]
    region = particles(states, np.exp(-0.5 * np.sum(z**2, axis=1))).regions((share,))[0]
    expected = [10 - 2 * reach, 10 + 2 * reach, 20 - 3 * reach, 20 + 3 * reach]
    # A quantile's standard error is sqrt(q (1 - q) / ESS) / density: .03 sd at an ESS of 5,000; 4 of it.
    np.testing.assert_allclose(region, expected, atol=4 * 0.03 * 3)


def test_central_region_of_one_hypothesis_is_a_point():
    region = particles(STATES, np.array([0.0, 0.0, 1.0, 0.0])).regions((0.9,))[0]
    assert region.tolist() == [300, 300, 50, 50]
