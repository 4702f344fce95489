"""Where depth comes from: a rectified second eye, or points measured by another sensor.

World coordinates are those of the left camera: X to the right, Y down, Z forward, in metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.observation.planes import read_only
from bayesnet_track.observation.settings import setting, to_caller

Points = NDArray[np.float32]


@dataclass(frozen=True)
class StereoGeometry:
    """A rectified pair of pinhole cameras: rows correspond, and depth is a matter of one number.

    A point at depth Z has disparity d = x_left - x_right = focal_px * baseline_m / Z - offset_px.

    Attributes:
        focal_px: focal length of both cameras, px.
        baseline_m: distance of their centres, m.
        centre_x_px: column of the left principal point.
        centre_y_px: row of both principal points.
        offset_px: column of the right principal point less that of the left: minus the disparity of a point
            at infinity.

    >>> StereoGeometry(400.0, 0.2, 160.0, 120.0).disparity_of(4.0)
    20.0
    """

    focal_px: float
    baseline_m: float
    centre_x_px: float
    centre_y_px: float
    offset_px: float = 0.0

    def disparity_of(self, depth_m: float) -> float:
        """Disparity in px of a point at this depth."""
        return self.focal_px * self.baseline_m / depth_m - self.offset_px

    def points(self, disparity: NDArray[np.float32], x0: int = 0, y0: int = 0) -> Points:
        """(rows, columns, 3) X, Y, Z in m of (rows, columns) disparities in px; NaN where these are.

        The first pixel is (x0, y0) of the left image. Points behind the cameras are NaN.
        """
        shifted = disparity + np.float32(self.offset_px)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.float32(self.focal_px * self.baseline_m) / shifted
        depth = np.where(shifted > 0, depth, np.float32(np.nan))
        return self.points_of_depth(depth, x0, y0)

    def points_of_depth(self, depth_m: NDArray[np.float32], x0: int = 0, y0: int = 0) -> Points:
        """(rows, columns, 3) X, Y, Z in m of (rows, columns) depths in m."""
        rows, columns = depth_m.shape
        across = ((np.arange(x0, x0 + columns) - self.centre_x_px) / self.focal_px).astype(np.float32)
        down = ((np.arange(y0, y0 + rows) - self.centre_y_px) / self.focal_px).astype(np.float32)
        points = np.empty((rows, columns, 3), dtype=np.float32)
        points[..., 0] = depth_m * across
        points[..., 1] = depth_m * down[:, None]
        points[..., 2] = depth_m
        return points


@dataclass(frozen=True, eq=False)
class RightEye:
    """The right picture of a rectified pair; the frame's own picture is the left one. Read-only, as that.

    Attributes:
        image: (H, W, 3) uint8 BGR, of the left picture's size.
        geometry: the pair's.
    """

    image: NDArray[np.uint8]
    geometry: StereoGeometry

    def __post_init__(self) -> None:
        object.__setattr__(self, "image", read_only(self.image))


@dataclass(frozen=True, eq=False)
class PointMap:
    """What another sensor measured, one point per pixel of the frame. Read-only, as the frame.

    Attributes:
        points: (H, W, 3) float32 X, Y, Z in m; NaN where nothing was measured.
    """

    points: Points

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", read_only(self.points))


Depth = RightEye | PointMap


class NoDepth(ValueError):
    """A frame without a second eye or a point map, where depth is needed."""

    def __init__(self) -> None:
        super().__init__(f"needs depth, and the source is one eye; give {ways_of_depth()}")


def ways_of_depth() -> str:
    """A pair or depth images, as the caller gives them."""
    right, halves = setting("--right", "SOURCE"), setting("--stereo", "side_by_side", "True")
    calibration, depth = setting("--calibration", "FILE"), setting("--depth", "FOLDER")
    pair = f"a pair ({right} or {halves}, with {calibration})"
    source = f"{pair} or the depth of another sensor ({depth})"
    return to_caller(source, f"open_stereo_source {source}, or depth= with the frame")
