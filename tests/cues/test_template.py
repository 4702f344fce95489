"""Template matching: place and size, what it does at the frame's border, and how sure it is."""

import cv2
import numpy as np
import pytest

from bayesnet_track.observation.planes import Frame, FramePair

BOX = np.array([160.0, 120.0, 60.0, 50.0])
WALL = cv2.resize(
    np.random.default_rng(2).integers(20, 235, (48, 64, 3), np.uint8),
    (320, 240),
    interpolation=cv2.INTER_CUBIC,
)


def picture(move=(0.0, 0.0), scale=1.0):
    """The whole texture, moved and scaled about the box's centre."""
    turn = cv2.getRotationMatrix2D((float(BOX[0]), float(BOX[1])), 0.0, scale)
    turn[:, 2] += move
    moved = cv2.warpAffine(WALL, turn, (320, 240), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return FramePair(Frame(1, 1.0, moved), None)


@pytest.mark.parametrize("move", [(0.0, 0.0), (3.4, -2.7), (-14.0, 11.5)])
def test_it_finds_the_place_between_the_cells(ask, move):
    asked = ask("template")
    found = asked.measure(picture(move), BOX[None], asked.learn(picture(), BOX))
    assert found.fields == ("x", "y", "w", "h")
    np.testing.assert_allclose(found.mean, BOX + [*move, 0, 0], atol=0.8)


def test_it_is_lost_beyond_its_reach(ask):
    far = picture((90.0, 0.0))
    asked = ask("template", min_correlation=0.7)
    assert asked.measure(far, BOX[None], asked.learn(picture(), BOX)) is None
    asked = ask("template", reach_box=2.0)
    np.testing.assert_allclose(
        asked.measure(far, BOX[None], asked.learn(picture(), BOX)).mean[:2], BOX[:2] + [90, 0], atol=0.8
    )


@pytest.mark.parametrize("scale", [1.06, 0.94])
def test_the_size_follows_a_step(ask, scale):
    asked = ask("template")
    found = asked.measure(picture(scale=scale), BOX[None], asked.learn(picture(), BOX))
    assert (found.mean[2] - BOX[2]) * (scale - 1.0) > 0.0


def test_far_from_the_prediction_it_is_less_sure(ask):
    near, far = (
        asked.measure(picture((dx, 0.0)), BOX[None], asked.learn(picture(), BOX)).covariance[0, 0]
        for asked in [ask("template")]
        for dx in (0.0, 30.0)
    )
    assert far > 4.0 * near


@pytest.mark.parametrize("place", [(2.0, 3.0), (318.0, 238.0), (-200.0, 500.0)])
def test_a_box_at_the_border_or_outside_is_no_error(ask, place):
    asked, box = ask("template"), np.array([*place, 60.0, 50.0])
    found = asked.measure(picture(), box[None], asked.learn(picture(), box))
    assert found is None or np.isfinite(found.mean).all()


def test_the_newest_template_replaces_the_old_one(ask):
    asked = ask("template")
    old, new = asked.learn(picture(), BOX), asked.learn(picture((5.0, 0.0)), BOX)
    assert asked.cue.blend(old, new, 0.0) is old
    assert asked.cue.blend(old, new, 0.2) is new
