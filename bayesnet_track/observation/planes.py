"""Frames and feature planes: what is computed once from a frame and read by many cues; depth; shared arrays.

World coordinates are those of the left camera: X to the right, Y down, Z forward, in metres.

A plane is a frozen, hashable value object, so that two cues that ask for the same plane with the same
parameters share one array. Planes form a graph through `inputs`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from threading import Lock
from types import MappingProxyType
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.settings import setting, to_caller

SharedArray = TypeVar("SharedArray")


def read_only(array: SharedArray) -> SharedArray:
    """A view that cannot be written into; the array itself stays as it is.

    >>> own = np.zeros(3)
    >>> read_only(own).flags.writeable, own.flags.writeable
    (False, True)
    """
    if not isinstance(array, np.ndarray) or not array.flags.writeable:
        return array
    view: Any = array.view()
    view.flags.writeable = False
    shared: SharedArray = view
    return shared


def for_reading(array: NDArray[Any]) -> NDArray[Any]:
    """The array in C order, read-only, so that a kernel that reads it has one compiled version only."""
    return read_only(np.ascontiguousarray(array))


def seal(reference: Mapping[str, Any]) -> dict[str, Any]:
    """The names and read-only views of the arrays."""
    return {name: read_only(array) for name, array in reference.items()}


def shown(reference: Mapping[str, NDArray[Any]]) -> Mapping[str, NDArray[Any]]:
    """A reference as a cue is given it: it can change neither the names nor the arrays.

    Arrays that are read-only are the same objects, by which workers know them again.
    """
    for array in reference.values():
        if isinstance(array, np.ndarray) and array.flags.writeable:
            return MappingProxyType(seal(reference))
    return MappingProxyType(reference if isinstance(reference, dict) else dict(reference))


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
        ray_x = ((np.arange(x0, x0 + columns) - self.centre_x_px) / self.focal_px).astype(np.float32)
        ray_y = ((np.arange(y0, y0 + rows) - self.centre_y_px) / self.focal_px).astype(np.float32)
        points = np.empty((rows, columns, 3), dtype=np.float32)
        points[..., 0] = depth_m * ray_x
        points[..., 1] = depth_m * ray_y[:, None]
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
    """Points that another sensor measured, one per pixel of the frame. Read-only, as the frame.

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


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of the source, which many read: it is a read-only view of the array that is given.

    Attributes:
        index: number of the frame, from 0 at the start of the source.
        time: the frame's time, in units of the source's nominal frame interval (so frame n of a gapless
            constant-rate source has time n).
        image: (H, W, 3) uint8, BGR.
        has_color: False when the source is gray and the three channels are copies.
        time_s: the same time in seconds; NaN where frames come without a clock.
        depth: the rectified right picture or the points that belong to the image; None for a source of one
            eye.
        stride: of the source's frames every so many-th is tracked.
        inputs: what is known of the frame beside its image: the graph's `inputs`, by name.
        cameras: of a step of several cameras: the frames that there are now, by name; None of one image.
        last_frames: of such a step: the last frame before it of each camera that had one.
        place: where the pixels are, of a frame that another process decodes; its image is black then.
    """

    index: int
    time: float
    image: NDArray[np.uint8]
    has_color: bool = True
    time_s: float = 0.0
    depth: Depth | None = None
    stride: int = 1
    inputs: Mapping[str, float] = field(default_factory=dict)
    cameras: Mapping[str, Frame] | None = None
    last_frames: Mapping[str, Frame] = field(default_factory=dict)
    place: Any = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "image", read_only(self.image))

    @property
    def ordinal(self) -> int:
        """Its number among the frames that are tracked: what is done in every n-th frame goes by it."""
        return self.index // self.stride

    def since(self, index: int) -> int:
        """Number of tracked frames since frame `index` of the source."""
        return (self.index - index) // self.stride

    def of(self, camera: str) -> Frame | None:
        """The frame of a camera: this one where there is only one; None where it has none at this time."""
        return self if self.cameras is None else self.cameras.get(camera)

    @property
    def is_readable(self) -> bool:
        """True: its image is there."""
        return True

    @property
    def height(self) -> int:
        """Rows of the image."""
        return int(self.image.shape[0])

    @property
    def width(self) -> int:
        """Columns of the image."""
        return int(self.image.shape[1])


@dataclass(frozen=True)
class Region:
    """Pixels with x0 <= column < x1 and y0 <= row < y1."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def is_empty(self) -> bool:
        """True when it holds no pixel."""
        return self.x1 <= self.x0 or self.y1 <= self.y0

    @property
    def area(self) -> int:
        """Number of pixels, 0 when it is empty."""
        return 0 if self.is_empty else (self.x1 - self.x0) * (self.y1 - self.y0)

    def grown(self, margin: int) -> Region:
        """The region with `margin` more pixels on each side."""
        return Region(self.x0 - margin, self.y0 - margin, self.x1 + margin, self.y1 + margin)

    def within(self, frame: Frame) -> Region:
        """The part of the region inside the frame (possibly empty)."""
        height, width = frame.image.shape[:2]
        if 0 <= self.x0 <= self.x1 <= width and 0 <= self.y0 <= self.y1 <= height:  # the usual case
            return self
        x0, x1 = (min(max(x, 0), width) for x in (self.x0, self.x1))
        y0, y1 = (min(max(y, 0), height) for y in (self.y0, self.y1))
        return Region(x0, y0, x1, y1)

    def union(self, region: Region) -> Region:
        """The smallest region that holds both."""
        if self.is_empty:
            return region
        if region.is_empty:
            return self
        return Region(
            min(self.x0, region.x0), min(self.y0, region.y0), max(self.x1, region.x1), max(self.y1, region.y1)
        )

    def contains(self, region: Region) -> bool:
        """True when every pixel of `region` is in this region."""
        return region.is_empty or (
            self.x0 <= region.x0 and self.y0 <= region.y0 and self.x1 >= region.x1 and self.y1 >= region.y1
        )

    def of(self, image: Array) -> Array:
        """The view of a whole-frame array (H, W, ...) that this region covers."""
        return image[self.y0 : self.y1, self.x0 : self.x1]


def region_of_boxes(boxes: NDArray[np.float64], grow: float = 0.0) -> Region:
    """The smallest region that holds all centre boxes (N, 4), each grown by `grow` of its size per side."""
    if len(boxes) == 1:  # plain numbers, several times faster
        x, y, w, h = boxes[0].tolist()
        dx, dy = w * (0.5 + grow), h * (0.5 + grow)
        return Region(_floor(x - dx + 0.5), _floor(y - dy + 0.5), _ceil(x + dx + 0.5), _ceil(y + dy + 0.5))
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.box_kernels import extent_of_boxes

    left, top, right, bottom = extent_of_boxes(boxes, 0.5 + grow)
    return Region(_floor(left + 0.5), _floor(top + 0.5), _ceil(right + 0.5), _ceil(bottom + 0.5))


def _floor(pixels: float) -> int:
    return math.floor(min(max(pixels, -(2.0**30)), 2.0**30))


def _ceil(pixels: float) -> int:
    return math.ceil(min(max(pixels, -(2.0**30)), 2.0**30))


BEFORE = "_before"
"""Behind the name of an input: its value in the frame before."""


@dataclass(frozen=True, eq=False)
class FramePair:
    """The current frame and the one before it (None on the first)."""

    current: Frame
    previous: Frame | None

    def of(self, camera: str) -> FramePair | None:
        """The pair of a camera; None where it has no frame at this time."""
        if self.current.cameras is None:
            return self
        current, previous = self.current.of(camera), self.current.last_frames.get(camera)
        if current is None:
            return None
        return FramePair(current, previous or (self.previous and self.previous.of(camera)))

    @property
    def names(self) -> dict[str, float]:
        """Values of the names of expressions that are the same of all states in the frame."""
        frame, previous = self.current, self.previous
        earlier = {} if previous is None else previous.inputs
        return {
            "t": frame.time,
            **frame.inputs,
            **{f"{name}{BEFORE}": earlier.get(name, value) for name, value in frame.inputs.items()},
            "frame_width": float(frame.width),
            "frame_height": float(frame.height),
            "dt": 1.0 if previous is None else frame.time - previous.time,
        }


class Plane(Protocol):
    """A feature computed from a frame. Implementations are frozen dataclasses (hashable)."""

    @property
    def margin(self) -> int | None:
        """Pixels around a pixel that its value depends on; None when it depends on the whole frame."""

    @property
    def inputs(self) -> tuple[Plane, ...]:
        """The planes that it is made from."""

    @property
    def is_points(self) -> bool:
        """True for points, or what else is in frame coordinates and never cut; False when image-like."""

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """The plane's values on `region` (already inside the frame).

        `inputs` are the input planes' values on the same region; they and the frames are read-only. An
        image-like plane gives (rows, columns, ...); a plane of points gives (points, ...) in frame
        coordinates.
        Must not depend on which region is asked: a pixel in two regions has the same value in both.
        """


@dataclass(frozen=True, eq=False)
class Planes:
    """The planes of one frame on one region: what a cue sees.

    Attributes:
        frame: the frame (its size; cues read `values`, not the image).
        region: the region of the frame that the image-like planes cover.
        values: plane -> read-only array; row 0, column 0 is the pixel (region.x0, region.y0).
    """

    frame: Frame
    region: Region
    values: Mapping[Plane, Array]

    def __getitem__(self, plane: Plane) -> Array:
        return self.values[plane]


MANY = 16
"""Regions of one frame on which a plane is computed before it is computed on the whole frame."""


class PlaneCache:
    """Computes the planes of one frame when they are first asked for, and keeps them for that frame.

    Once an image-like plane was computed on MANY regions, or on regions that add up to the frame, it is
    computed on the whole frame: then many targets cost no more than a few, and no region needs to be looked
    for among all others.

    Threads may share it. Each plane has a lock of its own, so that two planes are computed side by side and
    one that several ask for is computed once; planes form a graph without circles, and so do their locks.
    """

    def __init__(self, frames: FramePair) -> None:
        self.frames = frames
        self._of_cameras: dict[str, PlaneCache | None] = {}
        self._whole = Region(0, 0, frames.current.width, frames.current.height)
        self._held: dict[Plane, list[tuple[Region, Array]]] = {}
        self._spent: dict[Plane, int] = {}
        self._locks: dict[Plane, Lock] = {}

    def of_camera(self, camera: str) -> PlaneCache | None:
        """The planes of a camera's own frame, None where it has none; these for "" and where there is one."""
        if not camera or self.frames.current.cameras is None:
            return self
        if camera not in self._of_cameras:
            pair = self.frames.of(camera)
            self._of_cameras[camera] = None if pair is None else PlaneCache(pair)
        return self._of_cameras[camera]

    def planes(self, requested: Iterable[Plane], region: Region) -> Planes:
        """The planes `requested`, all on `region` cut to the frame."""
        frame = self.frames.current
        covered = region.within(frame)
        return Planes(frame, covered, {plane: self._on(plane, covered) for plane in requested})

    def _on(self, plane: Plane, region: Region) -> Array:
        with self._locks.setdefault(plane, Lock()):
            entries = self._held.setdefault(plane, [])
            for covered, values in entries:
                if covered.contains(region):
                    return values if plane.is_points else _cut(values, covered, region)
            computed = self._to_make(plane, region)
            inputs = tuple(self._on(p, computed) for p in plane.inputs)
            values = read_only(plane.compute(self.frames, inputs, computed))
            if computed is self._whole:
                entries.clear()
            entries.append((computed, values))
            return values if plane.is_points else _cut(values, computed, region)

    def _to_make(self, plane: Plane, region: Region) -> Region:
        """The region on which the plane is computed when it is asked for on `region`."""
        if plane.margin is None:
            return self._whole
        spent = self._spent.get(plane, 0) + region.area
        self._spent[plane] = spent
        many = spent > self._whole.area or len(self._held[plane]) >= MANY
        return self._whole if many and not plane.is_points else region


def _cut(values: Array, covered: Region, region: Region) -> Array:
    return values[
        region.y0 - covered.y0 : region.y1 - covered.y0, region.x0 - covered.x0 : region.x1 - covered.x0
    ]
