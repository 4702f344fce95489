"""The most probable trajectory is that of enumeration over all of them."""

from itertools import product

import numpy as np
import pytest

from bayesnet_track.belief.contract import BOX_FIELDS
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.belief.smoothing import Move, most_probable_trajectory
from bayesnet_track.graph import spec
from bayesnet_track.numerics.log_weights import LogWeights

MOTION = make_motion(spec.Motion.model_validate({"random_walk": {"sd_px": {"x": 2.0, "y": 3.0}}}))
FRAMES, SIZE = 4, 5


def hypotheses(rng):
    states = np.array([50.0, 40.0, 20.0, 10.0]) + rng.normal(0, 3, (FRAMES, SIZE, 4)) * [1, 1, 0, 0]
    return states, rng.normal(0, 2, (FRAMES, SIZE))


def set_of(states, log):
    return ParticleSet(states, BOX_FIELDS, LogWeights.normalise(log)[0])


def enumerate_best(states, evidence, first):
    densities = [MOTION.log_density(states[t + 1], states[t], 1.0) for t in range(FRAMES - 1)]
    best = max(
        product(range(SIZE), repeat=FRAMES),
        key=lambda path: (
            first[path[0]]
            + sum(evidence[t][path[t]] for t in range(1, FRAMES))
            + sum(densities[t][path[t + 1], path[t]] for t in range(FRAMES - 1))
        ),
    )
    return np.array([states[t][k] for t, k in enumerate(best)])


@pytest.mark.parametrize("seed", range(5))
def test_of_particles_it_is_that_of_enumeration(seed):
    states, evidence = hypotheses(np.random.default_rng(seed))
    filtered = [set_of(*pair) for pair in zip(states, evidence, strict=True)]
    found = most_probable_trajectory(filtered, [Move(MOTION, 1.0)] * (FRAMES - 1))
    np.testing.assert_array_equal(found, enumerate_best(states, evidence, evidence[0]))


@pytest.mark.parametrize("seed", range(5))
def test_of_a_filtered_grid_it_is_that_of_enumeration(seed):
    states, evidence = hypotheses(np.random.default_rng(seed))
    log, filtered = evidence[0], [set_of(states[0], evidence[0])]
    for t in range(1, FRAMES):  # the filter over these cells
        density = MOTION.log_density(states[t], states[t - 1], 1.0)
        log = evidence[t] + np.logaddexp.reduce(density + filtered[-1].weights.log, axis=1)
        filtered.append(set_of(states[t], log))
    found = most_probable_trajectory(filtered, [Move(MOTION, 1.0)] * (FRAMES - 1), on_grid=True)
    np.testing.assert_array_equal(found, enumerate_best(states, evidence, evidence[0]))


def test_moves_that_do_not_fit_are_refused():
    states, evidence = hypotheses(np.random.default_rng(0))
    with pytest.raises(ValueError, match="1 beliefs need 0 moves, not 1"):
        most_probable_trajectory([set_of(states[0], evidence[0])], [Move(MOTION, 1.0)])
