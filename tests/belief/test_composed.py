"""The motion of a frame is the plate's under what influenced it, each influence in its place."""

import numpy as np

from bayesnet_track.belief.motion.composed import Influences, Nested, compose_motion, turning
from bayesnet_track.belief.motion.delayed import CameraShift
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.graph import spec

SETTINGS = spec.Motion.model_validate(
    {
        "random_walk": {
            "sd_px": {"x": 2, "y": 2},
            "sd_log": {"scale": 0.1},
            "size_reversion": {"sd_scale": 0.3},
        }
    }
)
SIZE = np.array([20.0, 10.0])
STATE = np.array([[50.0, 40.0, 40.0, 20.0]])


def test_without_influences_it_is_the_plates():
    motion = make_motion(spec.Motion.model_validate({"random_walk": {"sd_px": {"x": 2, "y": 2}}}))
    settings = spec.Motion.model_validate({"random_walk": {"sd_px": {"x": 2, "y": 2}}}).settings
    assert compose_motion(motion, settings, Influences(1.0, SIZE)) == motion


def test_the_camera_moves_and_the_size_reverts():
    camera = CameraShift(np.eye(2), np.array([5.0, -3.0]))
    motion = compose_motion(make_motion(SETTINGS), SETTINGS.settings, Influences(1.0, SIZE, 1.0, camera))
    x, y, w, h = motion.drift(STATE, 1.0)[0]
    assert (x, y) == (55.0, 37.0)
    assert 20 < w < 40 and 10 < h < 20
    assert np.isclose(w / h, 2.0)


def test_doubt_widens_the_place_only():
    plain, wide = (
        compose_motion(make_motion(SETTINGS), SETTINGS.settings, Influences(1.0, SIZE, factor))
        for factor in (1.0, 3.0)
    )
    before, after = (one.transition(STATE, 1.0).sds[0, 0] for one in (plain, wide))
    np.testing.assert_allclose(after / before, [3.0, 3.0, 1.0], rtol=1e-12)


def test_a_target_that_turns_goes_on_turning():
    turned = turning(make_motion(SETTINGS), 5.0)
    found = compose_motion(turned, SETTINGS.settings, Influences(1.0, SIZE, 2.0))
    assert isinstance(found, Nested) and found.fields == turned.fields
