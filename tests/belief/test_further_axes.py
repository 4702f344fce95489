"""Motions with further axes: of a whole box by hand, alone and confined to the image; in space as across."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayesnet_track.belief.gaussian.belief import predict
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.further_axes import BoxVelocityMotion, SpaceMotion
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.belief.motion.start_prior import make_start_prior
from bayesnet_track.graph.spec import BoxVelocity, Gaussian, InferenceNode, Motion, PixelSd

SETTINGS = BoxVelocity(
    sd_px=PixelSd(x=1, y=2, w=3, h=4),
    sd_velocity_px=PixelSd(x=0.1, y=0.2, w=0.3, h=0.4),
    start_sd_px=PixelSd(x=5, y=5, w=5, h=5),
    start_velocity_sd_px=PixelSd(x=6, y=6, w=7, h=7),
)
BOX = np.array([50.0, 40.0, 20.0, 30.0])


def motion_of(settings):
    root = InferenceNode(motion=Motion(box_velocity=settings))
    return BoxVelocityMotion(settings, make_start_prior(root, {}))


def test_moments_of_the_first_frame_and_after_a_step():
    motion = motion_of(SETTINGS)
    mean, covariance = motion.start_moments(BOX)
    assert mean.tolist() == [*BOX, 0, 0, 0, 0]
    assert np.diag(covariance).tolist() == [25, 25, 25, 25, 36, 36, 49, 49]
    mean[4:] = [1.0, -1.0, 2.0, -2.0]
    after, spread = predict(mean, covariance, motion, 2.0, Gaussian())
    assert after.tolist() == [52.0, 38.0, 24.0, 26.0, 1.0, -1.0, 2.0, -2.0]
    # x: 25 + 4 * 36 + 2 * 1; velocity: 36 + 2 * 0.01; both: 2 * 36
    assert spread[0, 0] == pytest.approx(171.0)
    assert spread[4, 4] == pytest.approx(36.02)
    assert spread[0, 4] == pytest.approx(72.0)


def test_drawn_states_have_these_moments():
    motion, rng = motion_of(SETTINGS), np.random.default_rng(1)
    states = motion.propagate(motion.start(BOX, 40_000, rng), 1.0, rng)
    assert states[:, 2:4].min() >= 1.0
    spread = motion.linearise(states[0], 1.0)
    expected = spread[0] @ motion.start_moments(BOX)[1] @ spread[0].T + spread[1]
    np.testing.assert_allclose(np.cov(states.T)[:2, :2], expected[:2, :2], atol=4 * 65 / 140)


@pytest.mark.parametrize(("leave", "x"), [(False, 0.0), (True, -20.0)])
def test_centres_stop_at_the_border_unless_they_may_leave(leave, x):
    motion = Confined(BoxVelocityMotion(SETTINGS.model_copy(update={"leave_image": leave})), 100, 80)
    mean, covariance = motion.start_moments(np.array([5.0, 40.0, 20.0, 30.0]))
    mean[4] = -25.0
    after, _ = predict(mean, covariance, motion, 1.0, Gaussian())
    assert after[0] == x
    assert motion.extent.tolist() == ([np.inf, np.inf] if leave else [100.0, 80.0])


def test_time_has_to_move_forward():
    with pytest.raises(ValueError, match="positive and finite, not 0"):
        BoxVelocityMotion(SETTINGS).linearise(np.zeros(8), 0.0)


def in_space(kind="constant_velocity", sd_z=0.3, **settings):
    across = make_motion(Motion.model_validate({kind: {"sd_px": {"x": sd_z, "y": sd_z}, **settings}}))
    return SpaceMotion(replace(across, least_side=0.01), sd_z)


KINDS = ["random_walk", "constant_velocity", "damped_velocity", "constant_acceleration"]
PLACE = np.array([1.0, 2.0, 0.5, 0.5, 3.0])


@pytest.mark.parametrize("kind", KINDS)
def test_upwards_a_target_moves_as_across(kind):
    motion = in_space(kind)
    transition, noise = motion.linearise(np.arange(1.0, len(motion.fields) + 1.0), 0.7)
    at = {name: column for column, name in enumerate(motion.fields)}
    chains = [
        [at[f"{prefix}{axis}"] for prefix in ("", "v", "a") if f"{prefix}{axis}" in at] for axis in "xyz"
    ]
    for matrix in (transition, noise):
        x, y, z = (matrix[np.ix_(chain, chain)] for chain in chains)
        np.testing.assert_array_equal(x, y)
        np.testing.assert_allclose(x, z, atol=1e-15)
    assert not transition[np.ix_(chains[0], chains[2])].any()


def test_drawn_states_in_space_have_the_moments_of_the_start_and_of_a_step():
    motion, rng, size = in_space(), np.random.default_rng(2), 40_000
    mean, covariance = motion.start_moments(PLACE)
    assert mean[[0, 1, 2, 3, 6, 7]].tolist() == [1.0, 2.0, 0.5, 0.5, 3.0, 0.0]
    states = motion.propagate(motion.start(PLACE, size, rng), 0.5, rng)
    transition, noise = motion.linearise(mean, 0.5)
    expected = transition @ covariance @ transition.T + noise
    errors = np.sqrt((expected**2 + np.outer(np.diag(expected), np.diag(expected))) / size)
    assert (np.abs(np.cov(states.T) - expected) <= 5 * errors + 1e-12).all()
    drifted = motion.drift(mean[None] + np.eye(8), 0.5)
    np.testing.assert_allclose(drifted, (mean + np.eye(8)) @ transition.T, atol=1e-12)


def test_the_density_in_space_is_the_normal_one():
    motion = in_space(sd_px={"x": 0.3, "y": 0.3, "w": 0.1, "h": 0.1})
    previous = np.tile(motion.start_moments(PLACE)[0], (2, 1)) + np.eye(2, 8)
    states = previous + 0.1 * np.random.default_rng(3).standard_normal((2, 8))
    transition, noise = motion.linearise(previous[0], 0.5)
    expected = [
        [multivariate_normal(transition @ before, noise).logpdf(state) for before in previous]
        for state in states
    ]
    np.testing.assert_allclose(motion.log_density(states, previous, 0.5), expected, rtol=1e-9)
