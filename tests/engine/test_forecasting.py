"""Where a target will be: exact for linear motion, regions that hold what they say, no side effect."""

import numpy as np
import pytest

from bayesnet_track import Tracker, load_graph
from bayesnet_track.journal.codec import to_json
from bayesnet_track.sources.scenes import make_scene

VELOCITY = {"constant_velocity": {"sd_velocity_px": 1.0, "start_velocity_sd_px": 3.0}}


def graph_of(belief, motion, agent="foreground_color"):
    return {
        "bayesnet": 1,
        "name": "plain",
        "targets": {
            "ball": {
                "nodes": {
                    "ball": {"belief": belief, "motion": motion, "estimate": "mean"},
                    "look": {"parent": "ball", "agent": agent},
                }
            }
        },
    }


@pytest.fixture(scope="module")
def scene():
    return make_scene("two_squares", 12)


def started(graph, scene, frames=4, seed=0):
    tracker = Tracker(load_graph(graph), seed=seed)
    images = list(scene.frames)[: frames + 1]
    tracker.init(images[0], scene.start_box)
    for image in images[1:]:
        tracker.update(image)
    return tracker


def test_a_kalman_belief_moves_by_its_matrices(scene):
    tracker = started(graph_of({"gaussian": {"filter": "kalman"}}, VELOCITY, "mean_shift"), scene)
    (state,) = tracker._now.state.targets.values()
    (compiled,) = tracker._engine.plates.values()
    mean, covariance = state.belief.mean, state.belief.covariance
    forward, noise = compiled.motion.linearise(mean, 1.0)
    found = tracker.predict(6)
    assert [one.ahead for one in found] == [1, 2, 3, 4, 5, 6]
    for one in found:
        mean, covariance = forward @ mean, forward @ covariance @ forward.T + noise
        np.testing.assert_allclose(one.cxcywh, mean[:4], rtol=1e-9)
        np.testing.assert_allclose(one.sd[:2], np.sqrt(np.diagonal(covariance)[:2]), rtol=1e-9)


def test_particles_spread_as_their_motion_does(scene):
    walk = {"random_walk": {"sd_px": {"x": 2.0, "y": 3.0}}}
    tracker = started(graph_of({"particles": {"size": 4000}}, walk), scene)
    (state,) = tracker._now.state.targets.values()
    before = np.diagonal(state.belief.covariance)[:2]
    for one in tracker.predict(8):
        expected = before + one.ahead * np.array([4.0, 9.0])
        # 4,000 draws of a variance: a standard error of 2.2 %.
        np.testing.assert_allclose(np.square(one.sd[:2]), expected, rtol=0.12)


def test_regions_hold_what_they_say(scene):
    """Truths drawn from the belief and its motion lie in the 50 and 90 % regions so often."""
    tracker = started(graph_of({"gaussian": {"filter": "kalman"}}, VELOCITY, "mean_shift"), scene)
    (state,) = tracker._now.state.targets.values()
    (compiled,) = tracker._engine.plates.values()
    rng, count = np.random.default_rng(5), 4000
    truths = rng.multivariate_normal(state.belief.mean, state.belief.covariance, count)
    for one in tracker.predict(5):
        truths = compiled.motion.propagate(truths, 1.0, rng)
        for share, region in ((0.5, one.region50), (0.9, one.region90)):
            bounds = np.array(region).reshape(2, 2)
            inside = (bounds[:, 0] <= truths[:, :2]) & (truths[:, :2] <= bounds[:, 1])
            # Four standard errors of a share of 4,000.
            assert np.abs(inside.mean(axis=0) - share).max() < 4 * np.sqrt(share * (1 - share) / count)


@pytest.mark.slow
@pytest.mark.parametrize("graph", ["general", "grid_displacement", "kalman_ball"])
def test_looking_ahead_changes_nothing(graph, scene):
    images = list(scene.frames)[:4]
    found = []
    for looks in (False, True):
        tracker = Tracker(graph)
        tracker.init(images[0], scene.start_box)
        for image in images[1:]:
            if looks:
                assert len(tracker.predict(3)) == 3
            tracker.update(image)
        found.append(to_json(tracker.metrics))
    assert found[0] == found[1]


@pytest.mark.slow
def test_the_same_again_is_the_same_and_doubt_grows(scene):
    variances = np.zeros(3)
    for seed in range(3):
        tracker = started("general", scene, seed=seed)
        first = tracker.predict(3)
        again = tracker.predict(3)
        assert first == again
        variances += [one.sd[0] ** 2 for one in first]
    assert (np.diff(variances) > 0).all()


def test_wrong_use_says_what_to_do(scene):
    with pytest.raises(RuntimeError, match=r"call init\(frame, box\) first"):
        Tracker("general").predict(1)
    with pytest.raises(ValueError, match=r"predict\(0\): at least 1 frame ahead is needed"):
        started("general", scene, 1).predict(0)
