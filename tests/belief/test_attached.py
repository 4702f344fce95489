"""Being carried: the chain's share against enumeration, where hypotheses go, and what densities say."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.belief.motion.delayed import FIELD, Attached, with_carried, without_carried
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.belief.particles.belief import map_index
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.graph.spec import Motion
from bayesnet_track.numerics.log_weights import LogWeights

WALK = make_motion(Motion.model_validate({"random_walk": {"sd_px": {"x": 2, "y": 2}}}))
FLIGHT = make_motion(Motion.model_validate({"constant_velocity": {"sd_velocity_px": 1}}))
MOVED = np.array([7.0, -3.0])


def attached(motion=WALK, start=0.1, stay=0.9, sd=1.0):
    return Attached(motion, MOVED, start, stay, sd)


def states_of(motion, carried, size):
    states = np.zeros((size, len(motion.fields) + 1))
    states[:, :4] = 50.0, 60.0, 20.0, 20.0
    states[:, -1] = carried
    return states


def test_the_forward_filter_agrees_with_enumeration():
    """Chain and evidence over six frames: drawn systematically, 20000 hypotheses are within 0.02 of the sum.

    Evidence prefers places by a factor that depends on the frame; each hypothesis' displacement is one of two
    lengths, so that the exact filter is that of a two-state chain.
    """
    rng = np.random.default_rng(0)
    still = make_motion(Motion.model_validate({"random_walk": {}}))
    motion = Attached(still, MOVED, 0.1, 0.9, 1e-9)
    belief = with_carried(
        ParticleSet(np.tile([50.0, 60.0, 20.0, 20.0], (20000, 1)), still.fields, LogWeights.uniform(20000)),
        None,
    )
    exact = 0.0
    for ratio in (1.0, 3.0, 10.0, 0.5, 0.1, 2.0):
        before = belief.states
        parents = rng.choice(len(before), len(before), p=belief.weights.weights)
        states = motion.propagate(before, 1.0, rng, parents)
        went = states[:, 0] - before[parents, 0]
        assert set(np.rint(went)) <= {0.0, 7.0}
        log = np.log(np.where(went > 3, ratio, 1.0))
        belief = ParticleSet(states, belief.fields, LogWeights.normalise(log)[0])
        predicted = exact * 0.9 + (1 - exact) * 0.1
        exact = predicted * ratio / (predicted * ratio + 1 - predicted)
        assert belief.weights.weights @ states[:, -1] == pytest.approx(exact, abs=0.02)


@pytest.mark.parametrize("motion", [WALK, FLIGHT])
def test_what_is_carried_goes_where_the_carrier_goes(motion):
    old = states_of(motion, 1.0, 4000)
    new = attached(motion).propagate(old, 1.0, np.random.default_rng(1))
    assert new.shape == old.shape
    carried = new[:, -1] > 0
    assert carried.sum() == pytest.approx(3600, abs=2), "drawn systematically"
    away = new[carried, :2] - old[carried, :2]
    assert np.abs(away.mean(axis=0) - MOVED).max() < 5 / np.sqrt(3600)
    assert away.std(axis=0) == pytest.approx([1.0, 1.0], abs=5 / np.sqrt(2 * 3600))
    if motion is FLIGHT:
        assert np.all(new[carried, 4:6] == MOVED)
    free = new[~carried, :2] - old[~carried, :2]
    assert np.abs(free.mean(axis=0)).max() < 5 * 2 / np.sqrt(400)


def test_half_a_frame_twice_is_one_frame():
    once = attached()._draw_carried(np.zeros(10000, dtype=bool), 1.0, np.random.default_rng(2)).mean()
    half = attached()
    rng = np.random.default_rng(3)
    twice = half._draw_carried(half._draw_carried(np.zeros(10000, dtype=bool), 0.5, rng), 0.5, rng).mean()
    assert once == pytest.approx(0.1, abs=2e-4)
    assert twice == pytest.approx(once, abs=5 * np.sqrt(0.1 / 10000))


@pytest.mark.parametrize("motion", [WALK, FLIGHT])
def test_the_map_is_found_beside_the_carrier(motion):
    carrying = attached(motion)
    old = states_of(motion, 1.0, 3)
    new = carrying.drift(old, 1.0)
    assert new[:, :2] == pytest.approx(old[:, :2] + MOVED)
    candidates = np.concatenate([new[:1], old[:1]])
    best = map_index(np.zeros(2), candidates, old, LogWeights.uniform(3), carrying, 1.0)
    assert best == 0
    assert carrying.log_density(candidates, old, 1.0).shape == (2, 3)
    states = carrying.transition(old, 1.0).states
    assert states is not None
    back = states(carrying.transition(old, 1.0).coordinates(new)[0], new)
    assert back == pytest.approx(new)


def test_the_last_field_comes_and_goes():
    belief = ParticleSet(np.tile([50.0, 60.0, 20.0, 20.0], (3, 1)), WALK.fields, LogWeights.uniform(3))
    glued = with_carried(belief, np.array([1.0, 0.0, 1.0]))
    assert glued.fields == (*WALK.fields, FIELD) == attached().fields
    again, column = without_carried(glued)
    assert np.array_equal(again.states, belief.states) and again.fields == belief.fields
    assert column.tolist() == [1, 0, 1]
    start = attached().start(np.array([5.0, 5.0, 2.0, 2.0]), 4, np.random.default_rng(0))
    assert start[:, -1].tolist() == [0, 0, 0, 0]
    mean, covariance = attached().start_moments(np.array([5.0, 5.0, 2.0, 2.0]))
    assert len(mean) == 5 and covariance.shape == (5, 5)
    transition, noise = attached().linearise(mean, 1.0)
    assert transition.shape == noise.shape == (5, 5) and transition[-1, -1] == 1
