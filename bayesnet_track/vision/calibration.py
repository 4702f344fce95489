"""Calibration of a pair of cameras: its file, its rectification, and how it is found from chessboards.

The file is OpenCV YAML. Either ``image_width image_height M1 D1 M2 D2 R T``, the names of OpenCV's own
samples (camera matrices, distortion, rotation and translation from the left camera to the right, T in m), or,
for pairs that are rectified already, ``image_width image_height focal_px baseline_m centre_x_px centre_y_px``
and, where the principal points differ, ``offset_px``; with the depth of another sensor, ``depth_unit_m``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Image
from bayesnet_track.observation.planes import StereoGeometry
from bayesnet_track.observation.settings import setting
from bayesnet_track.vision.planes import gray

RECTIFIED = ("focal_px", "baseline_m", "centre_x_px", "centre_y_px")
CAMERAS = ("M1", "D1", "M2", "D2", "R", "T")
ALLOWED = (
    f"OpenCV YAML with image_width, image_height and either {' '.join(CAMERAS)} or {' '.join(RECTIFIED)}"
)


class StereoCalibrationError(ValueError):
    """A calibration file, or chessboard pictures, from which no calibration can be had."""


@dataclass(frozen=True)
class RectifiedPair:
    """A pair whose rows correspond already.

    Attributes:
        width, height: of both pictures, px.
        geometry: the pair's.
        depth_unit_m: one step of a 16-bit depth image, m.
    """

    width: int
    height: int
    geometry: StereoGeometry
    depth_unit_m: float = 0.001

    def rectify(self, left: Image, right: Image) -> tuple[Image, Image]:
        """The pictures as they are."""
        return left, right


@dataclass(frozen=True, eq=False)
class Cameras:
    """Two calibrated cameras.

    Attributes:
        width, height: of both pictures, px.
        left, right: (3, 3) camera matrices.
        left_distortion, right_distortion: (k,) coefficients in OpenCV's order.
        rotation: (3, 3) from left to right camera coordinates.
        translation: (3,) the same, m; its x is negative when the right camera is on the right.
    """

    width: int
    height: int
    left: Floats
    left_distortion: Floats
    right: Floats
    right_distortion: Floats
    rotation: Floats
    translation: Floats


@dataclass(frozen=True, eq=False)
class Rectification:
    """Maps that turn the pictures of two cameras into a rectified pair.

    Attributes:
        width, height: of the pictures before and after, px.
        geometry: of the rectified pair.
        left_maps, right_maps: what `cv2.remap` takes.
    """

    width: int
    height: int
    geometry: StereoGeometry
    left_maps: tuple[Any, Any]
    right_maps: tuple[Any, Any]

    def rectify(self, left: Image, right: Image) -> tuple[Image, Image]:
        """Both pictures (H, W, 3) rectified; black where a camera did not look."""
        import cv2

        return (
            np.asarray(cv2.remap(left, *self.left_maps, cv2.INTER_LINEAR), dtype=np.uint8),
            np.asarray(cv2.remap(right, *self.right_maps, cv2.INTER_LINEAR), dtype=np.uint8),
        )


Rectifier = RectifiedPair | Rectification


def rectification(cameras: Cameras) -> Rectification:
    """Maps from the images of `cameras` to a rectified pair of the same size (`cv2.stereoRectify`, alpha 0).

    Raises:
        CalibrationError: the right camera is not on the right of the left one.
    """
    import cv2

    shift = cameras.translation
    if not shift[0] < 0 or abs(shift[1]) > abs(shift[0]):
        raise StereoCalibrationError(
            f"the right camera is at {', '.join(f'{-v:.3g}' for v in shift)} m (x, y, z) of the left one, "
            "not on its right; allowed: two cameras side by side; exchange left and right"
        )
    size = (cameras.width, cameras.height)
    left_rotation, right_rotation, left_projection, right_projection, *_ = cv2.stereoRectify(
        cameras.left,
        cameras.left_distortion,
        cameras.right,
        cameras.right_distortion,
        size,
        cameras.rotation,
        shift.reshape(3, 1),
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=0,
    )
    geometry = StereoGeometry(
        focal_px=float(left_projection[0, 0]),
        baseline_m=float(-right_projection[0, 3] / right_projection[0, 0]),
        centre_x_px=float(left_projection[0, 2]),
        centre_y_px=float(left_projection[1, 2]),
        offset_px=float(right_projection[0, 2] - left_projection[0, 2]),
    )
    maps = [
        cv2.initUndistortRectifyMap(matrix, distortion, turn, projection, size, cv2.CV_16SC2)
        for matrix, distortion, turn, projection in (
            (cameras.left, cameras.left_distortion, left_rotation, left_projection),
            (cameras.right, cameras.right_distortion, right_rotation, right_projection),
        )
    ]
    return Rectification(*size, geometry, maps[0], maps[1])


def read_rectification(path: Path) -> Rectifier:
    """Rectification of an OpenCV YAML file.

    Raises:
        CalibrationError: no such file, not OpenCV YAML, or an entry is missing or makes no sense.
    """
    entries = _entries(path)

    def number(name: str, minimum: float = -math.inf) -> float:
        value = entries.get(name)
        if not isinstance(value, float) or not math.isfinite(value) or not value > minimum:
            expected = "a number" if minimum == -math.inf else f"a number above {minimum:g}"
            raise _wrong(path, f"{name} is {'missing' if value is None else 'not ' + expected}")
        return value

    width, height = int(number("image_width", 0)), int(number("image_height", 0))
    if "focal_px" in entries:
        geometry = StereoGeometry(
            number("focal_px", 0),
            number("baseline_m", 0),
            number("centre_x_px"),
            number("centre_y_px"),
            number("offset_px") if "offset_px" in entries else 0.0,
        )
        unit = number("depth_unit_m", 0) if "depth_unit_m" in entries else 0.001
        return RectifiedPair(width, height, geometry, unit)

    def matrix(name: str, *shapes: tuple[int, ...]) -> Floats:
        value = entries.get(name)
        if not isinstance(value, np.ndarray):
            raise _wrong(path, f"{name} is missing or no matrix")
        if (shapes and value.shape not in shapes) or not np.isfinite(value).all() or value.size == 0:
            raise _wrong(path, f"{name} is {' x '.join(map(str, value.shape))}, or not finite")
        return value

    square = (3, 3)
    cameras = Cameras(
        width,
        height,
        matrix("M1", square),
        matrix("D1").ravel(),
        matrix("M2", square),
        matrix("D2").ravel(),
        matrix("R", square),
        matrix("T", (3, 1), (1, 3)).ravel(),
    )
    try:
        return rectification(cameras)
    except StereoCalibrationError as error:
        raise StereoCalibrationError(f"calibration file {str(path)!r}: {error}") from error
    except Exception as error:
        raise _wrong(path, "OpenCV cannot rectify with it") from error


def write_calibration(path: Path, calibration: Cameras | RectifiedPair) -> None:
    """Write what `read_rectification` reads.

    Raises:
        OSError: the file cannot be written.
    """
    import cv2

    storage = cv2.FileStorage(".yml", cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY)
    storage.write("image_width", calibration.width)
    storage.write("image_height", calibration.height)
    if isinstance(calibration, Cameras):
        values = (
            calibration.left,
            calibration.left_distortion.reshape(1, -1),
            calibration.right,
            calibration.right_distortion.reshape(1, -1),
            calibration.rotation,
            calibration.translation.reshape(3, 1),
        )
        for name, value in zip(CAMERAS, values, strict=True):
            storage.write(name, value)
    else:
        for name in (*RECTIFIED, "offset_px"):
            storage.write(name, float(getattr(calibration.geometry, name)))
        storage.write("depth_unit_m", calibration.depth_unit_m)
    path.write_text(storage.releaseAndGetString(), encoding="utf-8")


def _entries(path: Path) -> dict[str, Any]:
    import cv2

    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise _wrong(path, getattr(error, "strerror", None) or "not a text file") from error
    entries: dict[str, Any] = {}
    try:
        if not text.startswith("%YAML"):
            raise ValueError
        storage = cv2.FileStorage(text, cv2.FileStorage_READ | cv2.FileStorage_MEMORY)
        root = storage.root()
        for name in root.keys():  # noqa: SIM118 (a cv2.FileNode)
            node = storage.getNode(name)
            if node.isMap():
                entries[name] = np.asarray(node.mat(), dtype=np.float64)
            elif node.isInt() or node.isReal():
                entries[name] = float(node.real())
    except (cv2.error, TypeError, ValueError, SystemError) as error:
        raise _wrong(path, "it is not OpenCV YAML") from error
    return entries


def _wrong(path: Path, fault: str) -> StereoCalibrationError:
    return StereoCalibrationError(
        f"calibration file {str(path)!r}: {fault}; allowed: {ALLOWED}; "
        "`bayesnet-track calibrate stereo` writes one"
    )


Corners = NDArray[np.float32]

LEAST_VIEWS = 3
SOUGHT_SIDE = 1280
BOARD_FLAGS = 1 | 2
"""cv2.CALIB_CB_ADAPTIVE_THRESH, cv2.CALIB_CB_NORMALIZE_IMAGE."""


@dataclass(frozen=True, eq=False)
class Calibrated:
    """Two calibrated cameras and how well they fit.

    Attributes:
        cameras: the cameras.
        left_rms_px, right_rms_px: root mean square distance of the corners from where each camera alone
            predicts them.
        pair_rms_px: the same for both cameras together, with one rotation and translation.
        epipolar_px: mean difference of the rows of corresponding corners after rectification.
        used: places of the pairs in which both cameras show the whole board.
    """

    cameras: Cameras
    left_rms_px: float
    right_rms_px: float
    pair_rms_px: float
    epipolar_px: float
    used: tuple[int, ...]


def calibrate_pair(
    left: Sequence[Image], right: Sequence[Image], board: tuple[int, int], square_m: float
) -> Calibrated:
    """Calibrate from pairs of pictures (H, W, 3) of one board.

    Args:
        left, right: corresponding pictures, all of one size.
        board: inner corners along the board's rows and columns.
        square_m: side of a square, m; the scale of every depth.

    Raises:
        CalibrationError: pictures do not correspond, or the board is seen in too few pairs.
    """
    import cv2

    if len(left) != len(right):
        raise StereoCalibrationError(
            f"{len(left)} left pictures and {len(right)} right ones: each needs its partner"
        )
    sizes = {picture.shape[1::-1] for picture in (*left, *right)}
    if len(sizes) > 1:
        size_list = ", ".join(f"{w}x{h}" for w, h in sorted(sizes))
        raise StereoCalibrationError(f"pictures of several sizes ({size_list}); allowed: one size")
    pairs = [(find_corners(a, board), find_corners(b, board)) for a, b in zip(left, right, strict=True)]
    complete = tuple(n for n, pair in enumerate(pairs) if pair[0] is not None and pair[1] is not None)
    if len(complete) < LEAST_VIEWS:
        left_count, right_count = (sum(pair[k] is not None for pair in pairs) for k in (0, 1))
        raise StereoCalibrationError(
            f"a board of {board[0]}x{board[1]} inner corners is whole in {len(complete)} of {len(pairs)} "
            f"pairs ({left_count} left pictures, {right_count} right ones); at least {LEAST_VIEWS} are "
            f"needed; check {setting('--board', 'AxB', '(A, B)')}, which counts the corners where four "
            f"squares meet{board_seen(left[:: -(-len(left) // 6)], board)}"
        )
    size = next(iter(sizes))
    world = np.zeros((board[0] * board[1], 3), dtype=np.float32)
    world[:, :2] = np.mgrid[: board[0], : board[1]].T.reshape(-1, 2) * square_m
    worlds = [world] * len(complete)
    corners = [[spots for n in complete if (spots := pairs[n][k]) is not None] for k in (0, 1)]
    single_fits: list[Any] = [cv2.calibrateCamera(worlds, points, size, None, None)[:3] for points in corners]
    (left_rms, m1, d1), (right_rms, m2, d2) = single_fits
    rms, m1, d1, m2, d2, turn, shift, *_ = cv2.stereoCalibrate(
        worlds,
        corners[0],
        corners[1],
        m1,
        d1,
        m2,
        d2,
        size,
        flags=cv2.CALIB_FIX_INTRINSIC,
        criteria=(cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-6),
    )
    cameras = Cameras(size[0], size[1], m1, d1.ravel(), m2, d2.ravel(), turn, shift.ravel())
    epipolar = _row_difference(cameras, corners)
    return Calibrated(cameras, float(left_rms), float(right_rms), float(rms), epipolar, complete)


def find_corners(picture: Image, board: tuple[int, int], *, is_small_sought: bool = True) -> Corners | None:
    """(corners, 1, 2) x, y of a board's inner corners to a fraction of a pixel, or None.

    The board is sought in a reduced image first, of at most `SOUGHT_SIDE` px; `is_small_sought` says that
    one too small to be seen there is sought in the whole image as well, which takes 0.5 s and more.
    """
    import cv2

    brightness = gray(picture)
    factor = -(-max(brightness.shape) // SOUGHT_SIDE)
    reduced = _reduced(brightness, factor)
    is_whole, corners = cv2.findChessboardCorners(reduced, board, flags=BOARD_FLAGS | cv2.CALIB_CB_FAST_CHECK)
    if is_whole:
        corners = (corners + 0.5) * factor - 0.5
    elif is_small_sought:
        is_whole, corners = cv2.findChessboardCorners(brightness, board, flags=BOARD_FLAGS)
    if not is_whole:
        return None
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.01)
    return np.asarray(cv2.cornerSubPix(brightness, corners, (5, 5), (-1, -1), criteria), dtype=np.float32)


def _reduced(brightness: Image, factor: int) -> Image:
    import cv2

    if factor == 1:
        return brightness
    size = brightness.shape[1] // factor, brightness.shape[0] // factor
    return np.asarray(cv2.resize(brightness[: size[1] * factor, : size[0] * factor], size, interpolation=3))


def board_seen(pictures: Sequence[Image], board: tuple[int, int]) -> str:
    """End of a message: the board of another size that is whole in most of the pictures, or nothing.

    Sizes that differ by up to 3 corners each way are tried, the closest first.
    """
    import cv2

    small = [_reduced(image, -(-max(image.shape) // 640)) for image in map(gray, pictures)]
    sizes = [
        (columns, rows)
        for columns in range(max(3, board[0] - 3), board[0] + 4)
        for rows in range(max(3, board[1] - 3), board[1] + 4)
        if (columns, rows) not in (board, board[::-1])
    ]
    counts: list[tuple[int, int, tuple[int, int]]] = []
    for size in sorted(sizes, key=lambda size: abs(size[0] - board[0]) + abs(size[1] - board[1])):
        flags = BOARD_FLAGS | cv2.CALIB_CB_FAST_CHECK
        count = sum(cv2.findChessboardCorners(image, size, flags=flags)[0] for image in small)
        counts.append((count, size[0] * size[1], size))
        if 2 * count > len(small):
            break
    count, _, size = max(counts)
    if count < max(1, min(2, len(small))):
        return ""
    text = f"{size[0]}x{size[1]}"
    return (
        f"; a board of {text} is whole in {count} of {len(small)} looked at: is it "
        f"{setting('--board', text, str(size))}?"
    )


def _row_difference(cameras: Cameras, corners: Sequence[Sequence[Corners]]) -> float:
    import cv2

    left_rotation, right_rotation, left_projection, right_projection, *_ = cv2.stereoRectify(
        cameras.left,
        cameras.left_distortion,
        cameras.right,
        cameras.right_distortion,
        (cameras.width, cameras.height),
        cameras.rotation,
        cameras.translation.reshape(3, 1),
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=0,
    )
    eyes = (
        (cameras.left, cameras.left_distortion, left_rotation, left_projection),
        (cameras.right, cameras.right_distortion, right_rotation, right_projection),
    )
    rows = [
        np.concatenate([cv2.undistortPoints(p, m, d, R=r, P=q).reshape(-1, 2)[:, 1] for p in points])
        for points, (m, d, r, q) in zip(corners, eyes, strict=True)
    ]
    return float(np.abs(rows[0] - rows[1]).mean())
