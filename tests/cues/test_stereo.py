"""The stereo cue on a rendered person: the features, where its likelihood peaks, and what it refuses."""

import numpy as np
import pytest

from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.cue import installed_cues
from bayesnet_track.observation.planes import Frame, FramePair, PointMap
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

STANDING = {"camera_height_m": 1.2, "max_depth_m": 6.0}


@pytest.fixture(scope="module")
def room():
    scene = make_scene("person_stereo", 0)
    frames = {frame.index: frame for frame in SceneSource(scene, "room", 81) if frame.index in (0, 30, 80)}
    return scene, frames


def box(room, index, shift_px=0.0):
    """The target's true box, moved to the right."""
    return centre_from_corner(room[0].truth[index]) + np.array([shift_px, 0, 0, 0])


def pair(room, index):
    return FramePair(room[1][index], None)


@pytest.mark.slow
def test_the_features_are_those_of_the_person(ask, room):
    """0.5 m wide, 1.7 m high, the lowest 0.1 m cut off with the floor; windows reach 3 px, 4 cm, further."""
    asked = ask("stereo", **STANDING)
    reference = asked.learn(pair(room, 0), box(room, 0))
    depth, spread, height, shape, valid = reference["features"]
    assert depth == pytest.approx(4.0, abs=0.1)
    assert spread < 0.2
    assert height == pytest.approx(1.6, abs=0.1)
    assert np.exp(shape) == pytest.approx(0.5 / 1.6, rel=0.15)
    assert valid > 0.8


@pytest.mark.parametrize("matcher", ["correlation", "semi_global"])
@pytest.mark.parametrize("depth", ["depth", "spread", "both"])
def test_the_likelihood_peaks_on_the_person(ask, room, matcher, depth):
    asked = ask("stereo", matcher=matcher, depth=depth, **STANDING)
    reference = asked.learn(pair(room, 0), box(room, 0))
    true = box(room, 30)
    offset = np.arange(-60.0, 61.0, 4.0)
    boxes = np.array([true + np.array([dx, dy, 0, 0]) for dx in offset for dy in offset[10:21]])
    values = asked.score(pair(room, 30), boxes, reference)
    assert np.abs(boxes[values.argmax(), :2] - true[:2]).max() <= 10
    away = np.abs(boxes[:, 0] - true[0]) > 30
    assert values[away].max() < values.max() - 2.0


def test_depth_tells_the_target_from_another_person_and_spread_does_not(ask, room):
    """The other one is 0.4 m further away in frame 80."""
    other = centre_from_corner(room[0].others[0][80])
    boxes = np.stack([box(room, 80), other])
    asked = ask("stereo", depth="depth", sd_depth_m=0.15, **STANDING)
    own, its = asked.score(pair(room, 80), boxes, asked.learn(pair(room, 80), boxes[0]))
    assert own - its > 2.0
    asked = ask("stereo", depth="spread", **STANDING)
    own, its = asked.score(pair(room, 80), boxes, asked.learn(pair(room, 80), boxes[0]))
    assert own - its < 1.5


def test_a_box_of_wall_out_of_range_is_at_the_floor(ask, room):
    asked = ask("stereo", floor=0.01, **STANDING)
    reference = asked.learn(pair(room, 0), box(room, 0))
    wall = np.array([[250.0, 60.0, *box(room, 0)[2:]]])
    assert asked.score(pair(room, 0), wall, reference)[0] == pytest.approx(np.log(0.01))


def test_a_target_without_points_says_nothing_until_it_has_some(ask, room):
    asked = ask("stereo", **STANDING)
    unknown = asked.learn(pair(room, 0), np.array([250.0, 60.0, 40.0, 60.0]))
    assert not unknown["known"]
    boxes = np.stack([box(room, 0), box(room, 0, 50)])
    assert (asked.score(pair(room, 0), boxes, unknown) == 0).all()
    known = asked.learn(pair(room, 0), box(room, 0))
    for name, value in asked.cue.blend(unknown, known, 0.1).items():
        np.testing.assert_array_equal(value, known[name])
    for name, value in asked.cue.blend(known, unknown, 0.1).items():
        np.testing.assert_array_equal(value, known[name])


def test_acting_on_its_own_uncertainty_sharpens_it(ask, room):
    asked = ask("stereo", **STANDING)
    reference = asked.learn(pair(room, 0), box(room, 0))
    sharper = asked.cue.adapt(reference, 1)
    boxes = np.stack([box(room, 0, 12)])
    assert asked.score(pair(room, 0), boxes, sharper) < asked.score(pair(room, 0), boxes, reference)
    assert asked.cue.adapt({**reference, "known": np.array(0.0)}, 1) is None


def test_the_points_of_another_sensor_do_as_well(ask, room):
    scene, frames = room
    true = scene.stereo.true_depth(0).astype(np.float32)
    points = scene.stereo.geometry.points_of_depth(true)
    frame = Frame(0, 0.0, frames[0].image, depth=PointMap(points))
    asked = ask("stereo", **STANDING)
    reference = asked.learn(FramePair(frame, None), box(room, 0))
    assert reference["features"][0] == pytest.approx(4.0, abs=1e-3)
    boxes = np.stack([box(room, 0), box(room, 0, 30)])
    own, shifted = asked.score(FramePair(frame, None), boxes, reference)
    assert own > -0.01 and shifted < -2


def test_one_eye_is_refused(ask, room):
    asked = ask("stereo")
    frame = Frame(0, 0.0, room[1][0].image)
    with pytest.raises(ValueError, match="the source is one eye"):
        asked.learn(FramePair(frame, None), box(room, 0))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"window_px": 8}, "7 or 9, not 8"),
        ({"min_depth_m": 5, "max_depth_m": 2}, "min_depth_m 5 is not below max_depth_m 2"),
        ({"min_elevation_m": 3}, "min_elevation_m 3 is not below max_elevation_m 2.5"),
        ({"depth": "mean"}, "depth"),
        ({"min_correlation": 1.5}, "min_correlation"),
    ],
)
def test_parameters_that_make_no_sense(given, said):
    with pytest.raises(ValueError, match=said):
        installed_cues()["stereo"].parameters(**given)
