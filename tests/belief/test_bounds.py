"""Hypotheses stay where the camera can see, and move freely inside."""

from __future__ import annotations

import numpy as np

from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.graph.spec import Motion

WALK = make_motion(
    Motion.model_validate({"random_walk": {"sd_px": {"x": 20.0, "y": 20.0, "w": 60.0, "h": 60.0}}})
)


def test_centres_stay_on_the_image_and_sizes_below_twice_its_own():
    confined = Confined(WALK, width=120, height=100)
    rng = np.random.default_rng(0)
    states = confined.start(np.array([5.0, 95.0, 30.0, 20.0]), 400, rng)
    for _ in range(30):
        states = confined.propagate(states, 1.0, rng)
        low, high = states.min(axis=0), states.max(axis=0)
        assert np.all(low >= [0.0, 0.0, 1.0, 1.0]) and np.all(high <= [119.0, 99.0, 240.0, 200.0])
    # The borders are reached on every side, so the check above can fail.
    assert np.all(low == [0.0, 0.0, 1.0, 1.0]) and np.all(high == [119.0, 99.0, 240.0, 200.0])


def test_far_from_the_border_it_is_the_model():
    confined = Confined(WALK, width=100_000, height=100_000)
    states = np.tile([50_000.0, 50_000.0, 1000.0, 1000.0], (50, 1))
    moved = confined.propagate(states, 2.0, np.random.default_rng(3))
    np.testing.assert_array_equal(moved, WALK.propagate(states, 2.0, np.random.default_rng(3)))
    np.testing.assert_array_equal(
        confined.log_density(moved, states, 2.0), WALK.log_density(moved, states, 2.0)
    )
    points = confined.transition(states, 2.0)
    np.testing.assert_array_equal(points.log_density(moved), WALK.log_density(moved, states, 2.0))
    assert confined.fields == WALK.fields


def test_the_spread_is_at_most_that_of_a_box_anywhere():
    """Root mean square distance from a place, of a uniform distribution over the image."""
    motion = Confined(make_motion(Motion(random_walk={"sd_px": {"x": 1}})), 320, 240)
    mean, draws = np.array([30.0, 100.0, 50.0, 60.0]), np.random.default_rng(0).random((200_000, 4))
    anywhere = draws * [319, 239, 639, 479] + [0, 0, 1, 1]
    expected = np.sqrt(((anywhere - mean) ** 2).mean(axis=0))
    wide = np.full((4, 4), 2000.0**2) + np.eye(4)
    held, spread = motion.confine_moments(mean, wide)
    np.testing.assert_array_equal(held, mean)
    np.testing.assert_allclose(np.sqrt(spread.diagonal()), expected, rtol=0.01)
    np.testing.assert_allclose(spread, np.outer(*[np.sqrt(spread.diagonal())] * 2), rtol=1e-5)
    np.testing.assert_array_equal(motion.confine_moments(mean, np.eye(4))[1], np.eye(4))


def test_one_state_is_confined_as_several_are():
    confined = Confined(WALK, width=120, height=100)
    for state in ([-3.0, 120.0, 0.5, 300.0], [130.0, -1.0, 260.0, 0.0], [60.0, 50.0, 30.0, 20.0]):
        one = np.array(state)
        held, spread = confined.confine_moments(one, np.eye(4))
        np.testing.assert_array_equal(held, confined.confine(one[None].copy())[0])
        np.testing.assert_array_equal(spread, np.eye(4))
        assert one.tolist() == state
