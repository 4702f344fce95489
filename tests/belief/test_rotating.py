"""The angle of a state: a walk of its own beside every motion, its density, and what jumps or is carried."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.belief.motion.composed import Nested, turning
from bayesnet_track.belief.motion.delayed import Attached
from bayesnet_track.belief.motion.jumps import Jumping, Search
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.belief.particles.belief import map_index
from bayesnet_track.graph.spec import Motion
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.cue import ANGLE

SD = 6.0
BOX = np.array([50.0, 60.0, 20.0, 30.0])
KINDS = {
    "random_walk": {"sd_px": {"x": 2, "y": 3}, "sd_log": {"scale": 0.02}},
    "constant_velocity": {"sd_velocity_px": 1, "sd_px": {"x": 1, "y": 1}},
    "damped_velocity": {
        "sd_velocity_px": 1,
        "heavy_tail": {"weight": 0.5, "factor": 4},
        "sd_px": {"x": 1, "y": 1},
    },
    "constant_acceleration": {"sd_acceleration_px": 1, "sd_log": {"scale": 0.02, "aspect": 0.01}},
}


def rotating(kind: str) -> Nested:
    return turning(make_motion(Motion.model_validate({kind: KINDS[kind]})), SD)


@pytest.mark.parametrize("kind", KINDS)
def test_the_rest_moves_as_without_an_angle(kind: str) -> None:
    """The same bits: of start, motion and density, the angle's own factor taken off."""
    motion = rotating(kind)
    start = motion.start(BOX, 50, np.random.default_rng(1))
    assert motion.fields == (*motion.motion.fields, ANGLE)
    np.testing.assert_array_equal(start[:, :-1], motion.motion.start(BOX, 50, np.random.default_rng(1)))
    assert not start[:, -1].any()
    parents = np.arange(50)[::-1].astype(np.intp)
    moved = motion.propagate(start, 0.5, np.random.default_rng(2), parents)
    plain = motion.motion.propagate(start[:, :-1].copy(), 0.5, np.random.default_rng(2), parents)
    np.testing.assert_array_equal(moved[:, :-1], plain)
    away = (moved[:, None, -1] - start[:, -1]) / (SD * np.sqrt(0.5))
    turned = -0.5 * away**2 - np.log(SD * np.sqrt(0.5) * np.sqrt(2 * np.pi))
    own = motion.motion.log_density(moved[:, :-1].copy(), start[:, :-1].copy(), 0.5)
    np.testing.assert_allclose(motion.log_density(moved, start, 0.5), own + turned, rtol=1e-9)


def test_the_density_integrates_to_one_and_agrees_with_draws() -> None:
    """A walk on the line: past a full turn, too. 20000 draws know the sd to 0.5 %, so 2 % is four sds."""
    motion = turning(make_motion(Motion.model_validate({"random_walk": {}})), SD)
    old = np.append(BOX, 355.0)[None]
    angles = np.arange(355.0 - 8 * SD, 355.0 + 8 * SD, 0.1)
    new = np.column_stack([np.tile(BOX, (len(angles), 1)), angles])
    density = np.exp(motion.log_density(new, old, 2.0)[:, 0])
    assert density.sum() * 0.1 == pytest.approx(1.0, abs=1e-6)
    drawn = motion.propagate(np.repeat(old, 20000, axis=0), 2.0, np.random.default_rng(3))[:, -1]
    assert drawn.std() == pytest.approx(SD * np.sqrt(2.0), rel=0.02)
    assert drawn.mean() == pytest.approx(355.0, abs=4 * SD * np.sqrt(2.0 / 20000))
    transition, covariance = motion.linearise(old[0], 2.0)
    np.testing.assert_array_equal(transition, np.eye(5))
    assert covariance[-1, -1] == pytest.approx(2.0 * SD**2, rel=1e-14) and not covariance[:-1].any()


@pytest.mark.parametrize("kind", KINDS)
def test_coordinates_lead_back_to_their_states(kind: str) -> None:
    motion = rotating(kind)
    rng = np.random.default_rng(4)
    old = motion.start(BOX, 30, rng)
    new = motion.propagate(old, 1.0, rng)
    transition = motion.transition(old, 1.0)
    assert transition.states is not None
    points = transition.coordinates(new)[0]
    np.testing.assert_allclose(transition.states(points, motion.drift(old, 1.0)), new, rtol=1e-9, atol=1e-9)


def test_the_map_weighs_the_angle() -> None:
    """Of two hypotheses that differ in the angle alone, the one nearer to where it was."""
    motion = rotating("random_walk")
    states = np.stack([np.append(BOX, angle) for angle in (30.0, 4.0)])
    old = np.append(BOX, 0.0)[None]
    assert map_index(np.zeros(2), states, old, LogWeights.uniform(1), motion, 1.0) == 1


def test_what_jumps_and_what_is_carried_keeps_its_angle() -> None:
    motion = rotating("constant_acceleration")
    still = turning(motion.motion, 1e-9)
    old = motion.start(BOX, 40, np.random.default_rng(5))
    old[:, -1] = np.arange(40)
    search = Search(0.5, "uniform", 0, np.empty((0, 4)), np.empty(0), 0.0, 0.0)
    jumped = Jumping(still, 0.5, 640, 480, search).propagate(old, 1.0, np.random.default_rng(6))
    np.testing.assert_allclose(jumped[:, -1], np.arange(40), atol=1e-6)
    carrying = Attached(still, np.array([7.0, -3.0]), 0.1, 1.0, 1.0)
    carried = carrying.propagate(np.column_stack([old, np.ones(40)]), 1.0, np.random.default_rng(7))
    np.testing.assert_allclose(carried[:, -2], np.arange(40), atol=1e-6)
    assert not carried[:, 6:8].any()
    np.testing.assert_array_equal(
        carrying.drift(np.column_stack([old, np.ones(40)]), 1.0)[:, -2], np.arange(40)
    )
