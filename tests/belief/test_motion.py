"""Motion models compose over time, and their densities are those of their draws."""

import numpy as np
import pytest

from bayesnet_track.belief.motion.models import linear_gaussian, make_motion
from bayesnet_track.belief.motion.noise import (
    LOG_SIZE_LIMIT,
    component_log_shares,
    component_variances,
    log_noise_density,
    sample_noise,
)
from bayesnet_track.graph import spec

BOX = np.array([160.0, 120.0, 60.0, 40.0])
GENERAL = {
    "sd_px": {"x": 1.0, "w": 0.4, "h": 0.3},
    "sd_box": {"x": 0.05, "y": 0.1},
    "sd_log": {"scale": 0.02, "aspect": 0.01},
    "heavy_tail": {"weight": 0.3, "factor": 4},
}


@pytest.mark.parametrize("dt", [0.1, 1.0, 7.0])
def test_two_half_steps_are_one_step(linear, dt):
    moves, spread = linear_gaussian(linear, dt)
    half, half_spread = linear_gaussian(linear, dt / 2)
    np.testing.assert_allclose(half @ half, moves, atol=1e-12)
    np.testing.assert_allclose(half @ half_spread @ half.T + half_spread, spread, rtol=1e-9, atol=1e-12)


def test_the_textbook_matrices_of_constant_velocity(motion_of):
    dt, q = 2.5, 1.5**2
    moves, spread = linear_gaussian(motion_of("constant_velocity", sd_velocity_px=1.5), dt)
    np.testing.assert_allclose(moves[np.ix_([0, 4], [0, 4])], [[1, dt], [0, 1]], atol=1e-12)
    expected = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    np.testing.assert_allclose(spread[np.ix_([1, 5], [1, 5])], expected, rtol=1e-10)


def test_the_textbook_matrices_of_constant_acceleration(motion_of):
    dt, q = 1.7, 0.4**2
    moves, spread = linear_gaussian(motion_of("constant_acceleration", sd_acceleration_px=0.4), dt)
    columns = np.ix_([0, 4, 6], [0, 4, 6])
    np.testing.assert_allclose(moves[columns], [[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]], atol=1e-12)
    expected = q * np.array(
        [
            [dt**5 / 20, dt**4 / 8, dt**3 / 6],
            [dt**4 / 8, dt**3 / 3, dt**2 / 2],
            [dt**3 / 6, dt**2 / 2, dt],
        ]
    )
    np.testing.assert_allclose(spread[columns], expected, rtol=1e-10)


@pytest.mark.parametrize(("damping", "dt"), [(0.25, 1.0), (0.25, 200.0), (20.0, 50.0)])
def test_damped_velocity_is_the_ornstein_uhlenbeck_process(motion_of, damping, dt):
    motion = motion_of("damped_velocity", sd_velocity_px=1.5, damping=damping)
    moves, spread = linear_gaussian(motion, dt)
    a, q, e = damping, 1.5**2, np.exp(-damping * dt)
    columns = np.ix_([0, 4], [0, 4])
    np.testing.assert_allclose(moves[columns], [[1, (1 - e) / a], [0, e]], rtol=1e-9, atol=1e-12)
    xv = q * (1 - e) ** 2 / (2 * a**2)
    xx = q / a**2 * (dt - 2 * (1 - e) / a + (1 - e**2) / (2 * a))
    np.testing.assert_allclose(
        spread[columns], [[xx, xv], [xv, q * (1 - e**2) / (2 * a)]], rtol=1e-9, atol=1e-12
    )


def test_hardly_damped_velocity_is_constant_velocity(motion_of):
    damped = linear_gaussian(motion_of("damped_velocity", damping=1e-9), 3.0)
    constant = linear_gaussian(motion_of("constant_velocity", sd_velocity_px=1.0), 3.0)
    for one, other in zip(damped, constant, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("steps", [[2.0], [0.5, 1.5]])
def test_draws_have_the_stated_mean_and_covariance(linear, steps, rng):
    count = 60_000
    old = linear.start(BOX, 1, rng)[0]
    states = np.tile(old, (count, 1))
    for dt in steps:
        states = linear.propagate(states, dt, rng)
    moves, spread = linear_gaussian(linear, 2.0)
    sd = np.sqrt(spread.diagonal())
    # Five standard errors: sd / sqrt(N) of a mean, sqrt(2 / N) at most of a covariance over both sds.
    assert np.all(np.abs(states.mean(axis=0) - moves @ old) < 5 * sd / np.sqrt(count))
    error = (np.cov(states.T) - spread) / np.outer(sd, sd)
    assert np.abs(error).max() < 5 * np.sqrt(2 / count)


def test_density_is_the_gaussian_of_the_model(linear, rng):
    old, dt = linear.propagate(linear.start(BOX, 5, rng), 1.0, rng), 1.5
    new = linear.propagate(old, dt, rng)[:4]
    moves, spread = linear_gaussian(linear, dt)
    away = new[:, None] - (old @ moves.T)[None]
    square = np.einsum("mnd,de,mne->mn", away, np.linalg.inv(spread), away)
    expected = -0.5 * (square + np.linalg.slogdet(2 * np.pi * spread)[1])
    np.testing.assert_allclose(linear.log_density(new, old, dt), expected, rtol=1e-8)


def test_density_of_general_noise_integrates_to_one(rng):
    """Importance sampling from a wider Gaussian box: the mean of density / proposal is 1."""
    noise = spec.Noise.model_validate(GENERAL)
    count, sd = 400_000, np.array([25.0, 25.0, 3.0, 2.5])
    draws = rng.standard_normal((count, 4))
    new = BOX + draws * sd
    proposal = -0.5 * np.sum(draws**2, axis=1) - np.sum(np.log(sd * np.sqrt(2 * np.pi)))
    ratio = np.exp(log_noise_density(noise, new, BOX[None])[:, 0] - proposal)
    assert abs(ratio.mean() - 1) < 4.5 * ratio.std() / np.sqrt(count)
    assert ratio.std() / np.sqrt(count) < 0.02


def test_draws_of_general_noise_follow_its_density(rng):
    """E log p of the draws is minus the entropy: the same as under importance sampling of p."""
    noise = spec.Noise.model_validate(GENERAL)
    old = np.tile(BOX, (100_000, 1))
    own = log_noise_density(noise, sample_noise(noise, old, rng), BOX[None])[:, 0]
    sd, count = np.array([25.0, 25.0, 3.0, 2.5]), 400_000
    draws = rng.standard_normal((count, 4))
    log_p = log_noise_density(noise, BOX + draws * sd, BOX[None])[:, 0]
    ratio = np.exp(log_p + 0.5 * np.sum(draws**2, axis=1) + np.sum(np.log(sd * np.sqrt(2 * np.pi))))
    error = np.hypot(own.std() / np.sqrt(own.size), (ratio * log_p).std() / np.sqrt(count))
    assert abs(own.mean() - (ratio * log_p).mean()) < 4.5 * error


def test_variances_grow_with_time_and_with_the_box(rng):
    noise = spec.Noise.model_validate({"sd_box": {"x": 0.1}, "sd_px": {"x": 3.0}})
    for box, dt in [(BOX, 1.0), (BOX * [1, 1, 4, 4], 4.0)]:
        x = sample_noise(noise, np.tile(box, (50_000, 1)), rng, dt)[:, 0]
        expected = dt * (9 + 0.01 * box[2] * box[3])
        assert x.var() == pytest.approx(expected, rel=5 * np.sqrt(2 / 50_000))


def test_dimensions_without_noise_stay_and_are_left_out(rng):
    noise = spec.Noise.model_validate({"sd_px": {"y": 2.0}})
    new = sample_noise(noise, np.tile(BOX, (100, 1)), rng)
    np.testing.assert_array_equal(new[:, [0, 2, 3]], np.tile(BOX[[0, 2, 3]], (100, 1)))
    expected = -0.5 * ((new[:, 1] - BOX[1]) / 2) ** 2 - np.log(2 * np.sqrt(2 * np.pi))
    np.testing.assert_allclose(log_noise_density(noise, new, BOX[None])[:, 0], expected)
    assert np.all(log_noise_density(spec.Noise(), new, BOX[None]) == 0)


def test_a_stated_share_takes_the_wide_noise(rng):
    noise = spec.Noise.model_validate({"sd_px": {"x": 1.0}, "heavy_tail": {"weight": 0.25, "factor": 1000}})
    far = np.zeros(400)
    for _ in range(50):
        far += np.abs(sample_noise(noise, np.tile(BOX, (400, 1)), rng)[:, 0] - BOX[0]) > 6
    # P(wide draw within 6 px) = .5 %; 100 of 400 are wide every time, anywhere in the set.
    assert 50 * 97 < far.sum() <= 50 * 100
    # Binomial(50, 1/4) of each hypothesis: mean 12.5, sd 3.06; five sd over 400 of them.
    assert far.min() > 0 and far.max() < 12.5 + 5 * 3.06


@pytest.mark.parametrize("dt", [1.0, 2.5])
def test_size_changes_are_limited_in_log_and_sizes_stay_positive(dt, rng):
    noise = spec.Noise.model_validate({"sd_log": {"scale": 0.5, "aspect": 0.5}})
    new = sample_noise(noise, np.tile(BOX, (5000, 1)), rng, dt)
    change = np.log(new[:, 2:] / BOX[2:])
    assert np.abs(change).max() == pytest.approx(LOG_SIZE_LIMIT * dt)
    small = np.tile([5.0, 5.0, 1.0, 2.0], (5000, 1))
    in_px = spec.Noise.model_validate({"sd_px": {"w": 9.0, "h": 9.0}})
    for kind in (noise, in_px):
        assert sample_noise(kind, small, rng, dt)[:, 2:].min() == 1.0


def test_start_is_the_box_with_unknown_derivatives(linear, rng):
    states = linear.start(BOX, 20_000, rng)
    assert states.shape == (20_000, len(linear.fields))
    np.testing.assert_array_equal(states[:, :4], np.tile(BOX, (20_000, 1)))
    expected = np.repeat(linear.start_sd, 2)
    np.testing.assert_allclose(states[:, 4:].std(axis=0), expected, rtol=5 / np.sqrt(2 * 20_000))


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, np.inf])
def test_time_must_move_forward(linear, dt, rng):
    with pytest.raises(ValueError, match="positive and finite"):
        linear.propagate(linear.start(BOX, 3, rng), dt, rng)


@pytest.mark.parametrize("word", ["sd_box", "sd_log", "heavy_tail"])
def test_only_pixel_noise_is_linear_gaussian(word):
    motion = make_motion(spec.Motion.model_validate({"random_walk": {word: GENERAL[word]}}))
    with pytest.raises(ValueError, match="linear-Gaussian"):
        linear_gaussian(motion, 1.0)


@pytest.mark.parametrize(
    "noise",
    [
        {"sd_px": {"x": 2.0, "y": 3.0, "w": 1.0, "h": 0.5}},
        {"sd_px": {"x": 1.0}, "sd_box": {"x": 0.1, "y": 0.2}},
        {"sd_box": {"x": 0.1}, "sd_log": {"scale": 0.05, "aspect": 0.03}},
        {"sd_px": {"w": 2.0, "h": 1.0}, "sd_log": {"scale": 0.05, "aspect": 0.03}},
        {"sd_box": {"x": 0.1, "y": 0.1}, "heavy_tail": {"weight": 0.2, "factor": 5.0}},
    ],
)
@pytest.mark.parametrize("dt", [1.0, 2.5])
def test_linearised_noise_is_that_of_its_components(motion_of, noise, dt):
    """Written with matrices: the variances of the coordinates, brought to w and h by the slopes."""
    motion = motion_of("constant_velocity", sd_velocity_px=3.0, **noise)
    bare = motion_of("constant_velocity", sd_velocity_px=3.0, sd_px={"x": 1e-9})
    state = np.array([100.0, 80.0, 40.0, 30.0, 2.0, -1.0])
    shares = np.exp(component_log_shares(motion.noise))
    variances = shares @ component_variances(motion.noise, state[None, :4], dt)[:, 0]
    slopes = np.eye(4)
    if "sd_log" in noise:
        slopes[2:, 2:] = [[40.0, 20.0], [30.0, -15.0]]
    expected = slopes @ np.diag(variances) @ slopes.T
    moves, found = motion.linearise(state, dt)
    assert moves @ state == pytest.approx(motion.drift(state[None], dt)[0])
    np.testing.assert_allclose((found - bare.linearise(state, dt)[1])[:4, :4], expected, rtol=1e-9, atol=1e-9)
