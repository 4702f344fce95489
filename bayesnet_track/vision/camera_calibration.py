"""Calibration of a camera over a ground: its lens from chessboards, its place from points of the ground.

Chessboards give a camera matrix and distortion (Zhang, 2000). Points of the ground whose metres are known
give the place of a camera whose lens is known, by a planar pose, or else a homography. A board that all
cameras see at the same moment gives the places of several. Each fit comes with its residuals, and is refused
where the points or views do not determine it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations
from pathlib import Path
from typing import Any

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Floats, Image
from bayesnet_track.numerics.cameras import Camera, GroundHomography
from bayesnet_track.numerics.outlines import GroundView
from bayesnet_track.observation.calibration_entries import Intrinsics
from bayesnet_track.observation.calibration_files import CalibrationError
from bayesnet_track.vision.calibration import Corners, board_seen, find_corners
from bayesnet_track.vision.planes import gray

LEAST_VIEWS = 5
MOST_VIEWS = 40
LEAST_POINTS = 4
FOCAL_SD = 0.02
"""Relative standard deviation of a focal length above which the views are refused."""
FLAT = 0.02
"""Least ratio of the points' spread across to that along their line."""


@dataclass(frozen=True)
class LensFit:
    """A lens and how well it fits.

    Attributes:
        intrinsics: camera matrix and distortion.
        rms_px: root mean square distance of the corners from where the fit predicts them.
        worst_px: the same of the worst view.
        focal_sd_px: standard deviation of the focal length, px.
        views: number of views used.
        covered: share of the image's width and height between the outermost corners.
    """

    intrinsics: Intrinsics
    rms_px: float
    worst_px: float
    focal_sd_px: float
    views: int
    covered: tuple[float, float]


def fit_lens(
    corners: Sequence[Corners],
    size: tuple[int, int],
    board: tuple[int, int],
    square_m: float,
    sample: Sequence[Image] = (),
) -> LensFit:
    """Camera matrix and distortion from the corners of a board in several views (cv2.calibrateCamera).

    Args:
        corners: those of each view in which the board is whole, as of `find_corners`.
        size: width and height of the images, px.
        board: inner corners along rows and columns.
        square_m: side of a square, m.
        sample: some of the images; if views are too few, a board of another size is sought in them.

    Raises:
        CalibrationError: too few views, or views that do not determine the focal length.
    """
    import cv2

    if len(corners) < LEAST_VIEWS:
        raise CalibrationError(
            f"the board of {board[0]}x{board[1]} inner corners is whole in {len(corners)} views; at least "
            f"{LEAST_VIEWS} are needed, tilted differently; count the corners where four squares meet"
            + board_seen(sample, board)
        )
    views = _spread(corners, MOST_VIEWS)
    world = [board_points(board, square_m).astype(np.float32)] * len(views)
    rms, matrix, distortion, _, _, spread, _, errors = cv2.calibrateCameraExtended(
        world, views, size, None, None, flags=cv2.CALIB_FIX_K3
    )
    sd = float(np.max(spread.ravel()[:2]))
    if not sd < FOCAL_SD * matrix[0, 0]:
        raise CalibrationError(
            f"the views do not determine the focal length: {matrix[0, 0]:.0f} px with a standard deviation "
            "of "
            f"{sd:.0f}; allowed: up to {FOCAL_SD:.0%}; tilt the board by 20 to 45 degrees, in several "
            "directions"
        )
    spots = np.concatenate([view.reshape(-1, 2) for view in views])
    covered = np.ptp(spots, axis=0) / size
    return LensFit(
        Intrinsics(matrix, distortion.ravel()[:5], size),
        float(rms),
        float(errors.max()),
        sd,
        len(views),
        (float(covered[0]), float(covered[1])),
    )


def _spread(views: Sequence[Corners], limit: int) -> list[Corners]:
    """The views, at most so many, each as different as possible from those before."""
    if len(views) <= limit:
        return list(views)
    spots = np.array([view.reshape(-1) for view in views])
    places = [0]
    distances = np.abs(spots - spots[0]).max(axis=1)
    while len(places) < limit:
        places.append(int(distances.argmax()))
        distances = np.minimum(distances, np.abs(spots - spots[places[-1]]).max(axis=1))
    return [views[place] for place in sorted(places)]


def board_points(board: tuple[int, int], square_m: float) -> Floats:
    """(corners, 3) of a board in its own coordinates, m, in the order of `find_corners`."""
    points = np.zeros((board[0] * board[1], 3))
    points[:, :2] = np.mgrid[: board[0], : board[1]].T.reshape(-1, 2) * square_m
    return points


@dataclass(frozen=True)
class GroundFit:
    """A camera over its ground, and how well it fits.

    Attributes:
        view: the camera.
        residuals_px: (N,) distances in the image, px.
        residuals_m: (N,) distances on the ground, m.
        spare: numbers measured beyond those that the fit needs.
        size: width and height of the image, px.
        extent_m: diagonal of the points on the ground, m.
    """

    view: GroundView
    residuals_px: Floats
    residuals_m: Floats
    spare: int
    size: tuple[int, int]
    extent_m: float

    @property
    def is_bad(self) -> Bools:
        """(N,) points off by more than clicks and a tape explain: 0.2 % of the image, 1 % of the ground."""
        off_image = self.residuals_px > 0.002 * math.hypot(*self.size)
        return np.asarray(off_image & ~(self.residuals_m < 0.01 * self.extent_m))


def fit_ground(
    pixels: Floats, ground: Floats, size: tuple[int, int], intrinsics: Intrinsics | None = None
) -> GroundFit:
    """The camera that sees points (N, 2) of the ground, in m, in pixels (N, 2).

    With the lens known, its place (cv2.solvePnP, two solutions refined); else the homography of least
    squares.

    Raises:
        CalibrationError: fewer than four points, points almost in a line, a mirrored ground, a lens of
            another image size.
    """
    if len(pixels) < LEAST_POINTS:
        raise CalibrationError(f"{len(pixels)} points; at least {LEAST_POINTS} are needed, better 6 to 10")
    _check_spread(ground, "on the ground")
    _check_spread(pixels, "in the image")
    if intrinsics is not None and intrinsics.size not in (None, size):
        w, h = intrinsics.size or size
        raise CalibrationError(
            f"the lens was calibrated with images of {w}x{h}, these are {size[0]}x{size[1]}; use images of "
            "one "
            "size, of the same mode of the camera"
            + ("; one of the two was filmed upright, the other on its side" * ((h, w) == tuple(size)))
        )
    spare = 2 * len(pixels) - (8 if intrinsics is None else 6)
    try:
        fit = _fit_in_order(pixels, ground, size, intrinsics, spare)
    except CalibrationError as error:
        if spare:
            _check_order(pixels, ground, size, intrinsics, f"{error}; they")
        raise
    if spare and fit.is_bad.any():
        rms = math.sqrt(float((fit.residuals_px**2).mean()))
        _check_order(pixels, ground, size, intrinsics, f"the points are {rms:.0f} px off (rms); they")
    return fit


def _fit_in_order(
    pixels: Floats, ground: Floats, size: tuple[int, int], intrinsics: Intrinsics | None, spare: int
) -> GroundFit:
    """The camera, for points that belong to each other as they are given."""
    if _is_mirrored(pixels, ground, size):
        raise CalibrationError(
            "the points are mirrored: seen from above, y must point to the left of x (x to the right, then "
            "y away "
            "from the camera); change the sign of one axis, or exchange x and y"
        )
    view: GroundView
    if intrinsics is None:
        view = GroundHomography(_homography(ground, pixels), size)
    else:
        view = _pose(pixels, ground, intrinsics, size)
    flat = np.column_stack([ground, np.zeros(len(ground))])
    return GroundFit(
        view,
        np.linalg.norm(view.project(flat) - pixels, axis=1),
        np.linalg.norm(view.ground_points(pixels) - ground, axis=1),
        spare,
        size,
        float(np.linalg.norm(np.ptp(ground, axis=0))),
    )


def _check_order(
    pixels: Floats, ground: Floats, size: tuple[int, int], intrinsics: Intrinsics | None, complaint: str
) -> None:
    """Refuse points that fit, or almost, when their metres are given in another order, and name it.

    All orders of four points are tried; of more, exchanges of two and shifts along the list.
    """
    count = len(pixels)
    orders = list(permutations(range(count))) if count == LEAST_POINTS else _changed_orders(count)
    fits = []
    for order in orders:
        try:
            fit = _fit_in_order(pixels, ground[list(order)], size, intrinsics, 0)
        except CalibrationError:
            continue
        if not fit.is_bad.any():
            fits.append((float((fit.residuals_px**2).mean()), order))
    if not fits:
        return
    square, order = min(fits)
    places = [n for n in range(count) if order[n] != n]
    metres = ", ".join(str(order[n] + 1) for n in places)
    raise CalibrationError(
        f"{complaint} fit to {math.sqrt(square):.1f} px in another order: give the pixels of "
        f"{', '.join(str(n + 1) for n in places)} the metres of {metres}"
    )


def _changed_orders(count: int) -> list[tuple[int, ...]]:
    places = tuple(range(count))
    shifts = [places[n:] + places[:n] for n in range(1, count)]
    exchanges = []
    for a, b in combinations(places, 2):
        order = list(places)
        order[a], order[b] = b, a
        exchanges.append(tuple(order))
    return shifts + exchanges


def _check_spread(points: Floats, location: str) -> None:
    """Refuse points of which no four stand apart: each three, or all but one, are almost in a line."""
    centred = points - points.mean(axis=0)
    if _flatness(centred) < FLAT:
        raise CalibrationError(
            f"the points are almost in one line {location}; allowed: points around an area"
        )
    for left_out in range(len(points)):
        remaining = np.delete(points, left_out, axis=0)
        if _flatness(remaining - remaining.mean(axis=0)) < FLAT / 2:
            raise CalibrationError(
                f"all points but number {left_out + 1} are almost in one line {location}; four are needed of "
                "which no "
                "three are in a line"
            )


def _flatness(centred: Floats) -> float:
    wide, narrow = np.linalg.svd(centred, compute_uv=False)[:2]
    return float(narrow / max(wide, 1e-300))


def _homography(source: Floats, destination: Floats) -> Floats:
    import cv2

    matrix, _ = cv2.findHomography(source, destination, 0)
    if matrix is None:
        raise CalibrationError("no homography fits the points: some of them may be exchanged")
    return np.asarray(matrix, dtype=np.float64)


def _is_mirrored(pixels: Floats, ground: Floats, size: tuple[int, int]) -> bool:
    """True if a camera above the ground would see it the other way round; its visible side has depth > 0."""
    matrix = _homography(ground, pixels)
    depths = np.column_stack([ground, np.ones(len(ground))]) @ matrix[2]
    if (depths > 0).any() and (depths < 0).any():
        raise CalibrationError(
            "the horizon would run between the points: some of them are exchanged, or have a wrong sign"
        )
    return bool(np.linalg.det(matrix * np.sign(depths[0])) > 0)


def _pose(pixels: Floats, ground: Floats, intrinsics: Intrinsics, size: tuple[int, int]) -> Camera:
    """The pose above the ground with the smallest residual, refined."""
    import cv2

    flat = np.column_stack([ground, np.zeros(len(ground))])
    lens = Camera(intrinsics.matrix, intrinsics.distortion, np.eye(3), np.zeros(3), size, intrinsics.fisheye)
    ideal = lens.rays(pixels)
    if np.isnan(ideal).any():
        number = int(np.isnan(ideal).any(axis=1).argmax()) + 1
        raise CalibrationError(f"point {number} is beyond the field in which the lens can be inverted")
    middle = flat.mean(axis=0)
    count, turns, shifts, _ = cv2.solvePnPGeneric(
        flat - middle, ideal[:, None], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    closest: tuple[float, Camera] | None = None
    for turn, shift in zip(turns[:count], shifts[:count], strict=True):
        fine, translation = cv2.solvePnPRefineLM(flat - middle, ideal[:, None], np.eye(3), None, turn, shift)
        rotation = np.asarray(cv2.Rodrigues(fine)[0], dtype=np.float64)
        place = np.asarray(translation, dtype=np.float64).ravel() - rotation @ middle
        camera = Camera(intrinsics.matrix, intrinsics.distortion, rotation, place, size, intrinsics.fisheye)
        error = float(np.nan_to_num(np.abs(camera.project(flat) - pixels), nan=np.inf).sum())
        if camera.centre[2] > 0 and (closest is None or error < closest[0]):
            closest = error, camera
    if closest is None:
        raise CalibrationError(
            "no camera above the ground sees the points there; some of them may be exchanged"
        )
    return closest[1]


def write_camera(path: Path, view: GroundView | Intrinsics, comments: Mapping[str, float]) -> None:
    """Write an OpenCV file (XML, JSON or YAML by its name) that `read_calibration` reads.

    Raises:
        OSError: the file cannot be written.
    """
    import cv2

    kind = path.suffix.lower() if path.suffix.lower() in (".xml", ".json") else ".yml"
    storage = cv2.FileStorage(kind, cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY)
    for name, value in camera_entries(view).items():
        storage.write(name, np.atleast_2d(value) if isinstance(value, np.ndarray) else value)
    for name, number in comments.items():
        storage.write(name, float(number))
    path.write_text(storage.releaseAndGetString(), encoding="utf-8")


def camera_entries(view: GroundView | Intrinsics) -> dict[str, Any]:
    """Entries of a camera by the names that `read_calibration` knows."""
    size = view.size
    entries: dict[str, Any] = {} if size is None else {"image_width": size[0], "image_height": size[1]}
    if isinstance(view, GroundHomography):
        return entries | {"ground_to_image": view.matrix}
    assert isinstance(view, Camera | Intrinsics)
    entries["camera_matrix"] = view.matrix
    if len(view.distortion):
        entries["distortion_coefficients"] = view.distortion
    if view.fisheye:
        entries["distortion_model"] = "fisheye"
    if isinstance(view, Camera):
        entries |= {"rotation": view.rotation, "translation": view.translation[:, None]}
    return entries


@dataclass(frozen=True)
class PosesFit:
    """Cameras that saw one board.

    Attributes:
        cameras: by name; the ground is the board's plane in the first view, its first inner corner the
        origin.
        residuals_px: root mean square distance of the corners, by name.
    """

    cameras: Mapping[str, Camera]
    residuals_px: Mapping[str, float]


def fit_poses(
    images: Mapping[str, Image], lenses: Mapping[str, Intrinsics], board: tuple[int, int], square_m: float
) -> PosesFit:
    """Places of cameras that see the same board, which lies on the ground, in one image each.

    Raises:
        CalibrationError: a board that looks the same when it is turned, or that a camera does not see whole.
    """
    if (board[0] + board[1]) % 2 == 0:
        raise CalibrationError(
            f"a board of {board[0]}x{board[1]} inner corners looks the same when it is turned around, so "
            "that the cameras could not agree on its corners; allowed: an even and an odd number, such as 9x6"
        )
    cameras, residuals = {}, {}
    world = board_points(board, square_m)
    for name, image in images.items():
        corners = find_corners(image, board)
        if corners is None:
            raise CalibrationError(
                f"camera {name}: the board of {board[0]}x{board[1]} inner corners is not whole in its image; "
                f"choose a frame in which all cameras see it{board_seen([image], board)}"
            )
        pixels = upright_order(image, np.asarray(corners, dtype=np.float64).reshape(-1, 2), board)
        fit = fit_ground(pixels, world[:, :2], image.shape[1::-1], lenses[name])
        assert isinstance(fit.view, Camera)
        cameras[name] = fit.view
        residuals[name] = float(np.sqrt((fit.residuals_px**2).mean()))
    return PosesFit(cameras, residuals)


def upright_order(image: Image, corners: Floats, board: tuple[int, int]) -> Floats:
    """Corners (N, 2) in the one order that all cameras above the board agree on.

    Rows run so that y is to the left of x seen from above, and the square beyond the first corner, outwards,
    is
    darker than the one beyond the last.
    """
    grid = corners.reshape(board[1], board[0], 2)
    if _is_mirrored(corners, board_points(board, 1.0)[:, :2], image.shape[1::-1]):
        grid = grid[::-1]
    bright = gray(image)

    def outer(corner: Floats, inner: Floats) -> float:
        x, y = np.clip((1.5 * corner - 0.5 * inner).round(), 0, np.array(bright.shape[::-1]) - 1).astype(int)
        return float(bright[y, x])

    if outer(grid[0, 0], grid[1, 1]) > outer(grid[-1, -1], grid[-2, -2]):
        grid = grid[::-1, ::-1]
    return np.ascontiguousarray(grid).reshape(-1, 2)
