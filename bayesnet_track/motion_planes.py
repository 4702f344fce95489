"""The flow plane: how corners moved since the previous frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.gray_plane import gray
from bayesnet_track.planes import Array, Frame, FramePair, Plane, Region

COARSEST = 4
"""Pixels of the frame per pixel of the coarsest of the three pyramid levels."""


@dataclass(frozen=True)
class FlowPlane:
    """Valid optical-flow vectors at corners: (points, 4) float64 x, y, dx, dy, in frame coordinates.

    (x, y) is a corner of the current frame in pixels; (dx, dy) its displacement since the previous frame
    divided by the time between them, in pixels per nominal frame interval. A vector is valid (thesis 3.5)
    when its point has a unique match (both eigenvalues of its gradient matrix are large) and a clear one
    (tracking it back from the match returns to it). No points without a previous frame, or when that one has
    another size or is not earlier.

    At most one corner per cell of a lattice anchored at the frame's first pixel, so that neither the points
    nor their values depend on the region asked for. Ordered by cell, rows first.

    Attributes:
        spacing_px: width of a cell of the lattice.
        min_gradient_gray: least gradient of a corner in its weakest direction, gray levels per pixel.
        half_window_px: the patch that is matched reaches this far around a corner, on each pyramid level.
        reach_px: a point that moves further than about this in x or y has no valid vector.
        agree_px: largest distance between a point and where tracking there and back takes it.
    """

    spacing_px: int = 12
    min_gradient_gray: float = 3.0
    half_window_px: int = 5
    reach_px: int = 24
    agree_px: float = 1.0

    @property
    def margin(self) -> int:
        """Reach, the coarsest window with its gradient, and what the pyramid mixes in from its edges."""
        return self.reach_px + COARSEST * (self.half_window_px + 6)

    @property
    def inputs(self) -> tuple[Plane, ...]:
        """Made from the two frames."""
        return ()

    @property
    def is_points(self) -> bool:
        """Points in frame coordinates."""
        return True

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """The valid vectors of the current frame whose points lie in `region`."""
        from bayesnet_track.numerics import flow_kernels

        current, previous = frames.current, frames.previous
        if previous is None or region.is_empty or previous.image.shape != current.image.shape:
            return np.empty((0, 4))
        interval = current.time - previous.time
        points = self._corners(current, region)
        if not (interval > 0) or len(points) == 0:
            return np.empty((0, 4))
        crop = _aligned(region.grown(self.margin), COARSEST).within(current)
        origin = np.array([crop.x0, crop.y0], dtype=np.int64)
        flows: Array = np.zeros((len(points), 2))
        valid = np.zeros(len(points), dtype=np.uint8)
        flow_kernels.track_points(
            *_pyramid(current, crop),
            *_pyramid(previous, crop),
            points,
            origin,
            2 * self.half_window_px + 1,
            float(self.reach_px),
            self.agree_px,
            flows,
            valid,
        )
        clear = valid == 1
        return np.concatenate([points[clear], -flows[clear] / interval], axis=1)

    def _corners(self, frame: Frame, region: Region) -> NDArray[np.int64]:
        """(points, 2) x, y of the corners in the region: the best of each cell that the region touches."""
        from bayesnet_track.numerics import corner_kernels

        cells = _aligned(region, self.spacing_px).within(frame)
        crop = cells.grown(corner_kernels.RIM + 1).within(frame)
        image = gray(crop.of(frame.image))
        scores = np.zeros(image.shape)
        corner_kernels.corner_scores(image, self.min_gradient_gray**2, scores)
        origin, low = np.array([crop.x0, crop.y0]), np.array([cells.x0, cells.y0])
        high = np.array([cells.x1, cells.y1])
        across, down = -(-(high - low) // self.spacing_px)
        found = np.zeros((across * down, 2), dtype=np.int64)
        found = found[: corner_kernels.lattice_corners(scores, origin, low, high, self.spacing_px, found)]
        x, y = found[:, 0], found[:, 1]
        return found[(x >= region.x0) & (x < region.x1) & (y >= region.y0) & (y < region.y1)]


def _aligned(region: Region, step: int) -> Region:
    """The region grown to multiples of `step`."""
    return Region(
        region.x0 // step * step,
        region.y0 // step * step,
        -(-region.x1 // step) * step,
        -(-region.y1 // step) * step,
    )


def _pyramid(frame: Frame, crop: Region) -> tuple[Array, Array, Array]:
    """Three levels, coarsest first, of the frame's brightness on a crop that starts at a multiple of 4."""
    import cv2

    fine = gray(crop.of(frame.image))
    middle = cv2.pyrDown(fine)
    return cv2.pyrDown(middle), middle, fine
