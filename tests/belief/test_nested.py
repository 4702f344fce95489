"""Deviations of latent nodes beside every motion: their density, their draws, and the rest left as it is."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.belief.motion.composed import Deviation, Nested, deviations_of
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.graph.spec import Motion

BOX = np.array([50.0, 60.0, 20.0, 30.0])
DEVIATIONS = (Deviation("head.x", 5.0, 2.0), Deviation("head.y", 3.0, 3.0))
KINDS = {
    "random_walk": {"sd_px": {"x": 2, "y": 3}, "sd_log": {"scale": 0.02}},
    "constant_velocity": {"sd_velocity_px": 1, "sd_px": {"x": 1, "y": 1}},
}


def nested(kind):
    return Nested(make_motion(Motion.model_validate({kind: KINDS[kind]})), DEVIATIONS)


def moved_from(motion, seed=1):
    start = motion.start(BOX, 50, np.random.default_rng(seed))
    start[:, -2:] = np.random.default_rng(seed + 1).normal(0.0, 3.0, (50, 2))
    return start


@pytest.mark.parametrize("kind", KINDS)
def test_the_rest_moves_as_without_deviations(kind):
    motion = nested(kind)
    assert motion.fields == (*motion.motion.fields, "head.x", "head.y")
    assert not motion.start(BOX, 9, np.random.default_rng(1))[:, -2:].any()
    mean, covariance = motion.start_moments(BOX)
    assert len(mean) == len(motion.fields) and not covariance[-2:].any()
    old, parents = moved_from(motion), np.arange(50)[::-1].astype(np.intp)
    moved = motion.propagate(old, 0.5, np.random.default_rng(2), parents)
    plain = motion.motion.propagate(old[:, :-2].copy(), 0.5, np.random.default_rng(2), parents)
    np.testing.assert_array_equal(moved[:, :-2], plain)


@pytest.mark.parametrize("kind", KINDS)
def test_the_density_is_that_of_both_and_coordinates_lead_back(kind):
    motion, dt = nested(kind), 0.5
    old = moved_from(motion)
    new = motion.propagate(old, dt, np.random.default_rng(3))
    own = motion.motion.log_density(new[:, :-2].copy(), old[:, :-2].copy(), dt)
    for k, one in ((-2, DEVIATIONS[0]), (-1, DEVIATIONS[1])):
        kept, sd = one.over(dt)
        away = (new[:, None, k] - kept * old[:, k]) / sd
        own = own - 0.5 * away**2 - np.log(sd * np.sqrt(2.0 * np.pi))
    np.testing.assert_allclose(motion.log_density(new, old, dt), own, rtol=1e-9)
    transition = motion.transition(old, dt)
    assert transition.states is not None
    back = transition.states(transition.coordinates(new)[0], motion.drift(old, dt))
    np.testing.assert_allclose(back[:, -2:], new[:, -2:])


def test_draws_have_the_mean_and_covariance_of_the_linear_form():
    """20,000 draws know an sd to 0.5 %, so 2.5 % is five of them."""
    motion = nested("random_walk")
    old = moved_from(motion)[:1]
    drawn = motion.propagate(np.repeat(old, 20_000, axis=0), 2.0, np.random.default_rng(4))[:, -2:]
    transition, covariance = motion.linearise(old[0], 2.0)
    np.testing.assert_allclose(drawn.std(axis=0), np.sqrt(np.diag(covariance)[-2:]), rtol=0.025)
    expected = (transition @ old[0])[-2:]
    np.testing.assert_allclose(drawn.mean(axis=0), expected, atol=4.5 * 5.0 / np.sqrt(20_000))


def test_the_deviations_of_a_graph():
    nodes = load_graph("person_levels").targets["person"].spec.nodes
    found = deviations_of(nodes)
    assert [one.name for one in found] == ["torso.x", "torso.y", "head.x", "head.y"]
    assert (found[2].sd, found[2].step_sd) == (2.5, 1.5)
    assert deviations_of(load_graph("person_parts").targets["person"].spec.nodes) == ()
