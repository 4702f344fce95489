"""Cameras: where what stands on the ground appears in the image, and back.

World coordinates are right-handed, in metres; the ground is the plane z = 0 and z points up. Camera
coordinates are OpenCV's: x to the right, y down, z along the optical axis. Pixel coordinates are those of the
package: x to the right and y down, centres of pixels at integers.

A target on the ground is a row (x, y, w, h): its foot point, width and height in m. It is an upright
ellipsoid that touches the ground in (x, y, 0), w across in both directions and h high. A target in space is a
row (x, y, w, h, z): the same ellipsoid with its centre in (x, y, z). Its box is the smallest upright
rectangle around the ellipsoid's outline, (cx, cy, w, h) in px, centre first; it is not cut by the image's
border (`outlines`).

What cannot be seen is nan: points behind the camera or beyond the field in which the lens can be inverted
(`lenses.reach`), ellipsoids that are not entirely in front of it, pixels above the horizon.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np

from bayesnet_track.numerics import outlines
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.lenses import COUNTS, distort, reach, undistort

UNSEEN = (-1e4, -1e4, 1.0, 1.0)
"""The box of a hypothesis that the camera cannot see: no pixel of any frame. It is written nowhere."""


class CameraError(ValueError):
    """Numbers that are not those of a camera, or not enough of them."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera with a lens.

    Attributes:
        matrix: (3, 3) focal lengths, skew and principal point, px.
        distortion: (k,) coefficients in OpenCV's order, k = 0, 4, 5, 8 or 12; 4 of a fisheye lens.
        rotation: (3, 3) from world to camera coordinates.
        translation: (3,) the same, m: camera = rotation @ world + translation.
        size: width and height of the image, px, if known.
        fisheye: the distortion is that of `cv2.fisheye`.

    Raises:
        CameraError: a wrong shape, a number that is not finite, a rotation that is none.

    A camera 5 m above the ground that looks straight down, its image's right towards +x:

    >>> camera = Camera(np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]]), np.zeros(0),
    ...                 np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 5.0]), (640, 480))
    >>> camera.project(np.array([[1.0, 0.5, 0.0]])).tolist()
    [[480.0, 160.0]]
    >>> camera.ground_points(np.array([[480.0, 160.0]])).tolist()
    [[1.0, 0.5]]
    """

    matrix: Floats
    distortion: Floats
    rotation: Floats
    translation: Floats
    size: tuple[int, int] | None = None
    fisheye: bool = False

    def __post_init__(self) -> None:
        for name, shape in (("matrix", (3, 3)), ("rotation", (3, 3)), ("translation", (3,))):
            object.__setattr__(self, name, _finite(getattr(self, name), name, shape))
        distortion = np.asarray(self.distortion, dtype=np.float64).ravel()
        object.__setattr__(self, "distortion", _finite(distortion, "distortion", distortion.shape))
        if len(distortion) == 14 and not distortion[12:].any():
            object.__setattr__(self, "distortion", distortion[:12])
        _check_matrix(self.matrix)
        check_rotation(self.rotation)
        counts = (4,) if self.fisheye else COUNTS
        if len(self.distortion) not in counts:
            raise CameraError(
                f"{len(distortion)} distortion coefficients; allowed: {', '.join(map(str, counts))}"
                + ("" if self.fisheye else " in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4")
            )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, type(self)) and _same(self, other)

    def __hash__(self) -> int:
        return hash(self.matrix.tobytes())

    @property
    def centre(self) -> Floats:
        """(3,) where the camera stands in the world, m."""
        return np.asarray(-self.rotation.T @ self.translation)

    @cached_property
    def _reach(self) -> float:
        return reach(self.distortion, fisheye=self.fisheye)

    def _pixels(self, ideal: Floats) -> tuple[Floats, Floats]:
        """Pixels (..., 2) of normalised points (..., 2), and derivatives (..., 2, 2)."""
        points, derivatives = distort(ideal, self.distortion, fisheye=self.fisheye)
        is_far = np.hypot(ideal[..., 0], ideal[..., 1]) > self._reach
        pixels = points @ self.matrix[:2, :2].T + self.matrix[:2, 2]
        return np.where(is_far[..., None], np.nan, pixels), self.matrix[:2, :2] @ derivatives

    def rays(self, pixels: Floats) -> Floats:
        """Ideal points (N, 2), in camera coordinates at z = 1, of pixels (N, 2)."""
        distorted = (pixels - self.matrix[:2, 2]) @ np.linalg.inv(self.matrix[:2, :2]).T
        return undistort(distorted, self.distortion, fisheye=self.fisheye)

    def project(self, points: Floats) -> Floats:
        """Pixels (N, 2) of points (N, 3) in m, as `cv2.projectPoints`; nan where they cannot be seen."""
        return self._pixels(_divided(points @ self.rotation.T + self.translation))[0]

    @cached_property
    def _straight(self) -> tuple[Floats, Floats] | None:
        """Axes (3, 3) and origin (3,) in homogeneous pixels; None where the lens bends lines."""
        if self.fisheye or self.distortion.any():
            return None
        return self.matrix @ self.rotation, self.matrix @ self.translation

    def boxes(self, ground: Floats) -> Floats:
        """Boxes (N, 4) in px, centre first, of targets (N, 4) on the ground or (N, 5) in space, in m."""
        if self._straight is not None:
            return outlines.straight(*self._straight, ground)[0]
        return outlines.boxes(outlines.tangents(self._pixels, self.rotation, self.translation, ground))

    def jacobian(self, ground: Floats) -> Floats:
        """Derivatives (N, 4, D) of `boxes`: d box_i / d ground_j."""
        if self._straight is not None:
            return outlines.straight(*self._straight, ground)[1]
        return outlines.jacobian(
            outlines.tangents(self._pixels, self.rotation, self.translation, ground), ground
        )

    def sight(self, pixels: Floats) -> tuple[Floats, Floats]:
        """Origin (3,) and directions (N, 3), one metre of depth long, of what is seen in pixels (N, 2)."""
        return self.centre, np.column_stack([self.rays(pixels), np.ones(len(pixels))]) @ self.rotation

    def ground_points(self, pixels: Floats) -> Floats:
        """Points (N, 2) of the ground, m, that are seen in pixels (N, 2)."""
        ideal = self.rays(pixels)
        plane = np.column_stack([self.rotation[:, :2], self.translation])
        return _on_ground(plane, ideal)


@dataclass(frozen=True, eq=False)
class GroundHomography:
    """A camera of which only the mapping of the ground to the image is known.

    Foot points are exact in both directions. Heights are not in a homography: they come from the focal
    length, which the homography gives under the assumption of square pixels, the optical axis in the image's
    middle and no distortion. It needs `size` for that, and a view that is not straight down; `focal_px`
    replaces the guess.

    Attributes:
        matrix: (3, 3) from (x, y, 1) in m to homogeneous pixels, of either sign.
        size: width and height of the image, px, if known.
        focal_px: focal length, px, if known.

    Raises:
        CameraError: a wrong shape, or a matrix that cannot be inverted.

    >>> camera = GroundHomography(np.array([[100.0, 0, 320], [0, -40, 400], [0, 0.1, 1]]))
    >>> camera.project(np.array([[1.0, 2.0, 0.0]])).round(3).tolist()
    [[350.0, 266.667]]
    >>> try:
    ...     camera.boxes(np.array([[1.0, 2.0, 0.5, 1.8]]))
    ... except CameraError as error:
    ...     print(str(error).partition(";")[0])
    the heights of targets do not follow from a homography of the ground alone
    """

    matrix: Floats
    size: tuple[int, int] | None = None
    focal_px: float | None = None
    _signed: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        matrix = _finite(self.matrix, "homography", (3, 3))
        object.__setattr__(self, "matrix", matrix)
        if np.linalg.cond(matrix / np.maximum(np.abs(matrix).max(axis=0), 1e-300)) > 1e12:
            raise CameraError("the homography cannot be inverted: it maps the ground onto a line")
        object.__setattr__(self, "_signed", matrix * _sign(matrix, self.size))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, type(self)) and _same(self, other)

    def __hash__(self) -> int:
        return hash(self.matrix.tobytes())

    @cached_property
    def projection(self) -> Floats:
        """(3, 4) from (x, y, z, 1) in m to homogeneous pixels; CameraError where heights are unknown."""
        upwards = _upwards(self._signed, self.size, self.focal_px)
        return np.column_stack([self._signed[:, :2], upwards, self._signed[:, 2]])

    def project(self, points: Floats) -> Floats:
        """Pixels (N, 2) of points (N, 3) in m; those above the ground need `size`."""
        if not points[:, 2].any():
            return _divided(np.column_stack([points[:, :2], np.ones(len(points))]) @ self._signed.T)
        return _divided(np.column_stack([points, np.ones(len(points))]) @ self.projection.T)

    def boxes(self, ground: Floats) -> Floats:
        """Boxes (N, 4) in px, centre first, of targets (N, 4) or (N, 5) in m; they need `size`."""
        return outlines.straight(self.projection[:, :3], self.projection[:, 3], ground)[0]

    def jacobian(self, ground: Floats) -> Floats:
        """Derivatives (N, 4, D) of `boxes`: d box_i / d ground_j."""
        return outlines.straight(self.projection[:, :3], self.projection[:, 3], ground)[1]

    def sight(self, pixels: Floats) -> tuple[Floats, Floats]:
        """Origin (3,) and directions (N, 3) of what is seen in pixels (N, 2); they need `size`."""
        camera = camera_of_projection(self.projection, self.size)
        return camera.sight(pixels)

    def ground_points(self, pixels: Floats) -> Floats:
        """Points (N, 2) of the ground, m, that are seen in pixels (N, 2)."""
        return _on_ground(self._signed, pixels)


def camera_of_projection(projection: Floats, size: tuple[int, int] | None = None) -> Camera:
    """The camera of a (3, 4) projection matrix of either sign and any scale.

    Raises:
        CameraError: a wrong shape, or a matrix of no camera.
    """
    matrix = _finite(projection, "projection", (3, 4))
    block = matrix[:, :3]
    if abs(np.linalg.det(block)) < 1e-12 * max(float(np.abs(block).max()) ** 3, 1e-300):
        raise CameraError("the projection is not that of a camera: its first three columns are dependent")
    matrix = matrix * np.sign(np.linalg.det(block))
    orthogonal, triangle = np.linalg.qr(np.flipud(matrix[:, :3]).T)
    intrinsic, rotation = np.flipud(triangle.T)[:, ::-1], orthogonal.T[::-1]
    signs = np.sign(np.diag(intrinsic))
    intrinsic, rotation = intrinsic * signs, rotation * signs[:, None]
    translation = np.linalg.solve(intrinsic, matrix[:, 3])
    return Camera(intrinsic / intrinsic[2, 2], np.zeros(0), rotation, translation, size)


def check_rotation(rotation: Floats) -> None:
    """CameraError unless the (3, 3) matrix is a rotation to 1e-3; a reflection is named as one."""
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    determinant = float(np.linalg.det(rotation))
    if error > 1e-3:
        raise CameraError(
            f"the rotation is not orthonormal: R R' differs from the identity by {error:.3g}; "
            "allowed: a rotation matrix, up to 0.001"
        )
    if determinant < 0:
        raise CameraError(
            "the rotation is a reflection (its determinant is -1): one axis points the wrong way; "
            "x is to the right of the image, y down and z away from the camera"
        )


def _same(first: Any, second: Any) -> bool:
    """True if all fields of two dataclasses are equal, arrays by value."""
    return all(np.array_equal(getattr(first, f.name), getattr(second, f.name)) for f in fields(first))


def _finite(array: Floats, name: str, shape: tuple[int, ...]) -> Floats:
    """The array in float64; CameraError for another shape, or for a number that is not finite."""
    numbers = np.array(array, dtype=np.float64)
    if numbers.shape != shape:
        raise CameraError(f"{name} of shape {numbers.shape}; allowed: {shape}")
    if not np.isfinite(numbers).all():
        raise CameraError(f"{name} has a number that is not finite")
    return numbers


def _check_matrix(matrix: Floats) -> None:
    """CameraError unless the (3, 3) matrix is one of a camera."""
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0 or np.abs(matrix[2] - [0, 0, 1]).max() > 1e-9 or matrix[1, 0]:
        rows = "; ".join(" ".join(f"{number:g}" for number in row) for row in matrix)
        raise CameraError(
            f"the camera matrix is [{rows}]; allowed: [fx skew cx; 0 fy cy; 0 0 1] with fx, fy > 0"
        )


def _divided(homogeneous: Floats) -> Floats:
    """Points (N, 2) of homogeneous ones (N, 3); nan where the third number is not positive."""
    depth = np.where(homogeneous[:, 2:] > 0, homogeneous[:, 2:], np.nan)
    return np.asarray(homogeneous[:, :2] / depth)


def _on_ground(plane: Floats, ideal: Floats) -> Floats:
    """Points (N, 2), m, of normalised points (N, 2) by the (3, 3) mapping of the ground."""
    back = np.column_stack([ideal, np.ones(len(ideal))]) @ np.linalg.inv(plane).T
    return _divided(back)


def _sign(matrix: Floats, size: tuple[int, int] | None) -> float:
    """The sign of the homography with which visible ground has a positive depth.

    Visible is what lies in the middle of the image's lower border; without the size, the ground's origin is
    taken to be visible, or else a camera above a right-handed ground is assumed.
    """
    if size is not None:
        depth = np.linalg.solve(matrix, [(size[0] - 1) / 2, size[1] - 1.0, 1.0])[2]
        return 1.0 if depth > 0 else -1.0
    return 1.0 if matrix[2, 2] > 0 or (matrix[2, 2] == 0 and np.linalg.det(matrix) < 0) else -1.0


def _upwards(matrix: Floats, size: tuple[int, int] | None, focal_px: float | None) -> Floats:
    """(3,) image of one metre upwards, homogeneous, in the homography's scale."""
    if size is None:
        raise CameraError(
            "the heights of targets do not follow from a homography of the ground alone; "
            "give the image's size, or a camera matrix with rotation and translation"
        )
    middle = (np.array(size) - 1.0) / 2
    centred = matrix[:2] - middle[:, None] * matrix[2]
    focal = _focal(np.vstack([centred, matrix[2]])) if focal_px is None else focal_px
    intrinsic = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]])
    first, second, origin = np.linalg.solve(intrinsic, matrix).T
    scale = np.sqrt(np.linalg.norm(first) * np.linalg.norm(second))
    upwards = np.cross(first, second) / scale
    return np.asarray(intrinsic @ upwards * (1.0 if upwards @ origin < 0 else -1.0))


def _focal(centred: Floats) -> float:
    """Focal length, px, of a homography whose pixels are counted from the principal point.

    The images of the ground's axes are orthogonal and of equal length (Zhang, 2000): one complex equation
    a / f^2 + b = 0 for the focal length f, which does not depend on the axes' direction in the plane.
    """
    pairs = centred[:, 0] + 1j * centred[:, 1]
    flat, deep = pairs[0] ** 2 + pairs[1] ** 2, pairs[2] ** 2
    inverse = -(np.conj(flat) * deep).real / max(abs(flat) ** 2, 1e-300)
    if abs(flat) < 0.01 * (abs(pairs[0]) ** 2 + abs(pairs[1]) ** 2) or inverse <= 0:
        raise CameraError(
            "the focal length, and with it the heights of targets, does not follow from this homography: "
            "the camera looks almost straight down, or the pixels are not square; give focal_px, or a camera "
            "matrix with rotation and translation"
        )
    return float(1 / np.sqrt(inverse))
