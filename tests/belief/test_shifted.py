"""The camera and the size's prior, exact maps before the motion; and noise that widens."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.belief.gaussian.belief import predict
from bayesnet_track.belief.motion.composed import inflate_noise, inflation_factor, revert_size
from bayesnet_track.belief.motion.delayed import CameraShift, ShiftedMotion, camera_shift
from bayesnet_track.belief.motion.formulas import derivative
from bayesnet_track.belief.motion.models import linear_gaussian
from bayesnet_track.graph import spec
from bayesnet_track.graph.spec import SizeReversion

BOX = np.array([160.0, 120.0, 60.0, 40.0])
FLOW = np.array([[0.02, -0.05, 3.0], [0.05, 0.02, -4.0]])
KALMAN = spec.Gaussian(filter="kalman")


def states_around(motion, rng, size=7):
    states = motion.start(BOX, size, rng)
    states[:, :2] += 20.0 * rng.standard_normal((size, 2))
    states[:, 2:4] *= np.exp(0.2 * rng.standard_normal((size, 2)))
    return states


@pytest.mark.parametrize("dt", [0.5, 1.0, 3.0])
def test_a_background_point_stays_on_the_background(dt):
    shift = camera_shift(FLOW, dt)
    before = np.array([[40.0, 200.0, 10.0, 10.0]])
    after = shift.apply(before)[0, :2]
    # The flow is told at the present place: x' - dt M (x', 1) is where the point was.
    np.testing.assert_allclose(after - dt * FLOW @ [*after, 1.0], before[0, :2], atol=1e-12)
    assert camera_shift(np.zeros((2, 3)), dt) is None


def test_the_camera_moves_a_kalman_belief_exactly(linear):
    shift, dt = camera_shift(FLOW, 1.0), 1.0
    motion = ShiftedMotion(linear, shift)
    mean, spread = linear.start_moments(BOX)
    spread = spread + np.diag(np.arange(1.0, len(mean) + 1))
    moves, noise = linear_gaussian(linear, dt)
    whole = np.eye(len(mean))
    offset = np.zeros(len(mean))
    offset[:2] = shift.offset
    for column in (0, *range(4, len(mean), 2)):
        whole[column : column + 2, column : column + 2] = shift.linear
    found_mean, found_spread = predict(mean, spread, motion, dt, KALMAN)
    np.testing.assert_allclose(found_mean, moves @ (whole @ mean + offset), rtol=1e-12)
    np.testing.assert_allclose(found_spread, moves @ whole @ spread @ whole.T @ moves.T + noise, rtol=1e-12)


def test_particles_carried_have_the_kalman_moments(linear, rng):
    motion, size = ShiftedMotion(linear, camera_shift(FLOW, 1.0)), 40_000
    mean, spread = motion.start_moments(BOX)
    exact_mean, exact_spread = predict(mean, spread, motion, 1.0, KALMAN)
    parents = np.arange(size)[::-1]
    drawn = motion.propagate(motion.start(BOX, size, rng), 1.0, rng, parents)
    sds = np.sqrt(np.diag(exact_spread))
    # Means within 5 standard errors, sds within 5 of theirs, 1 / sqrt(2 N).
    assert (np.abs(drawn.mean(axis=0) - exact_mean) < 5 * sds / np.sqrt(size)).all()
    np.testing.assert_allclose(drawn.std(axis=0), sds, rtol=5 / np.sqrt(2 * size))


def test_the_jacobians_are_the_derivatives(motion_of, rng):
    walk = motion_of("random_walk", sd_px={"x": 1.0, "y": 1.0}, sd_log={"scale": 0.1, "aspect": 0.05})
    kept = revert_size(walk, SizeReversion(sd_scale=0.3, sd_aspect=0.2), np.array([30.0, 55.0]), 2.0)
    moving = ShiftedMotion(
        motion_of("constant_velocity"), CameraShift(np.array([[1.1, 0.2], [-0.2, 1.1]]), np.ones(2))
    )
    for motion in (kept, moving):
        state = states_around(motion, rng)[0]
        exact = derivative(lambda states, motion=motion: motion.drift(states, 2.0), state)
        np.testing.assert_allclose(motion.linearise(state, 2.0)[0], exact, rtol=1e-6, atol=1e-7)


def test_the_size_is_an_ornstein_uhlenbeck_process(motion_of):
    """Two half steps are one, many steps have the long run's sd, and a wide prior is the random walk."""
    step, limit = 0.1, 0.3
    walk = motion_of("random_walk", sd_px={"x": 1.0, "y": 1.0}, sd_log={"scale": step})
    settings = SizeReversion(sd_scale=limit)

    def moments(dt):
        kept = revert_size(walk, settings, BOX[2:4], dt)
        return kept.shift.keep[0], kept.motion.noise.sd_log.scale**2 * dt

    whole_keep, whole = moments(3.0)
    half_keep, half = moments(1.5)
    assert half_keep**2 == pytest.approx(whole_keep)
    assert half_keep**2 * half + half == pytest.approx(whole)
    keep, variance = moments(1.0)
    assert variance / (1 - keep**2) == pytest.approx(limit**2)
    assert keep == pytest.approx(np.exp(-(step**2) / (2 * limit**2)))
    far = revert_size(walk, SizeReversion(sd_scale=1e4), BOX[2:4], 1.0)
    # 1 - keep^2 is 1e-10 there, and its last digit 2e-16: 1e-6 of the sd.
    assert far.motion.noise.sd_log.scale == pytest.approx(step, rel=1e-5)
    states = np.array([[0.0, 0.0, 6.0, 4.0]])
    np.testing.assert_allclose(far.drift(states, 1.0), states, rtol=1e-9)


def test_a_size_drawn_back_keeps_its_shape_and_does_not_collapse(motion_of, rng):
    walk = motion_of("random_walk", sd_px={"x": 1.0, "y": 1.0}, sd_log={"scale": 0.05})
    motion = revert_size(walk, SizeReversion(sd_scale=0.2), BOX[2:4], 1.0)
    states = np.tile(BOX / [1, 1, 8, 8], (4000, 1))
    for _ in range(200):  # 6 time constants of 2 S^2 / s^2 = 32 frames
        states = motion.propagate(states, 1.0, rng)
    log = np.log(states[:, 2] / BOX[2])
    np.testing.assert_allclose(states[:, 2] / states[:, 3], 1.5, rtol=1e-9)
    # The start, log 8 away, is forgotten but for e^-6; sd within 5 of its errors.
    assert abs(log.mean() + np.log(8) * np.exp(-200 / 32)) < 5 * 0.2 / np.sqrt(4000)
    assert log.std() == pytest.approx(0.2, rel=5 / np.sqrt(2 * 4000))


def test_densities_are_those_of_the_motion_from_the_shifted_states(motion_of, rng):
    walk = motion_of("random_walk", sd_box={"x": 0.1, "y": 0.2}, sd_log={"scale": 0.05, "aspect": 0.02})
    kept = revert_size(walk, SizeReversion(sd_scale=0.3, sd_aspect=0.2), np.array([30.0, 55.0]), 1.0)
    motion = ShiftedMotion(kept, camera_shift(FLOW, 1.0))
    old, new = states_around(walk, rng), states_around(walk, rng, 5)
    once = camera_shift(FLOW, 1.0).apply(old)
    expected = kept.motion.log_density(new, kept.shift.apply(once), 1.0)
    np.testing.assert_allclose(motion.log_density(new, old, 1.0), expected)


@pytest.mark.parametrize(("doubt", "factor"), [(0.0, 1.0), (1.0, 1.0), (4.0, 2.0), (1e9, 3.0)])
def test_noise_widens_with_the_root_of_the_doubt(motion_of, doubt, factor):
    motion = motion_of(
        "constant_velocity",
        sd_velocity_px=1.5,
        sd_px={"x": 1.0, "w": 0.4},
        sd_box={"y": 0.1},
        sd_log={"scale": 0.1},
    )
    wide = inflate_noise(motion, inflation_factor(doubt, 3.0))
    assert (wide is motion) == (factor == 1.0)
    state = np.r_[BOX, 1.0, 2.0]
    moves, spread = motion.linearise(state, 2.0)
    wide_moves, wide_spread = wide.linearise(state, 2.0)
    scale = np.ones((6, 6))
    position = np.array([0, 1, 4, 5])
    scale[np.ix_(position, position)] = factor**2
    np.testing.assert_allclose(wide_moves, moves)
    np.testing.assert_allclose(wide_spread, scale * spread, rtol=1e-12)


def test_only_what_has_a_limit_and_noise_is_drawn_back(motion_of):
    """By the closed form over three frames; the other of scale and aspect stays a random walk."""
    noise = {"sd_px": {"x": 1.0, "y": 1.0}, "sd_log": {"scale": 0.1, "aspect": 0.05}}
    walk, first = motion_of("random_walk", **noise), np.array([30.0, 55.0])
    for settings, n, sd, limit in (
        (SizeReversion(sd_scale=0.3), 0, 0.1, 0.3),
        (SizeReversion(sd_aspect=0.2), 1, 0.05, 0.2),
    ):
        kept = revert_size(walk, settings, first, 3.0)
        keep = np.exp(-3.0 * sd**2 / (2 * limit**2))
        assert kept.shift.keep[n] == pytest.approx(keep, rel=1e-12) and kept.shift.keep[1 - n] == 1.0
        sds = kept.motion.noise.sd_log.scale, kept.motion.noise.sd_log.aspect
        assert sds[n] == pytest.approx(limit * np.sqrt((1 - keep**2) / 3.0), rel=1e-12)
        assert sds[1 - n] == (0.1, 0.05)[1 - n]
        np.testing.assert_allclose(kept.shift.first, [np.log(30 * 55) / 2, np.log(30 / 55)], rtol=1e-12)
    still = revert_size(
        motion_of("random_walk", sd_px={"x": 1.0, "y": 1.0}), SizeReversion(sd_scale=0.3), first, 2.0
    )
    assert still.shift.keep.tolist() == [1.0, 1.0] and still.motion.noise.sd_log.scale == 0.0
