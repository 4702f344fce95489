"""Stereo planes: matchers that give disparity, filtered points, and the spread of features of depth."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Array, Floats, Ints
from bayesnet_track.observation.planes import (
    Frame,
    FramePair,
    NoDepth,
    Plane,
    PointMap,
    Points,
    Region,
    RightEye,
)
from bayesnet_track.vision.planes import gray

GRAY_STEPS = 8
"""Filtered pictures hold steps of 1 / GRAY_STEPS gray level."""
LOG_REACH = 4
"""The Laplacian of Gaussian reaches this many pixels."""

Disparity = NDArray[np.float32]


class Matcher(Protocol):
    """Finds corresponding points. Implementations are frozen dataclasses (hashable)."""

    def disparity(
        self, left: NDArray[np.uint8], right: NDArray[np.uint8], low_px: int, high_px: int, region: Region
    ) -> Disparity:
        """Disparity of each pixel of `region`, px, within low_px .. high_px; NaN where none is sure.

        `left` and `right` are whole rectified pictures, (H, W, 3) uint8 BGR of one size. A pixel's value
        does not depend on the region.
        """


@dataclass(frozen=True)
class Correlation:
    """Normalised correlation of windows after a Laplacian of Gaussian, with three filters (thesis 3.2).

    Attributes:
        window_px: side of the window, odd, 3 .. 21; the thesis has 7.
        sd_px: standard deviation of the Gaussian, 0.5 .. 1.5.
        min_texture_gray: least standard deviation of the filtered left window, gray levels.
        min_correlation: least correlation of the best match.
        min_difference: least relative difference of the two highest peaks ...
        separation_px: ... that are further apart than this.
    """

    window_px: int = 7
    sd_px: float = 1.2
    min_texture_gray: float = 1.5
    min_correlation: float = 0.6
    min_difference: float = 0.1
    separation_px: int = 2

    def disparity(
        self, left: NDArray[np.uint8], right: NDArray[np.uint8], low_px: int, high_px: int, region: Region
    ) -> Disparity:
        """Thesis eq. 3.5, to a fraction of a pixel by a parabola."""
        from bayesnet_track.vision.kernels.disparity_kernels import correlate

        disparities = np.empty(
            (max(region.y1 - region.y0, 0), max(region.x1 - region.x0, 0)), dtype=np.float32
        )
        if region.is_empty:
            return disparities
        half = self.window_px // 2
        height, width = left.shape[:2]
        rows = (max(region.y0 - half, 0), min(region.y1 + half, height))
        # One disparity more on either side is looked at, to see whether the best lies beyond the range.
        left_columns = (max(region.x0 - half, 0), min(region.x1 + half, width))
        right_columns = (
            max(left_columns[0] - high_px - 1, 0),
            min(max(left_columns[1] - low_px + 1, 0), width),
        )
        columns = (min(left_columns[0], right_columns[0]), max(left_columns[1], right_columns[1]))
        crop = Region(columns[0], rows[0], columns[1], rows[1])
        correlate(
            laplacian_of_gaussian(left, crop, self.sd_px),
            laplacian_of_gaussian(right, crop, self.sd_px),
            (region.y0 - crop.y0, region.y1 - crop.y0),
            (region.x0 - crop.x0, region.x1 - crop.x0),
            half,
            low_px,
            high_px,
            self.min_texture_gray * GRAY_STEPS,
            self.min_correlation,
            self.min_difference,
            self.separation_px,
            disparities,
        )
        return disparities


@dataclass(frozen=True)
class SemiGlobal:
    """OpenCV's semi-global block matching, on the whole picture (its paths cross all of it).

    Attributes:
        window_px: side of the matched block, odd.
        uniqueness_percent: by how much the best match must beat the second best.
        speckle_px: largest speckle that is taken out, pixels.
    """

    window_px: int = 5
    uniqueness_percent: int = 10
    speckle_px: int = 50

    def disparity(
        self, left: NDArray[np.uint8], right: NDArray[np.uint8], low_px: int, high_px: int, region: Region
    ) -> Disparity:
        """In steps of 1/16 px."""
        import cv2

        area, count = self.window_px**2, -(-(high_px - low_px + 1) // 16) * 16
        matcher = cv2.StereoSGBM.create(
            minDisparity=low_px,
            numDisparities=count,
            blockSize=self.window_px,
            P1=8 * area,
            P2=32 * area,
            disp12MaxDiff=1,
            uniquenessRatio=self.uniqueness_percent,
            speckleWindowSize=self.speckle_px,
            speckleRange=1,
        )
        # OpenCV leaves out as many columns on the left as it searches: they get a border to search in.
        border = max(low_px, 0) + count + self.window_px
        left_image, right_image = (
            cv2.copyMakeBorder(gray(eye), 0, 0, border, 0, cv2.BORDER_REPLICATE) for eye in (left, right)
        )
        steps = matcher.compute(left_image, right_image)[:, border:]
        disparities = steps.astype(np.float32) / np.float32(16)
        beyond = np.arange(disparities.shape[1]) - disparities < 0
        disparities[(steps < low_px * 16) | (steps > high_px * 16) | beyond] = np.nan
        return np.ascontiguousarray(region.of(disparities))


@dataclass(frozen=True)
class Range:
    """Limits of points that can belong to a target (the region filter of thesis 3.2).

    Attributes:
        min_depth_m, max_depth_m: nearest and furthest.
        camera_height_m: height of the camera above the floor; None when it is not known.
        pitch_deg: how far the camera looks down.
        min_elevation_m, max_elevation_m: lowest and highest above the floor (with a camera height).
        min_pixels: least size of a 4-connected smooth region.
        step_share: depths of neighbours in a smooth region differ by at most this share.
    """

    min_depth_m: float = 1.0
    max_depth_m: float = 10.0
    camera_height_m: float | None = None
    pitch_deg: float = 0.0
    min_elevation_m: float = 0.1
    max_elevation_m: float = 2.5
    min_pixels: int = 50
    step_share: float = 0.05

    def keeps(self, points: Points) -> NDArray[np.bool_]:
        """(rows, columns) True for points (rows, columns, 3) in range and off the floor."""
        depth = points[..., 2]
        in_range = (depth >= np.float32(self.min_depth_m)) & (depth <= np.float32(self.max_depth_m))
        if self.camera_height_m is not None:
            pitch = math.radians(self.pitch_deg)
            fall = np.float32(math.cos(pitch)) * points[..., 1] + np.float32(math.sin(pitch)) * depth
            elevation = np.float32(self.camera_height_m) - fall
            in_range &= (elevation >= self.min_elevation_m) & (elevation <= self.max_elevation_m)
        return in_range


@dataclass(frozen=True)
class PointsPlane:
    """Points that can belong to a target, (rows, columns, 3) float32 X, Y, Z in m; NaN elsewhere.

    Attributes:
        matcher: how the two eyes are matched; not used for a point map.
        range: which points are kept.
    """

    matcher: Matcher = field(default_factory=Correlation)
    range: Range = field(default_factory=Range)
    needs_depth: bool = True
    inputs: ClassVar[tuple[Plane, ...]] = ()
    is_points: ClassVar[bool] = False

    @property
    def margin(self) -> int:
        """The least size of a region: a region that is too small does not reach further than its size."""
        return self.range.min_pixels

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """The points on `region`.

        Raises:
            NoDepth: the frame has neither a second eye nor a point map.
        """
        from bayesnet_track.vision.kernels.disparity_kernels import label_regions

        frame = frames.current
        if frame.depth is None:
            raise NoDepth
        if region.is_empty:
            return np.empty((region.y1 - region.y0, region.x1 - region.x0, 3), dtype=np.float32)
        wide = region.grown(self.margin).within(frame)
        points = all_points(frame, self.matcher, self.range, wide)
        points[~self.range.keeps(points)] = np.nan
        labels = np.empty(points.shape[:2], dtype=np.int32)
        depth = np.ascontiguousarray(points[..., 2])
        label_regions(depth, self.range.step_share, self.range.min_pixels, labels)
        points[labels == 0] = np.nan
        inner = Region(region.x0 - wide.x0, region.y0 - wide.y0, region.x1 - wide.x0, region.y1 - wide.y0)
        return np.ascontiguousarray(inner.of(points))


def all_points(frame: Frame, matcher: Matcher, reach: Range, region: Region) -> Points:
    """(rows, columns, 3) points on `region` before the region filter; NaN where nothing was measured.

    Raises:
        NoDepth: the frame has neither a second eye nor a point map.
        ValueError: they are of another size than the picture.
    """
    match frame.depth:
        case PointMap(points=other) | RightEye(image=other) if other.shape[:2] != frame.image.shape[:2]:
            # the kernels would read beyond it
            raise ValueError(f"depth of shape {other.shape} does not fit a picture of {frame.image.shape}")
        case PointMap(points):
            return np.array(region.of(points), dtype=np.float32)
        case RightEye(image, geometry):
            # From infinity on, not from the furthest depth: what lies beyond it has to find its own match.
            low = math.floor(geometry.disparity_of(math.inf))
            high = min(math.ceil(geometry.disparity_of(reach.min_depth_m)), frame.width - 1)
            low = min(low, high)
            disparities = matcher.disparity(frame.image, image, low, high, region)
            return geometry.points(disparities, region.x0, region.y0)
    raise NoDepth


def laplacian_of_gaussian(image: NDArray[np.uint8], region: Region, sd_px: float) -> NDArray[np.int16]:
    """The brightness of a BGR image on `region` after a Laplacian of Gaussian, in 1/8 gray level.

    Scaled so that a line of contrast c on its own gives at most about c. The borders are mirrored. Kernels
    are whole numbers and every sum is exact, so that a pixel does not depend on the region.
    """
    import cv2

    from bayesnet_track.vision.kernels.disparity_kernels import LARGEST

    height, width = image.shape[:2]
    wide = region.grown(LOG_REACH)
    wide = Region(max(wide.x0, 0), max(wide.y0, 0), min(wide.x1, width), min(wide.y1, height))
    smooth, bend, scale = _log_kernels(sd_px)
    picture = gray(wide.of(image))
    sums = cv2.sepFilter2D(picture, cv2.CV_32F, bend, smooth, borderType=cv2.BORDER_REFLECT_101)
    sums += cv2.sepFilter2D(picture, cv2.CV_32F, smooth, bend, borderType=cv2.BORDER_REFLECT_101)
    inner = Region(region.x0 - wide.x0, region.y0 - wide.y0, region.x1 - wide.x0, region.y1 - wide.y0)
    steps = np.rint(inner.of(sums) * np.float32(scale))
    return np.ascontiguousarray(np.clip(steps, -LARGEST, LARGEST).astype(np.int16))


def _log_kernels(sd_px: float) -> tuple[Array, Array, float]:
    """Gaussian, its second derivative (both whole numbers), and what turns their sums into 1/8 gray level."""
    offsets = np.arange(-LOG_REACH, LOG_REACH + 1)
    gauss = np.exp(-0.5 * (offsets / sd_px) ** 2)
    smooth = np.rint(100.0 * gauss / gauss.sum())
    bend = gauss * (1.0 - (offsets / sd_px) ** 2)
    bend = np.rint(80.0 * bend / np.abs(bend).sum())
    bend[LOG_REACH] -= bend.sum()  # no answer to a constant
    kernel = np.outer(smooth, bend) + np.outer(bend, smooth)
    scale = GRAY_STEPS / kernel[kernel > 0].sum()
    return smooth.astype(np.float32), bend.astype(np.float32), float(scale)


@dataclass(frozen=True, eq=False)
class FeatureSpread:
    """Standard deviations of K features.

    Attributes:
        sd: (K,) estimated, shrunk toward the default.
        raw: (K,) of the examples alone.
        freedom: how many independent deviations the examples hold: their number less that of their groups.
    """

    sd: Floats
    raw: Floats
    freedom: int


def estimate_spread(features: Floats, groups: Ints, default: Floats, prior: float) -> FeatureSpread:
    """Standard deviations of features within groups, shrunk toward a default.

    ``sd^2 = (prior default^2 + S) / (prior + n - g)``, S the sum of the squared deviations of n examples from
    the means of their g groups: the mean of the variances that S alone and the default give, as the scaled
    inverse chi-square prior for the variances of a Gaussian weighs them. It makes the diagonal covariance of
    thesis eq. 3.6, "estimated in previous examples".

    Args:
        features: (n, K) of the examples.
        groups: (n,) whole numbers; examples of one number have a mean of their own.
        default: (K,) standard deviations.
        prior: how many independent deviations the default counts for; 0 is without it.

    Raises:
        ValueError: no group has two examples, so that nothing can vary.

    >>> examples, one = np.array([[1.0], [3.0]]), np.zeros(2, np.int64)
    >>> float(estimate_spread(examples, one, np.array([0.5]), 0.0).sd[0] ** 2)  # doctest: +ELLIPSIS
    2.0...
    >>> float(estimate_spread(examples, one, np.array([0.5]), 3.0).sd[0] ** 2)
    0.6875
    """
    _, group = np.unique(groups, return_inverse=True)
    size = np.bincount(group)
    freedom = len(features) - len(size)
    if freedom < 1:
        raise ValueError(
            f"{len(features)} examples in {len(size)} groups: one group of two at least is needed"
        )
    sums = np.zeros((len(size), features.shape[1]))
    np.add.at(sums, group, features)
    squares = ((features - (sums / size[:, None])[group]) ** 2).sum(axis=0)
    sd = np.sqrt((prior * default**2 + squares) / (prior + freedom))
    return FeatureSpread(sd, np.sqrt(squares / freedom), freedom)
