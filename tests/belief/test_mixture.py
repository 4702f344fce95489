"""The mixture of Gaussians that a belief in modes is."""

import numpy as np

from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.gaussian.modal import ModalPosterior, mix

FIELDS = ("x", "y", "w", "h")


def posterior(*means, shares):
    parts = (GaussianPosterior(np.array([mean, 0.0, 9.0, 9.0]), np.eye(4), FIELDS, 9) for mean in means)
    return ModalPosterior(tuple(parts), np.array(shares))


def test_mixing_keeps_mean_and_covariance_of_the_whole():
    before = posterior(10.0, 20.0, shares=(0.3, 0.7))
    after = mix(before, np.array([[0.9, 0.1], [0.2, 0.8]]))
    np.testing.assert_allclose(after.mode_probabilities, [0.41, 0.59])
    np.testing.assert_allclose(after.mean, before.mean)
    np.testing.assert_allclose(after.covariance, before.covariance, atol=1e-9)
    np.testing.assert_allclose(after.parts[0].mean[0], (0.27 * 10 + 0.14 * 20) / 0.41)


def test_a_region_of_two_far_modes_lies_at_both():
    low, high, _, _ = posterior(0.0, 100.0, shares=(0.5, 0.5)).regions((0.9,))[0]
    np.testing.assert_allclose([low, high], [-1.28155, 101.28155], atol=1e-4)
