"""The KLT tracker: points that agree, points that are lost, and what the covariance says."""

import cv2
import numpy as np
import pytest

from bayesnet_track.observation.planes import Frame, FramePair, Region
from bayesnet_track.vision.kernels.flow_kernels import consensus

BOX = np.array([160.0, 120.0, 60.0, 50.0])


def textured(seed, rows=240, columns=320, cell=5):
    coarse = np.random.default_rng(seed).integers(20, 235, (rows // cell, columns // cell, 3), np.uint8)
    return cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC)


TARGET, WALL = textured(1), textured(2)


def picture(move=(0.0, 0.0), scale=1.0, angle=0.0, hidden=0.0):
    """The target's texture, moved about the box's centre, on a wall that rests; `hidden` of it covered."""
    turn = cv2.getRotationMatrix2D((float(BOX[0]), float(BOX[1])), angle, scale)
    turn[:, 2] += move
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * BOX[2:] / 2 + BOX[:2]
    polygon = np.rint(corners @ turn[:, :2].T + turn[:, 2]).astype(np.int32)
    mask = cv2.fillConvexPoly(np.zeros(WALL.shape[:2], np.uint8), polygon, 1)
    left = BOX[0] + move[0] - BOX[2] / 2
    mask[:, : int(left + hidden * BOX[2])] = 0 if hidden else mask[:, : int(left)]
    moved = cv2.warpAffine(TARGET, turn, (320, 240), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return np.where(mask[..., None] == 1, moved, WALL)


def frame(image, index=0):
    return FramePair(Frame(index, float(index), np.ascontiguousarray(image)), None)


def measured(asked, reference, image, index=1, sd=2.0, at=BOX):
    boxes = np.tile(at, (100, 1))
    boxes[:, :2] += np.random.default_rng(0).normal(0.0, sd, (100, 2))
    return asked.measure(frame(image, index), boxes, reference)


@pytest.mark.parametrize("move", [(0.0, 0.0), (3.4, -2.7), (11.25, 8.5)])
@pytest.mark.parametrize(("scale", "angle"), [(1.0, 0.0), (1.08, 0.0), (0.94, 4.0), (1.0, -7.0)])
def test_place_and_size_follow_the_points(ask, move, scale, angle):
    """Cubic resampling and 8-bit values move corners by a tenth of a pixel or so."""
    asked = ask("klt")
    found = measured(asked, asked.learn(frame(picture()), BOX), picture(move, scale, angle))
    assert found.fields == ("x", "y", "w", "h")
    np.testing.assert_allclose(found.mean[:2], BOX[:2] + move, atol=0.3)
    np.testing.assert_allclose(found.mean[2:], BOX[2:] * scale, rtol=0.01)
    assert (
        np.abs(found.mean - [*(BOX[:2] + move), *(BOX[2:] * scale)]) < 3 * np.sqrt(np.diag(found.covariance))
    ).all()


def test_it_may_measure_how_fast_the_points_went(ask):
    asked = ask("klt", against="velocity")
    reference = asked.learn(frame(picture()), BOX)
    found = measured(asked, reference, picture((8.0, -4.0)), index=2)
    assert found.fields == ("vx", "vy")
    np.testing.assert_allclose(found.mean, (4.0, -2.0), atol=0.15)
    once = measured(asked, reference, picture((8.0, -4.0)), index=1)
    np.testing.assert_allclose(once.mean, 2 * found.mean)
    np.testing.assert_allclose(once.covariance, 4 * found.covariance)
    assert measured(asked, reference, picture((8.0, -4.0)), index=0) is None


def test_hidden_points_are_dropped_and_too_few_are_none(ask):
    asked = ask("klt")
    reference = asked.learn(frame(picture()), BOX)
    sds = []
    for hidden in (0.0, 0.5, 0.9):
        found = measured(asked, reference, picture((4.0, 2.0), hidden=hidden))
        if hidden == 0.9:
            assert found is None
            continue
        np.testing.assert_allclose(found.mean[:2], BOX[:2] + [4.0, 2.0], atol=0.5)
        sds.append(found.covariance[0, 0])
    assert sds[0] < sds[1]  # the fewer points, the less sure


def test_points_that_look_otherwise_are_dropped(ask):
    """What covers the target moves with it: only the patches tell."""
    asked = ask("klt")
    reference = asked.learn(frame(picture()), BOX)
    cover = np.where(np.abs(np.arange(320)[None, :, None] - 160) < 28, 255 - picture(), picture())
    assert measured(asked, reference, cover) is None


def test_lost_points_are_replaced_and_the_rest_kept(ask):
    asked = ask("klt")
    old = asked.learn(frame(picture()), BOX)
    now = BOX + [4.0, 2.0, 0.0, 0.0]
    new = asked.learn(frame(picture((4.0, 2.0), hidden=0.4), 1), now)
    after = asked.cue.blend(old, new, 0.2)
    kept = [(np.abs(p[None] - old["patches"]).max(axis=(1, 2)) == 0).any() for p in after["patches"]]
    assert 0.3 * len(old["at"]) <= sum(kept) < len(old["at"])
    assert len(after["at"]) > sum(kept)
    apart = np.linalg.norm(after["at"][:, None] - after["at"][None], axis=2) + 99 * np.eye(len(after["at"]))
    assert apart.min() >= 3.0
    assert (np.abs(after["at"] - now[:2]) <= now[2:] / 2 + 1).all()
    assert float(after["time"]) == 1.0
    np.testing.assert_allclose(after["box"], now, atol=0.5)


def test_places_do_not_drift_by_rounding(ask):
    """30 frames of 0.37 and 0.21 px: whole pixels would lose all of it."""
    asked = ask("klt")
    reference = asked.learn(frame(picture()), BOX)
    for index in range(1, 31):
        move = np.array([0.37, 0.21]) * index
        found = measured(asked, reference, picture(move), index, at=BOX + [*move, 0, 0])
        box = np.concatenate([found.mean[:2], BOX[2:]])
        reference = asked.cue.blend(reference, asked.learn(frame(picture(move), index), box), 0.2)
    np.testing.assert_allclose(found.mean[:2], BOX[:2] + move, atol=1.0)


def test_the_old_points_are_kept_through_a_short_gap_only(ask):
    asked = ask("klt", patience=3.0)
    old = asked.learn(frame(picture()), BOX)
    for index in (1, 2):
        gone = asked.learn(frame(WALL, index), BOX)
        assert asked.cue.blend(old, gone, 0.2) is old
    assert measured(asked, old, picture((2.0, 1.0)), 3) is not None
    late = asked.learn(frame(WALL, 4), BOX)
    assert asked.cue.blend(old, late, 0.2) is late


def test_a_channel_is_followed_where_brightness_shows_nothing(ask):
    """Red against green of the same brightness."""
    red = np.clip(TARGET[..., 0].astype(float), 40, 215)
    image = np.dstack([np.full_like(red, 90), 128 + (128 - red) * 0.299 / 0.587, red]).astype(np.uint8)
    asked = ask("klt")
    reference = asked.learn(frame(image), BOX)
    np.testing.assert_array_equal(reference["mix"], [0, 0, 1])
    found = measured(asked, reference, np.roll(image, (3, 5), axis=(0, 1)))
    np.testing.assert_allclose(found.mean[:2], BOX[:2] + [5, 3], atol=0.2)
    np.testing.assert_array_equal(asked.learn(frame(picture()), BOX)["mix"], [0.114, 0.587, 0.299])


def test_consensus_is_that_of_the_most_points():
    """25 of 40 points turn together, 15 fly apart: they are told apart exactly, in any order."""
    rng = np.random.default_rng(5)
    source = rng.uniform(0, 60, (40, 2))
    angle = np.radians(12.0)
    turn = 1.1 * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    target = source @ turn.T + [7.0, -3.0] + rng.normal(0, 0.05, (40, 2))
    target[25:] += rng.uniform(5, 20, (15, 2)) * rng.choice([-1, 1], (15, 2))
    order = rng.permutation(40)
    found = consensus(source[order], target[order], 1.0, 5.0, 1.5)
    np.testing.assert_array_equal(found, order < 25)
    assert not consensus(np.zeros((0, 2)), np.zeros((0, 2)), 1.0, 5.0, 1.5).size


def test_the_spread_of_the_errors_is_what_the_covariance_says(ask):
    """Pictures with noise: errors of the place stay within three sds, which are 5 times too wide at most."""
    asked = ask("klt", sd_px=0.02)
    rng = np.random.default_rng(8)
    reference = asked.learn(frame(picture()), BOX)
    errors, sds = [], []
    for _ in range(20):
        move = rng.uniform(-4, 4, 2)
        noisy = np.clip(picture(move) + rng.normal(0, 6, (240, 320, 3)), 0, 255).astype(np.uint8)
        found = measured(asked, reference, noisy)
        errors.append(found.mean[:2] - BOX[:2] - move)
        sds.append(np.sqrt(found.covariance[0, 0]))
    assert np.abs(errors).max() <= 3 * np.mean(sds)
    assert np.mean(sds) <= 5 * np.std(errors)


def test_followed_shows_the_points(ask):
    asked = ask("klt")
    reference = asked.learn(frame(picture()), BOX)
    planes = asked.planes(frame(picture((4.0, 2.0))), Region(0, 0, 320, 240))
    motion = asked.cue.followed(planes, BOX, reference)
    assert motion.places.shape == reference["at"].shape and motion.kept.mean() > 0.6
