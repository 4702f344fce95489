"""Cameras: against OpenCV's projection, against points on the ellipsoid's surface, against differences."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.cameras import (
    Camera,
    CameraError,
    GroundHomography,
    camera_of_projection,
)
from bayesnet_track.numerics.lenses import distort, reach, undistort

SIZE = (1280, 720)
LENSES = {
    "none": [],
    "brown": [-0.28, 0.07, 0.001, -0.0007, -0.008],
    "rational": [0.4, -0.1, 0.0005, 0.0003, 0.01, 0.7, -0.05, 0.02],
    "prism": [-0.1, 0.02, 0.001, -0.002, 0.0, 0.0, 0.0, 0.0, 0.003, -0.001, 0.002, 0.001],
}


def looking(
    centre: tuple[float, float, float], at: tuple[float, float, float], distortion: list[float] | None = None
) -> Camera:
    """A camera in `centre` that looks at a point, its image upright."""
    z = np.subtract(at, centre) / np.linalg.norm(np.subtract(at, centre))
    x = np.cross(z, [0.0, 0.0, 1.0]) if abs(z[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    rotation = np.array([x, np.cross(z, x), z])
    matrix = np.array([[900.0, 0.7, 645], [0, 880, 352], [0, 0, 1]])
    return Camera(matrix, np.array(distortion or []), rotation, -rotation @ np.array(centre), SIZE)


VIEWS = {
    "street": ((0.0, -12.0, 5.0), (0.0, 3.0, 0.0)),
    "near": ((0.0, -2.5, 1.6), (0.0, 0.0, 0.9)),
    "overhead": ((0.1, 0.2, 6.0), (0.1, 0.2, 0.0)),
    "level": ((0.0, -6.0, 1.0), (0.0, 6.0, 1.0)),
}
PEOPLE = np.array([[0.0, 0.0, 0.6, 1.8], [1.1, 0.7, 0.8, 1.6], [-0.9, 0.2, 1.4, 0.5], [0.3, -0.2, 0.1, 2.1]])


def surface(target: Floats) -> Floats:
    """Points (n, 3) on the surface of a target's ellipsoid."""
    up, around = np.meshgrid(np.linspace(0, np.pi, 160), np.linspace(0, 2 * np.pi, 320))
    sphere = np.stack([np.sin(up) * np.cos(around), np.sin(up) * np.sin(around), np.cos(up)], axis=-1)
    x, y, w, h = target
    return np.asarray(sphere.reshape(-1, 3) * [w / 2, w / 2, h / 2] + [x, y, h / 2])


def bounds(pixels: Floats) -> Floats:
    """The smallest box (4,), centre first, around pixels (n, 2)."""
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    return np.concatenate([(low + high) / 2, high - low])


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("lens", LENSES)
def test_points_are_projected_as_by_opencv(view: str, lens: str) -> None:
    camera = looking(*VIEWS[view], LENSES[lens])
    points = np.random.default_rng(1).uniform([-1.2, -0.6, 0], [1.2, 1.5, 1.5], (200, 3))
    rotation, _ = cv2.Rodrigues(camera.rotation)
    flat = camera.matrix[:2]
    ideal, _ = cv2.projectPoints(points, rotation, camera.translation, np.eye(3), camera.distortion)
    expected = ideal[:, 0] @ flat[:, :2].T + flat[:, 2]  # OpenCV's projection leaves the skew out
    projected = camera.project(points)
    seen = ~np.isnan(projected).any(axis=1)
    assert seen.sum() > 150
    assert np.abs(projected - expected)[seen].max() < 1e-8


def test_a_fisheye_lens_is_that_of_opencv() -> None:
    base = looking((0.0, -4.0, 3.0), (0.0, 0.0, 0.5))
    matrix = np.array([[400.0, 0, 640], [0, 410, 360], [0, 0, 1]])
    camera = Camera(
        matrix, np.array([0.05, -0.01, 0.003, -0.001]), base.rotation, base.translation, fisheye=True
    )
    points = np.random.default_rng(2).uniform([-4, -1, 0], [4, 6, 2], (100, 3))
    points[0] = camera.centre + 3 * base.rotation[2]  # on the optical axis
    rotation, _ = cv2.Rodrigues(camera.rotation)
    expected, _ = cv2.fisheye.projectPoints(
        points[:, None], rotation, camera.translation, matrix, camera.distortion
    )
    assert np.abs(camera.project(points) - expected[:, 0]).max() < 1e-8
    ground = points[:, :2]
    pixels = camera.project(np.column_stack([ground, np.zeros(100)]))
    assert np.abs(camera.ground_points(pixels) - ground)[~np.isnan(pixels).any(axis=1)].max() < 1e-7


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("view", VIEWS)
def test_a_box_is_the_smallest_one_around_the_ellipsoid(view: str, lens: str) -> None:
    camera = looking(*VIEWS[view], LENSES[lens])
    boxes = camera.boxes(PEOPLE)
    expected = np.array([bounds(camera.project(surface(target))) for target in PEOPLE])
    assert np.isfinite(boxes).all()
    assert np.abs(boxes - expected).max() < 0.2


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("view", VIEWS)
def test_derivatives_are_those_of_differences(view: str, lens: str) -> None:
    camera = looking(*VIEWS[view], LENSES[lens])
    step = 1e-5 * np.eye(4)
    differences = np.stack(
        [(camera.boxes(PEOPLE + row) - camera.boxes(PEOPLE - row)) / 2e-5 for row in step], axis=-1
    )
    jacobian = camera.jacobian(PEOPLE)
    assert np.abs(jacobian - differences).max() < 1e-4 * np.abs(differences).max()


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("view", ["street", "near", "overhead"])
def test_the_ground_is_found_again_from_its_pixels(view: str, lens: str) -> None:
    camera = looking(*VIEWS[view], LENSES[lens])
    ground = np.random.default_rng(3).uniform([-1, -0.5], [1, 1.5], (50, 2))
    pixels = camera.project(np.column_stack([ground, np.zeros(50)]))
    seen = ~np.isnan(pixels).any(axis=1)
    assert seen.sum() > 30
    assert np.abs(camera.ground_points(pixels[seen]) - ground[seen]).max() < 1e-6


def test_what_cannot_be_seen_is_nan() -> None:
    camera = looking((0.0, -12.0, 5.0), (0.0, 3.0, 0.0), LENSES["brown"])
    behind = np.array([[0.0, -30.0, 0.5, 1.8], [0.0, 0.0, 0.5, 1.8], [0.0, -12.1, 0.5, 12.0]])
    assert np.isnan(camera.boxes(behind)).all(axis=1).tolist() == [True, False, True]
    assert np.isnan(camera.jacobian(behind)).all(axis=(1, 2)).tolist() == [True, False, True]
    assert np.isnan(camera.ground_points(np.array([[640.0, -300.0]]))).all()  # above the horizon
    assert np.isnan(camera.project(np.array([[60.0, -11.0, 4.0]]))).all()  # where the polynomial folds back
    assert np.isnan(camera.boxes(np.array([[np.nan, 0.0, 0.5, 1.8]]))).all()


@pytest.mark.parametrize("lens", ["none", "brown"])
def test_rows_that_are_no_targets_are_refused(lens: str) -> None:
    camera = looking((0.0, -12.0, 5.0), (0.0, 3.0, 0.0), LENSES[lens])
    for ask in (camera.boxes, camera.jacobian):
        with pytest.raises(ValueError, match=r"shape \(3, 6\)"):
            ask(np.ones((3, 6)))


def test_a_lens_is_inverted_up_to_its_reach() -> None:
    coefficients = np.array(LENSES["brown"])
    limit = reach(coefficients)
    inside = np.array([[0.9 * limit, 0.0], [0.0, -0.95 * limit], [0.0, 0.0]])
    assert np.abs(undistort(distort(inside, coefficients)[0], coefficients) - inside).max() < 1e-9
    assert np.isnan(undistort(np.array([[5.0, 0.0]]), coefficients)).all()


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("view", ["street", "near"])
def test_a_homography_gives_the_boxes_of_its_camera(view: str, sign: float) -> None:
    base = looking(*VIEWS[view])
    matrix = np.array([[900.0, 0, 639.5], [0, 900, 359.5], [0, 0, 1]])
    camera = Camera(matrix, np.zeros(0), base.rotation, base.translation, SIZE)
    plane = matrix @ np.column_stack([camera.rotation[:, :2], camera.translation])
    homography: Camera | GroundHomography = GroundHomography(sign * 0.3 * plane, SIZE)
    assert np.abs(homography.boxes(PEOPLE) - camera.boxes(PEOPLE)).max() < 1e-6
    assert np.abs(homography.jacobian(PEOPLE) - camera.jacobian(PEOPLE)).max() < 1e-4
    points = np.column_stack([PEOPLE[:, :2], np.zeros(4)])
    assert np.abs(homography.project(points) - camera.project(points)).max() < 1e-9
    assert np.abs(homography.ground_points(camera.project(points)) - points[:, :2]).max() < 1e-9
    mirrored = GroundHomography(plane @ np.diag([1.0, -1.0, 1.0]), SIZE)  # a map whose y points south
    flipped = PEOPLE * [1, -1, 1, 1]
    assert np.abs(mirrored.boxes(flipped) - camera.boxes(PEOPLE)).max() < 1e-6


def test_a_homography_from_straight_above_has_no_heights_without_a_focal_length() -> None:
    matrix = np.array([[900.0, 0, 639.5], [0, 900, 359.5], [0, 0, 1]])
    camera = Camera(matrix, np.zeros(0), np.diag([1.0, -1, -1]), np.array([0.0, 0, 6]), SIZE)
    plane = matrix @ np.column_stack([camera.rotation[:, :2], camera.translation])
    with pytest.raises(CameraError, match="straight down"):
        GroundHomography(plane, SIZE).boxes(PEOPLE)
    assert np.abs(GroundHomography(plane, SIZE, 900.0).boxes(PEOPLE) - camera.boxes(PEOPLE)).max() < 1e-6
    pixels = GroundHomography(plane).project(np.array([[0.5, 0.5, 0.0]]))
    assert np.abs(pixels - camera.project(np.array([[0.5, 0.5, 0.0]]))).max() < 1e-9


@pytest.mark.parametrize("scale", [1.0, -2.5])
def test_a_projection_is_taken_apart(scale: float) -> None:
    camera = looking(*VIEWS["street"])
    projection = camera.matrix @ np.column_stack([camera.rotation, camera.translation])
    again = camera_of_projection(scale * projection, SIZE)
    assert np.abs(again.matrix - camera.matrix).max() < 1e-9
    assert np.abs(again.rotation - camera.rotation).max() < 1e-12
    assert np.abs(again.boxes(PEOPLE) - camera.boxes(PEOPLE)).max() < 1e-8


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "reflection"),
        ({"rotation": np.diag([1.0, 1.0, 2.0])}, "not orthonormal"),
        ({"rotation": np.eye(2)}, "shape"),
        ({"translation": np.array([0.0, np.nan, 1.0])}, "not finite"),
        ({"matrix": np.eye(3).T * [-1, 1, 1]}, "camera matrix"),
        ({"distortion": np.zeros(3)}, "3 distortion coefficients"),
        ({"fisheye": True, "distortion": np.zeros(5)}, "allowed: 4"),
    ],
)
def test_numbers_of_no_camera_are_refused(change: dict[str, object], message: str) -> None:
    parts = {
        "matrix": np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]),
        "distortion": np.zeros(0),
        "rotation": np.eye(3),
        "translation": np.zeros(3),
    }
    with pytest.raises(CameraError, match=message):
        Camera(**{**parts, **change})  # type: ignore[arg-type]


def test_homographies_that_map_the_ground_onto_a_line_are_refused() -> None:
    with pytest.raises(CameraError, match="onto a line"):
        GroundHomography(np.array([[1.0, 2, 3], [2, 4, 6], [0, 0, 1]]))
    with pytest.raises(CameraError, match="dependent"):
        camera_of_projection(np.zeros((3, 4)))


def test_a_lens_that_bends_nothing_gives_the_same_boxes_and_derivatives():
    """A compiled closed form serves without distortion; with a vanishing one tangents are iterated."""
    rng = np.random.default_rng(5)
    turn, down = np.radians(20.0), np.radians(25.0)
    ahead = np.array([np.sin(turn) * np.cos(down), np.cos(turn) * np.cos(down), -np.sin(down)])
    right = np.array([np.cos(turn), -np.sin(turn), 0.0])
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    matrix = np.array([[900.0, 3.0, 640.0], [0.0, 850.0, 360.0], [0.0, 0.0, 1.0]])
    given = matrix, rotation, -rotation @ np.array([1.0, -2.0, 5.0]), (1280, 720)
    straight, bent = (Camera(given[0], np.array(lens), *given[1:]) for lens in ([], [1e-13, 0.0, 0.0, 0.0]))
    ground = np.column_stack(
        [rng.uniform(-15, 15, (400, 2)), rng.uniform(0.2, 2, 400), rng.uniform(0.5, 3, 400)]
    )
    boxes = straight.boxes(ground)
    assert 0.2 < np.isnan(boxes[:, 0]).mean() < 0.8
    np.testing.assert_allclose(boxes, bent.boxes(ground), rtol=1e-7)
    np.testing.assert_allclose(straight.jacobian(ground), bent.jacobian(ground), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("lens", ["none", "brown"])
@pytest.mark.parametrize("view", ["street", "near", "overhead"])
def test_a_target_in_space_is_the_ellipsoid_around_its_centre(view: str, lens: str) -> None:
    camera = looking(*VIEWS[view], LENSES[lens])
    standing = np.column_stack([PEOPLE, PEOPLE[:, 3] / 2])
    np.testing.assert_allclose(camera.boxes(standing), camera.boxes(PEOPLE), rtol=1e-12)
    raised = standing + [0.0, 0.0, 0.0, 0.0, 0.4]
    expected = np.array([bounds(camera.project(surface(row[:4]) + [0.0, 0.0, 0.4])) for row in raised])
    assert np.abs(camera.boxes(raised) - expected).max() < 0.2
    step = 1e-5 * np.eye(5)
    differences = np.stack(
        [(camera.boxes(raised + row) - camera.boxes(raised - row)) / 2e-5 for row in step], axis=-1
    )
    assert np.abs(camera.jacobian(raised) - differences).max() < 1e-4 * np.abs(differences).max()


@pytest.mark.parametrize("lens", ["none", "brown"])
def test_what_a_pixel_shows_lies_on_its_ray(lens: str) -> None:
    camera = looking(*VIEWS["street"], LENSES[lens])
    points = np.array([[0.3, 1.0, 2.0], [-1.0, 4.0, 0.5]])
    origin, rays = camera.sight(camera.project(points))
    depths = ((points - origin) * rays).sum(axis=1) / (rays**2).sum(axis=1)
    np.testing.assert_allclose(origin + depths[:, None] * rays, points, atol=1e-6)
