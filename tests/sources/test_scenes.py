"""Each scene shows what it is for, and its truth is what is seen."""

import numpy as np
import pytest

from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.sources.scenes import make_scene, random_geometry, scene_names, two_squares
from bayesnet_track.sources.scenes.people import carried_box, person_and_board, person_parts
from bayesnet_track.sources.scenes.scene import visible_share
from bayesnet_track.sources.scenes.shapes import ball_between_children, bouncing, occluder


def shared_area(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.prod(np.clip(40.0 - np.abs(a - b)[:, :2], 0, None), axis=1)


LARGE = ("glass_wall", "person_color_stereo", "two_people_color_stereo_shape")
"""Scenes that take long to build or to draw, and those that are others with other settings."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name in LARGE or "same_clothes" in name else ())
        for name in scene_names()
    ],
)
def test_every_scene_is_whole_and_reproducible(name):
    scene, again = make_scene(name, 5), make_scene(name, 5)
    n = len(scene.frames)
    assert scene.name == name
    assert scene.truth.shape == (n, 4) and scene.visible.shape == (n,)
    assert all(other.shape == (n, 4) for other in scene.others)
    assert scene.start_box == tuple(scene.truth[0]) and scene.visible[0] == pytest.approx(1.0)
    assert scene.frames[7].shape == (scene.height, scene.width, 3)
    np.testing.assert_array_equal(scene.frames[7], again.frames[7])
    assert (scene.frames[7] != make_scene(name, 6).frames[7]).any()
    # The truth is a corner box: it lies inside the picture, whose columns are 0 .. width - 1.
    assert (scene.truth[:, :2] >= -1e-9).all()
    assert (scene.truth[:, :2] + scene.truth[:, 2:] <= [scene.width + 1e-9, scene.height + 1e-9]).all()


@pytest.mark.parametrize("make", [ball_between_children, carried_box, person_and_board, person_parts])
def test_a_scene_has_the_name_of_what_makes_it(make):
    named, made = make_scene(make.__name__, 3), make(3)
    np.testing.assert_array_equal(named.truth, made.truth)
    np.testing.assert_array_equal(named.frames[5], made.frames[5])


def test_the_two_squares_meet_when_stated():
    scene = make_scene("two_squares")
    assert scene.truth.shape == (200, 4)
    assert centre_from_corner(scene.truth[0]).tolist() == [270, 190, 40, 40]
    assert centre_from_corner(scene.others[0][0]).tolist() == [50, 60, 40, 40]
    area = shared_area(scene.truth, scene.others[0])
    assert np.flatnonzero(area).tolist() == [*range(25, 35), *range(174, 184)]
    assert int(area.argmax()) == 29


def test_the_truth_is_where_the_orange_is():
    scene = make_scene("two_squares", 1)
    for index in (0, 13, 60):
        image = scene.frames[index].astype(float)
        x, y, w, h = scene.truth[index]
        orange = image[:, :, 2] - image[:, :, 0] > 100
        columns, rows = np.arange(scene.width), np.arange(scene.height)
        inside = np.outer((rows >= y) & (rows <= y + h - 1), (columns >= x) & (columns <= x + w - 1))
        assert orange[inside].all()
        assert abs(orange.sum() - 2 * 1600) < 160  # two squares, their borders half covered


def test_bouncing_agrees_with_moving_step_by_step():
    path = bouncing((50.0, 60.0), (3.5, -4.25), 40, 300, 320, 240)
    position, step = np.array([50.0, 60.0]), np.array([3.5, -4.25])
    low, high = np.array([19.5, 19.5]), np.array([299.5, 219.5])
    for box in path:
        np.testing.assert_allclose(box, [*position, 40, 40], atol=1e-9)
        position = position + step
        for k in (0, 1):
            if position[k] < low[k]:
                position[k], step[k] = 2 * low[k] - position[k], -step[k]
            elif position[k] > high[k]:
                position[k], step[k] = 2 * high[k] - position[k], -step[k]


@pytest.mark.parametrize("count", [8, pytest.param(50, marks=pytest.mark.slow)])
def test_random_geometries_cross_and_part_again(count):
    rng = np.random.default_rng(0)
    drawn = {random_geometry(rng) for _ in range(count)}
    assert len(drawn) == count
    for geometry in drawn:
        scene = two_squares(0, geometry)
        area = shared_area(scene.truth, scene.others[0]) / 1600
        assert area[:10].max() == 0 and area.max() >= 0.5 and area[-1] == 0
        for step in (geometry.target_step, geometry.other_step):
            assert 2 <= np.hypot(*step) <= 5


def test_the_gray_square_hides_the_orange_one_at_frame_23_only():
    scene = make_scene("orange_and_gray")
    assert np.flatnonzero(scene.visible == 0).tolist() == [23]
    image = scene.frames[23].astype(float)
    assert (image[:, :, 2] - image[:, :, 0]).max() < 60


@pytest.mark.parametrize("hidden", [1, 11, 22, 38])
def test_the_occluder_hides_for_exactly_the_stated_frames(hidden):
    for seed in range(4):
        scene = occluder(seed, hidden)
        frames = np.flatnonzero(scene.visible == 0)
        assert frames.tolist() == list(range(frames[0], frames[0] + hidden))
        assert scene.visible[-1] == pytest.approx(1.0)


def test_occluder_refuses_what_it_cannot_hide():
    with pytest.raises(ValueError, match="hidden must be 1 to 38 frames, not 41"):
        occluder(0, 41)


def test_gray_square_has_no_colour():
    image = make_scene("gray_square", 2).frames[30].astype(float)
    # Noise alone: the difference of two channels has variance 2 (16 + 1/12), less where it is clipped.
    assert (image[:, :, 2] - image[:, :, 0]).std() < 1.02 * np.sqrt(2 * (16 + 1 / 12))
    assert image.mean(axis=2).std() > 20


def test_visible_share_against_counting_points():
    path = np.array([[10.0, 12.0, 20.0, 16.0], [0.0, 0.0, 8.0, 8.0]])
    nearer = (np.array([[5.0, 12.0, 8.0, 30.0]] * 2), np.array([[8.0, 16.0, 12.0, 6.0]] * 2))
    expected = []
    for x, y, w, h in path:
        xs, ys = np.meshgrid(
            x - w / 2 + w * (np.arange(400) + 0.5) / 400, y - h / 2 + h * (np.arange(400) + 0.5) / 400
        )
        seen = (xs > -0.5) & (xs < 63.5) & (ys > -0.5) & (ys < 47.5)
        for other in nearer:
            ox, oy, ow, oh = other[0]
            seen &= ~((abs(xs - ox) < ow / 2) & (abs(ys - oy) < oh / 2))
        expected.append(seen.mean())
    # A 400 x 400 grid misplaces an edge by at most 1/800 of the side; six edges can matter.
    np.testing.assert_allclose(visible_share(path, nearer, 64, 48), expected, atol=6 / 800)


def test_unknown_names_are_answered_with_the_nearest():
    with pytest.raises(ValueError, match="did you mean two_squares"):
        make_scene("two_square")
    with pytest.raises(ValueError, match="a seed is 0 or more"):
        make_scene("occluder", -1)


def test_the_ball_rests_and_flies():
    scene = make_scene("ball_between_children", 3)
    centres = centre_from_corner(scene.truth)[:, :2]
    steps = np.hypot(*np.diff(centres, axis=0).T)
    flying = [*range(2, 8), *range(22, 28)]  # steps into frames 3 .. 8 and 23 .. 28
    assert steps[flying].min() > 20.0
    assert np.delete(steps, flying).max() < 3.0
    child = centre_from_corner(scene.others[0])
    near = np.abs(centres - child[:, :2]) < child[:, 2:] / 2 + 11
    assert near[:3].all() and near[28:].all() and not near[8:22].all(axis=1).any()
