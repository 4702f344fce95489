"""The MAP index is that of brute force, on any mixture of sharp, flat, weighted and degenerate cases."""

import numpy as np
import pytest

from bayesnet_track.belief.particles.belief import map_index
from bayesnet_track.numerics.log_weights import LogWeights

BOX = np.array([160.0, 120.0, 60.0, 40.0])
GENERAL = {
    "sd_px": {"x": 1.0},
    "sd_box": {"x": 0.05, "y": 0.1},
    "sd_log": {"scale": 0.02, "aspect": 0.01},
    "heavy_tail": {"weight": 0.3, "factor": 4},
}
KINDS = [
    ("random_walk", {}),
    ("random_walk", GENERAL),
    ("random_walk", {"sd_px": {"y": 3.0}}),
    ("constant_velocity", {}),
    ("damped_velocity", GENERAL),
    ("constant_acceleration", {}),
]


def brute(log_likelihood, states, parents, weights, motion, dt):
    density = np.logaddexp.reduce(motion.log_density(states, parents, dt) + weights.log, axis=1)
    return int(np.argmax(log_likelihood + density))


@pytest.mark.parametrize(("kind", "settings"), KINDS)
@pytest.mark.parametrize("shape", ["flat", "sharp", "floored", "partly zero", "very wide"])
def test_same_index_as_brute_force(kind, settings, shape, motion_of):
    motion = motion_of(kind, **settings)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        count, dt = int(rng.integers(2, 350)), float(rng.choice([0.5, 1.0, 3.0]))
        parents = motion.propagate(motion.start(BOX, count, rng), 2.0, rng)
        log_weights = rng.normal(size=count) * rng.choice([0.0, 1.0, 8.0])
        log_weights[rng.random(count) < rng.choice([0.0, 0.5])] = -np.inf
        log_weights[0] = 0.0
        weights = LogWeights.normalise(log_weights)[0]
        ancestors = rng.choice(count, count, p=weights.weights)
        states = motion.propagate(parents[ancestors], dt, rng)
        square = np.sum((states[:, :2] - BOX[:2] - [4, 7]) ** 2, axis=1)
        log_likelihood = {
            "flat": np.zeros(count),
            "sharp": -square / 2,
            "floored": np.logaddexp(np.log(0.02), -square / 50),
            "partly zero": np.where(rng.random(count) < 0.7, -np.inf, -square / 200),
            "very wide": -300 * rng.random(count),
        }[shape]
        log_likelihood[-1] = max(log_likelihood[-1], -5.0)
        case = (log_likelihood, states, parents, weights, motion, dt)
        assert map_index(*case) == brute(*case)


def test_the_prior_density_counts(motion_of, rng):
    """A slightly larger likelihood in the tail of the prior does not win."""
    motion = motion_of("random_walk")
    parents = np.tile(BOX, (50, 1))
    states = np.array([BOX, BOX + np.array([9.0, 0, 0, 0])])
    assert map_index(np.array([-0.1, 0.0]), states, parents, LogWeights.uniform(50), motion, 1.0) == 0
    # The tail costs (9 / 3)^2 / 2 = 4.5 nats.
    assert map_index(np.array([-4.6, 0.0]), states, parents, LogWeights.uniform(50), motion, 1.0) == 1


def test_prior_weights_count(motion_of):
    motion = motion_of("random_walk")
    parents = np.array([BOX, BOX + np.array([100.0, 0, 0, 0])])
    weights = LogWeights.normalise(np.log([0.3, 0.7]))[0]
    assert map_index(np.zeros(2), parents, parents, weights, motion, 1.0) == 1
    assert map_index(np.array([1.0, 0.0]), parents, parents, weights, motion, 1.0) == 0


def test_the_first_of_equals_wins(motion_of):
    motion, states = motion_of("random_walk"), np.tile(BOX, (9, 1))
    assert map_index(np.zeros(9), states, states, LogWeights.uniform(9), motion, 1.0) == 0


def test_without_noise_the_likelihood_decides(motion_of):
    motion = motion_of("random_walk", sd_px={})
    states = np.tile(BOX, (5, 1))
    likelihood = np.array([-3.0, -1.0, -0.5, -2.0, -np.inf])
    assert map_index(likelihood, states, states, LogWeights.uniform(5), motion, 1.0) == 2


def test_hypotheses_out_of_reach_of_every_parent(motion_of):
    motion = motion_of("random_walk")
    states = BOX + np.array([[600.0, 0, 0, 0], [500.0, 0, 0, 0], [700.0, 0, 0, 0]])
    assert map_index(np.zeros(3), states, BOX[None], LogWeights.uniform(1), motion, 1.0) == 1
