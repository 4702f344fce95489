"""Chains of derivatives: what is computed for one axis agrees with what it stands for."""

import numpy as np
import pytest

from bayesnet_track.belief.motion.models import steps, unmixing

DAMPED = ((0.0, 1.0), (0.0, -0.25))
ACCELERATING = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))


@pytest.mark.parametrize("dynamics", [DAMPED, ACCELERATING])
def test_three_steps_have_the_moments_of_one(dynamics):
    move, covariance = steps(dynamics, 2.0, 0.5)
    twice = covariance + move @ covariance @ move.T
    whole = covariance + move @ twice @ move.T
    np.testing.assert_allclose(steps(dynamics, 2.0, 1.5)[1], whole, rtol=1e-12)
    np.testing.assert_allclose(steps(dynamics, 2.0, 1.5)[0], move @ move @ move, rtol=1e-12)


@pytest.mark.parametrize("dynamics", [DAMPED, ACCELERATING])
def test_unmixed_noise_is_independent(dynamics):
    chain = unmixing(dynamics, 2.0, 1.5)
    axis = chain.unmix[::2, ::2]
    np.testing.assert_allclose(
        axis @ steps(dynamics, 2.0, 1.5)[1] @ axis.T, np.diag(chain.pivots), atol=1e-10
    )
