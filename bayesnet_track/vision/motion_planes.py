"""Planes of motion since the previous frame: the flow of corners, the motion of the camera, pans."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Array, Floats
from bayesnet_track.observation.planes import Frame, FramePair, Plane, Region, for_reading
from bayesnet_track.vision.planes import gray

Complexes = NDArray[np.complex128]

SAMPLES = 128
"""Pairs of points that are tried; with half of the points wrong, all are wrong once in 1e16 pictures."""
ROUNDS = 3
"""Fits to the points that agree, after the best pair."""


@dataclass(frozen=True, eq=False)
class Similarity:
    """The flow of a picture that moves, turns and zooms as a whole.

    Attributes:
        matrix: (2, 3); the flow at (x, y) is matrix @ (x, y, 1), px.
        agree: (P,) bool, the points that move so.
    """

    matrix: Floats
    agree: NDArray[np.bool_]


def similarity(points: Floats, tolerance: float) -> Similarity:
    """The similarity that most points (P, 4) x, y, dx, dy follow to within `tolerance` px.

    Pairs of points by a fixed sequence, each scored by the sum of min(r^2, tolerance^2) (MSAC); standing
    still is one of the candidates, and what fewer than two points give. Then least squares over those
    that agree.
    """
    place, flow = points[:, 0] + 1j * points[:, 1], points[:, 2] + 1j * points[:, 3]
    centre = place.mean() if len(place) else 0j  # near the points, so that nothing is lost to rounding
    place = place - centre
    turn, shift = _candidates(place, flow)
    errors = _squares(flow - turn[:, None] * place - shift[:, None])
    index = int(np.minimum(errors, tolerance**2).sum(axis=1).argmin())
    a, b = turn[index], shift[index]
    agree = errors[index] <= tolerance**2
    for _ in range(ROUNDS):
        if agree.sum() < 2:
            break
        z, f = place[agree], flow[agree]
        middle, mean = z.mean(), f.mean()
        spread = float(_squares(z - middle).sum())
        a = (np.conj(z - middle) * (f - mean)).sum() / spread if spread > 0 else 0j
        b = mean - a * middle
        agree = _squares(flow - a * place - b) <= tolerance**2
    b = b - a * centre
    return Similarity(np.array([[a.real, -a.imag, b.real], [a.imag, a.real, b.imag]]), agree)


def _squares(vectors: Complexes) -> Floats:
    return np.asarray(vectors.real**2 + vectors.imag**2)  # the absolute value takes several times as long


def _candidates(place: Complexes, flow: Complexes) -> tuple[Complexes, Complexes]:
    """Turn and shift of standing still, and of the similarity through each of the sampled pairs."""
    still = np.zeros(1, dtype=np.complex128)
    if len(place) < 2:
        return still, still
    first, second = np.random.default_rng(0).integers(0, len(place), (2, SAMPLES))
    offsets = place[second] - place[first]
    usable = offsets != 0
    first, second, offsets = first[usable], second[usable], offsets[usable]
    turn = (flow[second] - flow[first]) / offsets
    return np.concatenate([still, turn]), np.concatenate([still, flow[first] - turn * place[first]])


COARSEST = 4
"""Pixels of the frame per pixel of the coarsest of the three pyramid levels."""

LONGEST_PX = 160
"""Longest side of the picture in which the camera's motion is looked for."""
CAMERA_AGREE_PX = 1.0
"""A point of that picture moves with the camera when it is no further off."""
LEAST_POINTS = 8
"""Smallest number of points from which the camera's motion is estimated."""
LEAST_SHARE = 0.4
"""Share of the points that agree when the picture moves as a whole."""
CELLS = 8
"""The two pictures are compared in so many parts across and down."""
CLEAR_GRAY = 0.5
"""A part counts as moving or at rest if one of them explains it better by so many gray levels a pixel."""
LEAST_CELLS = 16
"""A picture that moves as a whole shows it in at least so many parts, three times as many as show rest."""
LEAST_PX = 0.5
"""Less than this, in pixels of the frame, is no motion of the camera."""


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
    inputs: ClassVar[tuple[Plane, ...]] = ()
    is_points: ClassVar[bool] = True

    @property
    def margin(self) -> int:
        """Reach, the coarsest window with its gradient, and what the pyramid mixes in from its edges."""
        return self.reach_px + COARSEST * (self.half_window_px + 6)

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """The valid vectors of the current frame whose points lie in `region`."""
        from bayesnet_track.vision.kernels import flow_kernels

        current, previous, interval = frames.current, frames.previous, interval_between(frames)
        if previous is None or not interval > 0 or region.is_empty:
            return np.empty((0, 4))
        points = self._corners(current, region)
        if len(points) == 0:
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
        from bayesnet_track.vision.kernels import flow_kernels

        cells = _aligned(region, self.spacing_px).within(frame)
        crop = cells.grown(flow_kernels.RIM + 1).within(frame)
        image = _brightness(frame, crop)
        scores = np.zeros(image.shape)
        flow_kernels.corner_scores(for_reading(image), self.min_gradient_gray**2, scores)
        origin, low = np.array([crop.x0, crop.y0]), np.array([cells.x0, cells.y0])
        high = np.array([cells.x1, cells.y1])
        columns, rows = -(-(high - low) // self.spacing_px)
        corners = np.zeros((columns * rows, 2), dtype=np.int64)
        corners = corners[: flow_kernels.lattice_corners(scores, origin, low, high, self.spacing_px, corners)]
        x, y = corners[:, 0], corners[:, 1]
        return corners[(x >= region.x0) & (x < region.x1) & (y >= region.y0) & (y < region.y1)]


@dataclass(frozen=True)
class CameraPlane:
    """Motion of the whole image since the previous frame: (2, 3) float64 M.

    The flow of the background at (x, y) is M @ (x, y, 1), pixels per nominal frame interval. Corners all over
    the picture, made smaller until no side exceeds LONGEST_PX, and the similarity that most of them follow.
    0 where that cannot be told: without a previous frame, with fewer than LEAST_POINTS that agree.

    Attributes:
        only_clear: 0 also unless the picture moves as a whole: LEAST_SHARE of the corners agree, they
            move by LEAST_PX (root mean square), and that explains most of what differs between the frames.
    """

    only_clear: bool = True
    margin: ClassVar[None] = None
    inputs: ClassVar[tuple[Plane, ...]] = ()
    is_points: ClassVar[bool] = True

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """The matrix, from the whole frames."""

        interval = interval_between(frames)
        if frames.previous is None or not interval > 0:
            return np.zeros((2, 3))
        current, scale = smaller_gray(frames.current)
        previous, _ = smaller_gray(frames.previous)
        size = np.array([current.width, current.height])
        vectors = CAMERA_FLOW.compute(FramePair(current, previous), (), Region(0, 0, *size.tolist()))
        displacements = vectors * np.array([1.0, 1.0, interval, interval])  # pixels of the smaller picture
        fit = similarity(displacements, CAMERA_AGREE_PX)
        agree = fit.agree
        if agree.sum() < LEAST_POINTS:
            return np.zeros((2, 3))
        if self.only_clear:
            way = scale * _flow_at(displacements[agree], fit.matrix)
            clear = agree.sum() >= LEAST_SHARE * agree.size and np.mean((way**2).sum(axis=1)) >= LEAST_PX**2
            if not clear or not _explains(fit.matrix, current.image, previous.image):
                return np.zeros((2, 3))
        return np.asarray(fit.matrix * np.array([1.0, 1.0, scale]) / interval)


def interval_between(frames: FramePair) -> float:
    """Time between the two frames, in nominal intervals; 0 where motion is unknown.

    It is unknown without a previous frame, or when that one has another size or is not earlier.
    """
    current, previous = frames.current, frames.previous
    if previous is None or previous.image.shape != current.image.shape or previous.time >= current.time:
        return 0.0
    return current.time - previous.time


def against_background(vectors: Array, camera: Array) -> Array:
    """The vectors (P, 4) x, y, dx, dy with the camera's motion (2, 3) there taken off dx and dy."""
    return np.concatenate([vectors[:, :2], vectors[:, 2:4] - _flow_at(vectors, camera)], axis=1)


def _flow_at(points: Array, camera: Array) -> Array:
    """(P, 2) the camera's motion at points (P, 2 or more) x, y; no BLAS, whose sums depend on threads."""
    x, y = points[:, 0], points[:, 1]
    return np.column_stack([row[0] * x + row[1] * y + row[2] for row in camera])


def _explains(matrix: Array, current: Array, previous: Array) -> bool:
    """True if the motion explains the gray image `current` better than rest, nearly wherever the two differ.

    Corners alone do not tell: on a plain ground that rests, all of them may be on things that move.
    """
    import cv2

    back = np.hstack([np.eye(2), np.zeros((2, 1))]) - matrix  # where a point of `current` was
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpAffine(previous, back, current.shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    differences = (cv2.absdiff(current, image).astype(np.float32) for image in (previous, warped))
    still, moving = (
        cv2.resize(difference, (CELLS, CELLS), interpolation=cv2.INTER_AREA) for difference in differences
    )
    better, worse = np.sum(still - moving > CLEAR_GRAY), np.sum(moving - still > CLEAR_GRAY)
    return bool(better >= LEAST_CELLS and better >= 3 * worse)


_SMALLER: WeakKeyDictionary[Frame, tuple[Frame, int]] = WeakKeyDictionary()


def smaller_gray(frame: Frame) -> tuple[Frame, int]:
    """The frame in gray, halved until no side exceeds LONGEST_PX, and how many of its pixels one is wide.

    Kept while the frame lives: it is compared with the frame before it, and then with the one after it.
    """
    smaller = _SMALLER.get(frame)
    if smaller is None:
        import cv2

        image, scale = gray(frame.image), 1
        while max(image.shape) > LONGEST_PX:
            image, scale = cv2.pyrDown(image), 2 * scale
        smaller = _SMALLER[frame] = Frame(frame.index, frame.time, image), scale
    return smaller


def _brightness(frame: Frame, region: Region) -> Array:
    """(rows, columns) uint8; a picture that is gray already may have one channel."""
    part = region.of(frame.image)
    return part if part.ndim == 2 else gray(part)


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

    fine = _brightness(frame, crop)
    middle = cv2.pyrDown(fine)
    return cv2.pyrDown(middle), middle, for_reading(fine)


CAMERA_FLOW = FlowPlane(spacing_px=12)
"""How the points are followed from which the camera's motion is told, in the smaller picture."""


def valid_vectors_of(flow: Array, pixels_of: Region | None) -> Array:
    """(P, 4) x, y, dx, dy of the valid vectors: all at points, or those of the pixels of a region."""
    if pixels_of is None:
        return flow
    from bayesnet_track.vision.kernels.dense_flow_kernels import valid_vectors

    vectors = np.empty((flow[..., 0].size, 4))
    return vectors[: valid_vectors(np.ascontiguousarray(flow), pixels_of.x0, pixels_of.y0, vectors)]


def means_in_boxes(points: Array, boxes: Array, pixels_of: Region | None) -> tuple[Array, Array]:
    """(N,) points x, y, u, v inside each centre box (N, 4), and (N, 2) their mean u and v.

    Points at all pixels of a region are summed by integral images.
    """
    counts, means = np.zeros(len(boxes)), np.zeros((len(boxes), 2))
    boxes = np.ascontiguousarray(boxes, dtype=np.float64)
    if pixels_of is None:
        from bayesnet_track.vision.kernels.flow_kernels import flow_in_boxes

        flow_in_boxes(for_reading(points), boxes, counts, means)
    else:
        from bayesnet_track.vision.kernels.dense_flow_kernels import dense_in_boxes

        r = pixels_of
        dense_in_boxes(points, r.x0, r.y0, r.x1 - r.x0, r.y1 - r.y0, boxes, counts, means)
    return counts, means


LEAST_RESPONSE = 0.1
"""Share of the correlation around its peak that a picture has at least which moved, and was not replaced."""


@dataclass(frozen=True)
class PanPlane:
    """Shift of most of the image since the previous frame: (2,) float64 x, y, px.

    The peak of the phase correlation of the whole frames in gray, halved until no side exceeds 160 px. It
    follows moves of up to half the picture, which points that are tracked do not, and no turn or zoom. 0
    without a previous frame, where the peak holds less than LEAST_RESPONSE, as between different scenes, and
    in a picture so long that its other side shrinks to one pixel.
    """

    margin: ClassVar[None] = None
    inputs: ClassVar[tuple[Plane, ...]] = ()
    is_points: ClassVar[bool] = True

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """The shift, from the whole frames."""
        import cv2

        if frames.previous is None or not interval_between(frames) > 0:
            return np.zeros(2)
        (current, scale), (previous, _) = smaller_gray(frames.current), smaller_gray(frames.previous)
        if min(current.width, current.height) < 2:
            return np.zeros(2)
        window = cv2.createHanningWindow((current.width, current.height), cv2.CV_32F)
        shift, clear = cv2.phaseCorrelate(
            previous.image.astype(np.float32), current.image.astype(np.float32), window
        )
        if clear < LEAST_RESPONSE:
            return np.zeros(2)
        return np.asarray(shift, dtype=np.float64) * scale
