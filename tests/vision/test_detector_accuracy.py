"""Recall and precision on rendered scenes with truth.

A comment beside a bound holds the lowest figure of seeds 0 to 2 (street: 0 to 3, gray_square: 0 and 1,
stereo: 0), or, where there is none, it is 1. A bound lies below it by about `MARGIN`, three standard
deviations of a share p of n independent boxes, sqrt(p (1 - p) / n) with p = .98, n = 100.
The tests take seed 0.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.planes import Frame, FramePair
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.scene import Movie, Sprite, flat, smooth_background
from tests.vision.street import street

MARGIN = 0.04


def measured(bench, name, scene, end=60, skip=1, **parameters):
    found, _ = bench.run(bench.made(name, **parameters), bench.frames(scene, end))
    return bench.scored(found, scene, skip)


@pytest.mark.parametrize(
    ("kind", "split"),
    [
        ("two_squares", {}),
        pytest.param("two_squares", {"split": "otsu", "levels": 2}, marks=pytest.mark.slow),
        pytest.param("two_squares", {"split": "bands", "bands": [[125, 255]]}, marks=pytest.mark.slow),
        pytest.param("orange_and_gray", {}, marks=pytest.mark.slow),
        ("orange_and_gray", {"split": "otsu", "levels": 2}),
    ],
)
def test_gray_level_finds_both_squares(bench, kind, split):
    score = measured(bench, "gray_level", make_scene(kind, 0), **split)
    assert score.found > 85
    assert score.recall >= 1 - MARGIN and score.precision >= 1 - MARGIN  # 1. and 1.


def test_gray_level_sees_nothing_special_on_hills_of_every_gray(bench):
    assert measured(bench, "gray_level", make_scene("gray_square", 0)).found == 0


@pytest.mark.slow
def test_hues_find_both_squares_and_nothing_else(bench):
    score = measured(bench, "color_backprojection", make_scene("two_squares", 0), hue_deg=30)
    assert score.recall >= 1 - MARGIN and score.precision >= 1 - MARGIN
    assert measured(bench, "color_backprojection", make_scene("two_squares", 0), hue_deg=210).found == 0


def test_a_target_that_is_shown_is_found_again_among_others(bench):
    scene = make_scene("ball_between_children", 0)
    detector = bench.made("color_backprojection", min_area_px=150)
    frames, truth = bench.frames(scene, 30), centre_from_corner(scene.truth)
    assert not detector.knows_target(detector.start())
    shown = detector.learn(FramePair(frames[0], None), truth[0], detector.start())
    assert detector.knows_target(shown)
    found, _ = bench.run(detector, frames, shown)
    for k in range(3, 28):  # in the air; in a hand it is one region with the child
        assert np.hypot(*(found[k].boxes - truth[k])[:, :2].T).min() < 1.0


@pytest.mark.slow
def test_motion_finds_what_moves_and_not_what_stands(bench):
    score = measured(bench, "motion", make_scene("gray_square", 0))
    assert score.recall >= 1 - MARGIN and score.precision >= 1 - MARGIN


@pytest.mark.slow
def test_motion_finds_who_walks_in_a_street(bench):
    score = measured(bench, "motion", street(0), 75, 1)  # a cart stands in it
    assert score.recall >= 0.94 and score.precision >= 0.94  # .987 and .993


def test_motion_takes_the_cameras_own_out(bench):
    rng = np.random.default_rng(3)
    ground = smooth_background(420, 320, 120.0, 90.0, rng, cell=8)
    path = np.tile([160.0, 120.0, 40.0, 40.0], (20, 1))
    path[:, 0] += 3.0 * np.arange(20)
    cells = rng.integers(20, 236, (8, 8, 1)).astype(float).repeat(3, axis=2)
    images, boxes = [], []
    for k in range(20):
        left, top = 2 * k, k  # the camera pans by 2, 1 px a frame
        shift = np.array([left, top, 0.0, 0.0])
        images.append(Movie(ground, (Sprite(cells, path),), 3.0, 0)[k][top : top + 240, left : left + 320])
        boxes.append(path[k] - shift)
    frames = bench.pictures(images)
    moving, _ = bench.run(bench.made("motion"), frames)
    still, _ = bench.run(bench.made("motion", camera="still"), frames)
    hits = [
        len(found) == 1 and np.abs(found.boxes[0] - box).max() < 6.0
        for found, box in zip(moving[1:], boxes[1:], strict=True)
    ]
    assert np.mean(hits) > 0.9
    assert not any(
        len(f) == 1 and np.abs(f.boxes[0] - b).max() < 6 for f, b in zip(still, boxes, strict=True)
    )


@pytest.mark.slow
def test_the_background_bears_shadows_and_a_sudden_change_of_light(bench):
    scene = street(0)
    frames = bench.frames(scene, 112)
    found, _ = bench.run(bench.made("background"), frames)
    score = bench.scored(found, scene, 26)
    assert score.recall >= 1 - MARGIN and score.precision >= 0.83  # 1. and .875
    # the light changes in frame 100: nothing of the ground in it, everybody in it
    assert score_of(bench, found, scene, 100, 110).recall == 1.0
    assert score_of(bench, found, scene, 100, 110).false == 0


@pytest.mark.slow
def test_without_a_care_for_shadows_boxes_hold_them(bench):
    scene = street(0)
    frames = bench.frames(scene, 80)
    with_shadows = bench.scored(bench.run(bench.made("background", shadows=False), frames)[0], scene, 26)
    assert with_shadows.recall < 0.5  # .21


def score_of(bench, found, scene, begin, end):
    from bayesnet_track.observation.detector import NOTHING

    some = [one if begin <= k < end else NOTHING for k, one in enumerate(found)]
    return bench.scored(some[:end], scene, begin)


@pytest.mark.slow
def test_the_background_waits_and_learns_by_time_not_by_frames(bench):
    scene = street(0)
    frames = bench.frames(scene, 60)
    detector = bench.made("background", warm_up_frames=40)
    found, state = bench.run(detector, frames)
    assert not any(map(len, found[:40])) and all(map(len, found[40:]))
    # every second frame, with its own time, comes to nearly the same background
    _, halved = bench.run(detector, frames[::2])
    means = [one["means"][:, :, 0] for one in (state, halved)]
    still = np.abs(means[0] - means[1])[:40, :100]
    assert np.median(still) < 1.5  # noise of sd 4 in means of 60 and 30 frames: sd .9
    assert (state["weights"].sum(axis=2) == pytest.approx(1.0, abs=1e-4)) and state["times"].tolist() == [
        59,
        0,
    ]


def test_a_wholly_new_picture_starts_the_background_again(bench):
    one, other = (make_scene(name, 0).frames[0] for name in ("gray_square", "person_and_board"))
    blue = np.zeros_like(other)
    blue[:] = (250, 20, 20)
    frames = bench.pictures([one] * 30 + [blue] * 40)
    found, state = bench.run(bench.made("background", warm_up_frames=10), frames)
    assert not any(map(len, found)) and state["times"][1] >= 30


@pytest.mark.slow
def test_stereo_finds_both_people_off_the_floor_and_before_the_wall(bench):
    scene = make_scene("person_stereo", 0)
    detector = bench.made("stereo_blobs", camera_height_m=1.2, max_depth_m=6.0)
    frames = bench.frames(scene)
    found = [
        detector.detect(FramePair(frame, None), {})[0] if frame.index % 10 == 2 else None for frame in frames
    ]
    from bayesnet_track.observation.detector import NOTHING

    scores = [bench.scored([NOTHING] * k + [one], scene, k) for k, one in enumerate(found) if one is not None]
    score = sum(scores[1:], scores[0])
    assert score.found + score.missed >= 15
    assert score.recall >= 0.84 and score.precision >= 0.84  # .887 and .926


def test_contours_tell_a_person_from_a_board_of_the_same_size_and_colour(bench, person_model):
    scene = make_scene("person_and_board", 0)
    frames = bench.frames(scene, 43)[::6]  # later the glare lies behind the person
    truth, board = centre_from_corner(scene.truth), centre_from_corner(scene.others[0])
    detector = bench.made("contour_shape", model=person_model)
    for frame in frames:
        found, _ = detector.detect(FramePair(frame, None), {})
        assert len(found) == 1, frame.index
        assert np.abs(found.boxes[0] - truth[frame.index]).max() < 3.0
        assert np.abs(found.boxes[0] - board[frame.index]).max() > 10.0


@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("gray_level", {"median_px": 1}),
        ("color_backprojection", {"hue_deg": 30, "smooth_px": 0}),
        ("background", {"warm_up_frames": 3}),
    ],
)
def test_objects_of_three_pixels_are_found_when_asked_for(bench, name, more):
    path = np.tile([20.0, 30.0, 3.0, 3.0], (14, 1))
    path[:, 0] += 4 * np.arange(14)
    ground = smooth_background(100, 80, 100.0, 6.0, np.random.default_rng(0))
    movie = Movie(ground, (Sprite(flat((30.0, 135.0, 240.0)), path),), 2.0, 0)
    detector = bench.made(name, min_area_px=5, clean_px=0, join_px=0, **more)
    found, _ = bench.run(detector, bench.pictures(movie))
    for k, one in list(enumerate(found))[6:]:
        assert len(one) == 1 and np.abs(one.boxes[0] - path[k]).max() <= 1.0


def test_otsu_splits_where_an_exhaustive_search_does():
    from bayesnet_track.vision.detectors.gray_level import otsu_bands

    rng = np.random.default_rng(4)
    counts = np.zeros(256, np.int64)
    np.add.at(counts, np.clip(rng.normal([[60], [120], [200]], 12, (3, 500)), 0, 255).astype(int).ravel(), 1)
    values = np.arange(256)

    def scatter(*cuts):
        edges, total = (0, *cuts, 256), 0.0
        for low, high in pairwise(edges):
            mass = counts[low:high].sum()
            if mass:
                mean = (counts[low:high] * values[low:high]).sum() / mass
                total += (counts[low:high] * (values[low:high] - mean) ** 2).sum()
        return total

    best = min(scatter(a, b) for a in range(1, 255, 2) for b in range(a + 1, 256, 2))
    (_, a), (_, b), _ = otsu_bands(counts, 3)
    assert scatter(a + 1, b + 1) <= best + 1e-6


def test_a_frame_left_out_is_a_longer_interval_not_a_faster_target(bench):
    scene = make_scene("gray_square", 0)  # 3.8 px a frame
    frames = bench.frames(scene, 12)
    slow = bench.made("motion", flow="fine", min_speed_px=3.0)
    fast = bench.made("motion", flow="fine", min_speed_px=5.0)
    for first, second in ((4, 5), (4, 6)):
        pair = FramePair(frames[second], frames[first])
        assert len(slow.detect(pair, {})[0]) == 1 and len(fast.detect(pair, {})[0]) == 0
    same = Frame(5, 4.0, frames[5].image)
    assert len(slow.detect(FramePair(same, frames[4]), {})[0]) == 0  # no time has passed
