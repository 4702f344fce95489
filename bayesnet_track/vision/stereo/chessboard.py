"""Calibrating two cameras from pictures of a chessboard, by OpenCV."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Image
from bayesnet_track.vision.planes.gray_plane import gray
from bayesnet_track.vision.stereo.stereo import CalibrationError, Cameras

Corners = NDArray[np.float32]

LEAST_VIEWS = 3


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


def calibrate(
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
        raise CalibrationError(
            f"{len(left)} left pictures and {len(right)} right ones: each needs its partner"
        )
    sizes = {picture.shape[1::-1] for picture in (*left, *right)}
    if len(sizes) > 1:
        found = ", ".join(f"{w}x{h}" for w, h in sorted(sizes))
        raise CalibrationError(f"pictures of several sizes ({found}); allowed: one size")
    seen = [(find_corners(a, board), find_corners(b, board)) for a, b in zip(left, right, strict=True)]
    used = tuple(n for n, pair in enumerate(seen) if pair[0] is not None and pair[1] is not None)
    if len(used) < LEAST_VIEWS:
        one, other = (sum(pair[k] is not None for pair in seen) for k in (0, 1))
        raise CalibrationError(
            f"a board of {board[0]}x{board[1]} inner corners is whole in {len(used)} of {len(seen)} pairs "
            f"({one} left pictures, {other} right ones); at least {LEAST_VIEWS} are needed; check --board, "
            "which counts the corners where four squares meet"
        )
    size = next(iter(sizes))
    world = np.zeros((board[0] * board[1], 3), dtype=np.float32)
    world[:, :2] = np.mgrid[: board[0], : board[1]].T.reshape(-1, 2) * square_m
    worlds = [world] * len(used)
    corners = [[spots for n in used if (spots := seen[n][k]) is not None] for k in (0, 1)]
    alone: list[Any] = [cv2.calibrateCamera(worlds, points, size, None, None)[:3] for points in corners]
    (left_rms, m1, d1), (right_rms, m2, d2) = alone
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
    return Calibrated(cameras, float(left_rms), float(right_rms), float(rms), epipolar, used)


def find_corners(picture: Image, board: tuple[int, int]) -> Corners | None:
    """(corners, 1, 2) x, y of a board's inner corners to a fraction of a pixel, or None."""
    import cv2

    brightness = gray(picture)
    found, corners = cv2.findChessboardCorners(
        brightness, board, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    )
    if not found:
        return None
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.01)
    return np.asarray(cv2.cornerSubPix(brightness, corners, (5, 5), (-1, -1), criteria), dtype=np.float32)


def _row_difference(cameras: Cameras, corners: Sequence[Sequence[Corners]]) -> float:
    import cv2

    one, other, one_p, other_p, *_ = cv2.stereoRectify(
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
        (cameras.left, cameras.left_distortion, one, one_p),
        (cameras.right, cameras.right_distortion, other, other_p),
    )
    rows = [
        np.concatenate([cv2.undistortPoints(p, m, d, R=r, P=q).reshape(-1, 2)[:, 1] for p in points])
        for points, (m, d, r, q) in zip(corners, eyes, strict=True)
    ]
    return float(np.abs(rows[0] - rows[1]).mean())
