"""Planes of dense optical flow: a vector for every pixel, by DIS or by orthogonal dynamic programming."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.planes import Frame, FramePair, Plane, Region, for_reading
from bayesnet_track.vision.motion_planes import interval_between
from bayesnet_track.vision.planes import gray

LEAST_SIDE = 16
"""Pictures with a shorter side, pixels, have no dense flow: they are too small for a pyramid."""

TILE = 64
"""Sides of the tiles of a frame, each of which orthogonal dynamic programming works on by itself, pixels."""
AROUND = 32
"""How far beyond its tile it looks, pixels: it follows no motion that is larger."""

PASSES = (
    (8, 17, None, 1.0),
    (8, 17, None, 1.0),
    (8, 9, None, 1.0),
    (4, 9, 2, 1.0),
    (2, 9, 3, 0.5),
    (2, 9, 2, 0.25),
    (1, 9, 2, 0.25),
)
"""Coarse to fine: pixels of the frame per pixel, width of strips in these, how many shifts are tried each way
(None: as far as is looked for), and their step. Strips as wide as the tile come first: they bear that
it has moved across them."""
COARSEST = PASSES[0][0]
STIFFNESS_GRAY = 0.5
"""Cost of a change of flow by one pixel between neighbours along a strip, gray levels."""


@dataclass(frozen=True)
class DisPlane:
    """OpenCV's DIS flow of the whole frames: (2, H, W, 2) float32, pixels; empty where there is none.

    First from the current frame to the previous one, then the other way. It depends on the whole frame, and
    is given whole: pixels far away decide on the coarse levels.
    """

    margin: ClassVar[None] = None
    inputs: ClassVar[tuple[Plane, ...]] = ()
    is_points: ClassVar[bool] = True

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """Both directions, with OpenCV's preset for the highest speed."""
        import cv2

        if frames.previous is None or not _has_flow(frames):
            return np.zeros((2, 0, 0, 2), dtype=np.float32)
        current, previous = gray(frames.current.image), gray(frames.previous.image)
        search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
        return np.stack([search.calc(current, previous, None), search.calc(previous, current, None)])


@dataclass(frozen=True)
class DenseFlowPlane:
    """Dense flow with its validity: (rows, columns, 3) float32 dx, dy, valid.

    (dx, dy) is the displacement of what a pixel shows since the previous frame, divided by the time between
    them, in pixels per nominal frame interval; `valid` is 1 or, with dx and dy, 0. A vector is valid as
    those of `FlowPlane` are: unique (both eigenvalues of the gradient matrix are large) and clear (there and
    back returns).

    Attributes:
        by: `dis`, dense inverse search; `odp`, orthogonal dynamic programming, on tiles of the frame.
        min_gradient_gray: least gradient around a pixel in its weakest direction, gray levels per pixel.
        reach_px: larger displacements, in x or in y, are not valid.
        agree_px: largest distance between a pixel and where going there and back takes it.
    """

    by: str = "dis"
    min_gradient_gray: float = 3.0
    reach_px: int = 24
    agree_px: float = 1.0
    is_points: ClassVar[bool] = False

    @property
    def margin(self) -> int:
        """A tile with its surroundings; DIS, from the whole frame, is an input."""
        return TILE + AROUND

    @property
    def inputs(self) -> tuple[Plane, ...]:
        """DIS of the whole frames, or the two frames alone."""
        return (DisPlane(),) if self.by == "dis" else ()

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """Vectors and their validity on `region`."""
        field: Array = np.zeros((region.y1 - region.y0, region.x1 - region.x0, 3), dtype=np.float32)
        if region.is_empty or frames.previous is None or not _has_flow(frames):
            return field
        scores = self._scores(frames.current, region)
        full = Region(0, 0, frames.current.width, frames.current.height)
        if self.by == "dis":
            self._check(inputs[0], full, region, scores, field)
        else:
            for tile in _tiles(region):
                part = Region(
                    max(tile.x0, region.x0),
                    max(tile.y0, region.y0),
                    min(tile.x1, region.x1),
                    min(tile.y1, region.y1),
                )
                window = Region(
                    part.x0 - region.x0, part.y0 - region.y0, part.x1 - region.x0, part.y1 - region.y0
                )
                crop = tile.grown(AROUND).within(frames.current)
                current, previous = (gray(crop.of(f.image)) for f in (frames.current, frames.previous))
                flows = np.stack(
                    [odp_flow(current, previous, self.reach_px), odp_flow(previous, current, self.reach_px)]
                )
                self._check(flows, crop, part, window.of(scores), window.of(field))
        field[..., :2] /= np.float32(interval_between(frames))
        return field

    def _check(self, flows: Array, covered: Region, region: Region, scores: Array, field: Array) -> None:
        from bayesnet_track.vision.kernels.dense_flow_kernels import there_and_back

        left, top = region.x0 - covered.x0, region.y0 - covered.y0
        part = np.empty(field.shape, np.float32)  # kernels get whole arrays: each is compiled once only
        there_and_back(
            flows[0],
            flows[1],
            left,
            top,
            np.ascontiguousarray(scores),
            float(self.reach_px),
            self.agree_px,
            part,
        )
        field[:] = part

    def _scores(self, frame: Frame, region: Region) -> Array:
        from bayesnet_track.vision.kernels import flow_kernels

        crop = region.grown(flow_kernels.RIM + 1).within(frame)
        image = gray(crop.of(frame.image))
        scores = np.zeros(image.shape)
        flow_kernels.corner_scores(for_reading(image), self.min_gradient_gray**2, scores)
        x, y = region.x0 - crop.x0, region.y0 - crop.y0
        return scores[y : y + region.y1 - region.y0, x : x + region.x1 - region.x0]


def odp_flow(source: Array, target: Array, reach_px: float) -> Array:
    """(h, w, 2) float32 dx, dy, px: the target at (x + dx, y + dy) looks like the source at (x, y).

    Both are (h, w) uint8, no side below LEAST_SIDE. Orthogonal dynamic programming (Quénot 1992; tracking
    chapter 3.2.1): horizontal and vertical strips in turn, coarse to fine.
    """
    import cv2

    from bayesnet_track.vision.kernels.dense_flow_kernels import odp_pass

    levels = {1: (source.astype(np.float32), target.astype(np.float32))}
    for scale in (2, 4, COARSEST):
        levels[scale] = tuple(cv2.pyrDown(image) for image in levels[scale // 2])
    flow: Array = np.zeros((2, *levels[COARSEST][0].shape), dtype=np.float32)
    previous_scale = COARSEST
    for scale, width, steps, step in PASSES:
        source_level, target_level = levels[scale]
        if scale != previous_scale:
            shape = (source_level.shape[1], source_level.shape[0])
            flow = np.stack([2 * cv2.resize(part, shape, interpolation=cv2.INTER_LINEAR) for part in flow])
            previous_scale = scale
        reach = steps or int(np.ceil(reach_px / scale)) + 1
        odp_pass(source_level, target_level, flow[0], flow[1], width, reach, step, STIFFNESS_GRAY)
        turned = np.ascontiguousarray(flow.transpose(0, 2, 1))
        source_level, target_level = (np.ascontiguousarray(image.T) for image in (source_level, target_level))
        odp_pass(source_level, target_level, turned[1], turned[0], width, reach, step, STIFFNESS_GRAY)
        flow = np.stack([cv2.blur(np.ascontiguousarray(part.T), (3, 3)) for part in turned])
    return np.ascontiguousarray(flow.transpose(1, 2, 0))


def _has_flow(frames: FramePair) -> bool:
    return interval_between(frames) > 0 and min(frames.current.image.shape[:2]) >= LEAST_SIDE


def _tiles(region: Region) -> list[Region]:
    """The tiles that the region touches."""
    return [
        Region(x, y, x + TILE, y + TILE)
        for y in range(region.y0 // TILE * TILE, region.y1, TILE)
        for x in range(region.x0 // TILE * TILE, region.x1, TILE)
    ]
