"""Smoothing is exact: against the joint Gaussian, against enumeration, and one against the other."""

import numpy as np
import pytest

from bayesnet_track.belief.contract import BOX_FIELDS
from bayesnet_track.belief.gaussian.belief import GaussianPosterior, predict
from bayesnet_track.belief.motion.jumps import Jumping
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.belief.smoothing import Move, smooth_gaussians, smooth_particles
from bayesnet_track.graph import spec
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.runtime.smoothing import NO_SEARCH

FIELDS = (*BOX_FIELDS, "vx", "vy")
VELOCITY = {
    "constant_velocity": {"sd_velocity_px": 1.0, "start_velocity_sd_px": 3.0, "sd_px": {"x": 0.5, "y": 0.5}}
}
WALK = {"random_walk": {"sd_px": {"x": 2.0, "y": 3.0}}}
BOX = np.array([50.0, 40.0, 20.0, 10.0])
SEEN_SD = 2.0


def motion_of(plain):
    return make_motion(spec.Motion.model_validate(plain))


def filter_track(settings, motion, seen):
    """Kalman filter of x and y measured with `SEEN_SD`; (T, 2) `seen`, NaN where nothing is."""
    mean, covariance = motion.start_moments(BOX)
    found = [GaussianPosterior(mean, covariance, FIELDS, 13)]
    look = np.eye(2, len(mean))
    for place in seen:
        mean, covariance = predict(mean, covariance, motion, 1.0, settings)
        if not np.isnan(place).any():
            gain = covariance @ look.T @ np.linalg.inv(look @ covariance @ look.T + SEEN_SD**2 * np.eye(2))
            mean = mean + gain @ (place - look @ mean)
            covariance = covariance - gain @ look @ covariance
        found.append(GaussianPosterior(mean, covariance, FIELDS, 13))
    return found


def condition_jointly(motion, seen):
    """Means and covariances of every state given all of `seen`, from the joint Gaussian of the track."""
    mean, covariance = motion.start_moments(BOX)
    size, steps = len(mean), len(seen) + 1
    forward, noise = motion.linearise(mean, 1.0)
    means, joint = [mean], np.zeros((steps * size, steps * size))
    joint[:size, :size] = covariance
    for k in range(1, steps):
        now, last = slice(k * size, (k + 1) * size), slice((k - 1) * size, k * size)
        means.append(forward @ means[-1])
        joint[now, : k * size] = forward @ joint[last, : k * size]
        joint[: k * size, now] = joint[now, : k * size].T
        joint[now, now] = forward @ joint[last, last] @ forward.T + noise
    rows = [
        (k + 1) * size + axis for k, place in enumerate(seen) if not np.isnan(place).any() for axis in (0, 1)
    ]
    places = np.concatenate([place for place in seen if not np.isnan(place).any()])
    flat = np.concatenate(means)
    gain = joint[:, rows] @ np.linalg.inv(joint[np.ix_(rows, rows)] + SEEN_SD**2 * np.eye(len(rows)))
    after = flat + gain @ (places - flat[rows])
    spread = joint - gain @ joint[rows]
    return after.reshape(steps, size), [
        spread[k * size : (k + 1) * size, k * size : (k + 1) * size] for k in range(steps)
    ]


@pytest.fixture
def seen():
    rng = np.random.default_rng(4)
    places = BOX[:2] + np.cumsum(rng.normal(1.0, 1.0, (12, 2)), axis=0)
    places[4:8] = np.nan
    return places


@pytest.mark.parametrize("kind", ["kalman", "extended", "unscented"])
def test_gaussians_are_those_of_the_joint_distribution(kind, seen):
    settings, motion = spec.Gaussian(filter=kind), motion_of(VELOCITY)
    filtered = filter_track(settings, motion, seen)
    smoothed = smooth_gaussians(filtered, [Move(motion, 1.0)] * len(seen), settings)
    means, covariances = condition_jointly(motion, seen)
    for one, mean, covariance in zip(smoothed, means, covariances, strict=True):
        np.testing.assert_allclose(one.mean, mean, rtol=0, atol=1e-7)
        np.testing.assert_allclose(one.covariance, covariance, rtol=0, atol=1e-7)


def test_particles_are_those_of_enumeration():
    """Three frames of few hypotheses: every trajectory is weighted by its probability."""
    rng = np.random.default_rng(1)
    motion = motion_of(WALK)
    filtered = []
    for size in (5, 6, 4):
        states = np.tile(BOX, (size, 1))
        states[:, :2] += rng.normal(0, 3, (size, 2))
        filtered.append(ParticleSet(states, BOX_FIELDS, LogWeights.normalise(rng.normal(0, 1, size))[0]))
    first, second, third = filtered

    # Backward conditionals, not products of filtered weights: what is drawn given the frame after it.
    to_second = second.weights.log + motion.log_density(third.states, second.states, 1.0)
    to_second = np.exp(to_second - np.logaddexp.reduce(to_second, axis=1, keepdims=True))
    to_first = first.weights.log + motion.log_density(second.states, first.states, 1.0)
    to_first = np.exp(to_first - np.logaddexp.reduce(to_first, axis=1, keepdims=True))
    of_second = third.weights.weights @ to_second
    of_first = of_second @ to_first

    draws = 40_000
    found = smooth_particles(filtered, [Move(motion, 1.0)] * 2, draws, np.random.default_rng(2))
    for one, exact in zip(found, (of_first, of_second, third.weights.weights), strict=True):
        np.testing.assert_allclose(one.weights.weights, exact, rtol=0, atol=5 / np.sqrt(draws))


def test_particles_agree_with_the_kalman_smoother():
    """A particle filter of a linear-Gaussian model, smoothed, against Rauch, Tung and Striebel."""
    rng = np.random.default_rng(3)
    motion, settings = motion_of(WALK), spec.Gaussian(filter="kalman")
    seen = BOX[:2] + np.cumsum(rng.normal(0.5, 2.0, (10, 2)), axis=0)
    size = 3000
    states, gaussian = np.tile(BOX, (size, 1)), GaussianPosterior(BOX, np.zeros((4, 4)), BOX_FIELDS, 9)
    particles = [ParticleSet(states, BOX_FIELDS, LogWeights.uniform(size))]
    gaussians, look = [gaussian], np.eye(2, 4)
    for place in seen:
        weights = particles[-1].weights.weights
        states = motion.propagate(states[rng.choice(size, size, p=weights)], 1.0, rng)
        log = -0.5 * ((states[:, :2] - place) ** 2).sum(axis=1) / SEEN_SD**2
        particles.append(ParticleSet(states, BOX_FIELDS, LogWeights.normalise(log)[0]))
        mean, covariance = predict(gaussians[-1].mean, gaussians[-1].covariance, motion, 1.0, settings)
        gain = covariance @ look.T @ np.linalg.inv(look @ covariance @ look.T + SEEN_SD**2 * np.eye(2))
        mean, covariance = mean + gain @ (place - look @ mean), covariance - gain @ look @ covariance
        gaussians.append(GaussianPosterior(mean, covariance, BOX_FIELDS, 9))
    moves = [Move(motion, 1.0)] * len(seen)
    by_draws = smooth_particles(particles, moves, 300, rng)
    exact = smooth_gaussians(gaussians, moves, settings)
    for one, true in zip(by_draws[1:], exact[1:], strict=True):
        sd = np.sqrt(np.diagonal(true.covariance)[:2])
        # 300 trajectories and 3,000 hypotheses: five standard errors of the mean.
        assert (np.abs(one.mean[:2] - true.mean[:2]) < 5 * sd / np.sqrt(300)).all()
        np.testing.assert_allclose(np.diagonal(one.covariance)[:2], sd**2, rtol=0.5)


def test_a_reset_begins_trajectories_anew():
    motion = motion_of(WALK)
    near = ParticleSet(np.tile(BOX, (3, 1)), BOX_FIELDS, LogWeights.uniform(3))
    far = BOX + np.array([1e160, 0, 0, 0])
    away = ParticleSet(np.tile(far, (3, 1)), BOX_FIELDS, LogWeights.uniform(3))
    found = smooth_particles([near, away], [Move(motion, 1.0)], 10, np.random.default_rng(0))
    assert [len(one) for one in found] == [3, 3]
    assert np.isfinite(found[0].mean).all()


def test_nothing_is_learnt_across_a_jump():
    """A Gaussian that jumped began anew: what comes after is smoothed as a track of its own."""
    motion, settings = motion_of(WALK), spec.Gaussian()
    seen = np.array([[51.0, 40.0], [53.0, 42.0], [54.0, 41.0], [90.0, 70.0], [92.0, 71.0]])
    filtered = filter_track(settings, motion, seen)
    moves = [Move(motion, 1.0)] * 5
    jump = Move(Jumping(motion, 0.5, 120, 100, NO_SEARCH), 1.0)
    found = smooth_gaussians(filtered, [*moves[:3], jump, *moves[4:]], settings)
    parts = (
        smooth_gaussians(filtered[:4], moves[:3], settings),
        smooth_gaussians(filtered[4:], moves[4:], settings),
    )
    for one, other in zip(found, [*parts[0], *parts[1]], strict=True):
        np.testing.assert_array_equal(one.mean, other.mean)
        np.testing.assert_array_equal(one.covariance, other.covariance)


@pytest.mark.parametrize("smooth", [smooth_particles, smooth_gaussians])
def test_moves_are_one_fewer_than_beliefs(smooth):
    with pytest.raises(ValueError, match="2 beliefs need 1 moves, not 2"):
        smooth([None, None], [None, None], *((5, None) if smooth is smooth_particles else (None,)))
