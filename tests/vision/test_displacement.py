"""The displacement-matrix tracker on pictures whose motion is known, and its graph on a scene."""

import numpy as np
import pytest

from bayesnet_track import Tracker
from bayesnet_track.journal.events.beliefs import BeliefReset
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.vision.points import (
    Matching,
    Points,
    cut_patches,
    displace,
    flat_motion,
    matrix_moments,
    predict_matrices,
    working_points,
)

STILL = np.zeros(2, dtype=np.int64)


@pytest.fixture
def texture():
    rng = np.random.default_rng(5)
    return rng.integers(30, 220, (120, 160), dtype=np.uint8)


def points_on(image, at, matching, side=9):
    at = np.array(at, dtype=np.int64)
    patches, whole = cut_patches(image, (0, 0), at, side)
    assert whole.all()
    return Points(at, patches, flat_motion(len(at), matching), STILL)


def test_points_stay_on_their_features_frame_after_frame(texture):
    """12 frames at (3, -2) px per frame; the matrices are moved along once they are not centred on 0."""
    matching = Matching(reach=6)
    points = points_on(texture, [[40, 80], [55, 70], [60, 90]], matching)
    start = points.at
    for frame in range(1, 13):
        image = np.roll(texture, (-2 * frame, 3 * frame), axis=(0, 1))
        found = displace(points, image, (0, 0), 1.0, np.array([frame % 3, -1]), matching)
        np.testing.assert_allclose(found.motion, [3, -2], atol=1e-2)
        points = found.points
        np.testing.assert_array_equal(points.at, start + frame * np.array([3, -2]))
        assert found.total.sum() == pytest.approx(1.0) and found.seen.all()


def test_a_gap_is_looked_over_at_the_speed_per_frame(texture):
    matching = Matching(reach=4)
    points = points_on(texture, [[50, 60], [70, 50]], matching)
    found = displace(points, np.roll(texture, (6, -9), axis=(0, 1)), (0, 0), 3.0, STILL, matching)
    np.testing.assert_allclose(found.motion, [-3, 2], atol=1e-2)
    np.testing.assert_array_equal(found.points.at, points.at + np.array([-9, 6]))


def test_a_point_on_an_edge_follows_the_object():
    """Along an edge every displacement fits; x_opt takes the one the object takes, whatever the maximum."""
    image = np.full((80, 80), 60, np.uint8)
    image[20:60, 20:60] = 180  # a square: three corners and a point in the middle of its left side
    matching = Matching(reach=5, epsilon=0.3)
    points = points_on(image, [[20, 20], [59, 20], [20, 59], [20, 40]], matching)
    found = displace(points, np.roll(image, (3, 2), axis=(0, 1)), (0, 0), 1.0, STILL, matching)
    edge = found.points.motion[3]
    assert edge.sum(axis=0)[5 + 2] > 0.99  # the edge moves by 2 across, whatever it does along
    assert edge.max() < 0.15 and np.sqrt(matrix_moments(edge)[1][1, 1]) > 2.5
    # The edge's own matrix draws the mean of P_sum to (9 + 0) / 4 = 2.25: it moves by 2, a corner by 3.
    assert found.motion[1] == pytest.approx(2.25, abs=0.05)
    np.testing.assert_array_equal(found.points.at, points.at + np.array([[2, 3], [2, 3], [2, 3], [2, 2]]))


def test_filtering_tells_what_one_frame_cannot():
    """A period of 4 px: three displacements fit a frame; the one that a second feature shows is kept."""
    stripes = np.tile(np.array([40, 40, 200, 200], np.uint8), (60, 20))
    matching = Matching(reach=5, sd_motion_px=0.5)
    free = points_on(stripes, [[40, 30]], matching)
    known = np.zeros_like(free.motion)
    known[0, :, 5 + 1] = 1.0 / 11
    informed = Points(free.at, free.patches, known, STILL)
    moved = np.roll(stripes, 1, axis=1)
    across = [
        displace(p, moved, (0, 0), 1.0, STILL, matching).points.motion[0].sum(axis=0)
        for p in (free, informed)
    ]
    assert across[0][5 - 3] == pytest.approx(across[0][5 + 1]) and across[0][5 + 5] > 0.3
    assert across[1][5 + 1] > 0.999


def test_a_jump_of_the_velocity_starts_a_point_again(texture):
    matching = Matching(reach=8, sd_motion_px=0.3)
    points = points_on(texture, [[60, 60]], matching)
    for _ in range(3):
        points = displace(points, texture, (0, 0), 1.0, STILL, matching).points
    found = displace(points, np.roll(texture, 7, axis=1), (0, 0), 1.0, STILL, matching)
    np.testing.assert_array_equal(found.points.motion, found.measured)
    np.testing.assert_array_equal(found.points.at, [[67, 60]])


def test_what_fits_nowhere_says_nothing(texture):
    matching = Matching(reach=3)
    points = points_on(texture, [[60, 60]], matching)
    other = np.random.default_rng(6).integers(30, 220, texture.shape, dtype=np.uint8)
    assert displace(points, other, (0, 0), 1.0, STILL, matching) is None
    assert displace(points, np.full_like(texture, 128), (0, 0), 1.0, STILL, matching) is None
    assert displace(points, texture[:20, :20], (0, 0), 1.0, STILL, matching) is None


def test_the_prediction_adds_noise_and_moves_with_the_range():
    matching = Matching(reach=20, sd_motion_px=2.0)
    motion = np.zeros((1, 41, 41))
    motion[0, 20 + 3, 20 - 4] = 1.0
    points = Points(np.zeros((1, 2), np.int64), np.zeros((1, 3, 3)), motion, np.array([1, 1]))
    centre = np.array([-2, 2])
    moved = predict_matrices(points, 2.0, centre, matching)[0]
    mean, covariance = matrix_moments(moved)
    np.testing.assert_allclose(mean + centre, [-3, 4], atol=1e-3)  # as before: 1 - 4, 1 + 3
    np.testing.assert_allclose(np.diag(covariance), 8.0, rtol=1e-3)  # 2 px^2 per frame, dt 2
    flat = Points(points.at, points.patches, flat_motion(1, matching), np.array([30, 0]))
    np.testing.assert_allclose(predict_matrices(flat, 1.0, STILL, matching), 1 / 41**2, rtol=1e-12)


def test_working_points_lie_between_the_maximum_and_the_object():
    matrix = np.zeros((1, 7, 7))
    matrix[0, 3, 3], matrix[0, 3, 5], matrix[0, 0, 6] = 0.5, 0.3, 0.05
    object_motion = np.array([3.0, -3.0])
    chosen = [
        working_points(matrix, object_motion, Matching(reach=3, epsilon=e))[0].tolist()
        for e in (1.0, 0.5, 0.1)
    ]
    assert chosen == [[0, 0], [2, 0], [3, -3]]


@pytest.mark.slow
def test_the_graph_holds_its_target_through_bounces():
    scene = make_scene("gray_square", 1)
    tracker = Tracker("grid_displacement", seed=1)
    tracker.init(scene.frames[0], scene.start_box)
    boxes, events = [], []
    for k in range(1, 90):
        boxes.append(tracker.update(scene.frames[k])[1])
        events += tracker.events
    held = overlap(centre_from_corner(np.array(boxes)), centre_from_corner(scene.truth[1:90]))
    assert held.mean() > 0.9 and held.min() > 0.7
    assert not any(isinstance(event, BeliefReset | Quarantined) for event in events)
