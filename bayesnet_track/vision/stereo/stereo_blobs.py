"""The stereo detector: smooth regions of depth in range and off the floor (thesis 3.2, Figure 3.5)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.depth import NoDepth
from bayesnet_track.observation.planes import Frame, Region
from bayesnet_track.vision.planes.stereo_planes import Correlation, Matcher, Range, all_points


@dataclass(frozen=True, eq=False)
class StereoBlobs:
    """Blobs of one frame, the best first.

    Attributes:
        boxes: (K, 4) centre boxes in px.
        scores: (K,) 0..1: share of the box that the blob's points fill.
        depths_m: (K,) mean depth.
        widths_m, heights_m: (K,) extents of the points in X and in Y.
    """

    boxes: Floats
    scores: Floats
    depths_m: Floats
    widths_m: Floats
    heights_m: Floats

    def __len__(self) -> int:
        return len(self.boxes)


@dataclass(frozen=True)
class StereoBlobSettings:
    """What counts as a blob.

    Attributes:
        matcher: how the two eyes are matched.
        range: depth, elevation, and the least size and smoothness of a region.
        min_height_m, max_height_m: of the blob.
        max_blobs: how many are reported.
    """

    matcher: Matcher = field(default_factory=Correlation)
    range: Range = field(default_factory=lambda: Range(min_pixels=400))
    min_height_m: float = 0.5
    max_height_m: float = 2.5
    max_blobs: int = 16


def detect_stereo_blobs(frame: Frame, settings: StereoBlobSettings | None = None) -> StereoBlobs:
    """The 4-connected smooth regions of depth that can be a target, scored by how well they fill their boxes.

    Raises:
        NoDepth: the frame has neither a second eye nor a point map.
    """
    from scipy.ndimage import find_objects

    from bayesnet_track.vision.kernels.disparity_kernels import label_regions

    if frame.depth is None:
        raise NoDepth
    wanted = settings or StereoBlobSettings()
    points = all_points(frame, wanted.matcher, wanted.range, Region(0, 0, frame.width, frame.height))
    points[~wanted.range.keeps(points)] = np.nan
    labels = np.empty(points.shape[:2], dtype=np.int32)
    depth = np.ascontiguousarray(points[..., 2])
    count = label_regions(depth, wanted.range.step_share, wanted.range.min_pixels, labels)
    rows = np.zeros((count, 8))
    for number, window in enumerate(find_objects(labels, count)):
        inside = labels[window] == number + 1
        low, high = (edge(points[window][inside], axis=0) for edge in (np.min, np.max))
        top, left, (tall, wide) = window[0].start, window[1].start, inside.shape
        box = (left + (wide - 1) / 2, top + (tall - 1) / 2, wide, tall)
        rows[number] = (*box, inside.mean(), depth[window][inside].mean(), *(high - low)[:2])
    height = rows[:, 7]
    rows = rows[(height >= wanted.min_height_m) & (height <= wanted.max_height_m)]
    rows = rows[np.argsort(-rows[:, 4], kind="stable")][: wanted.max_blobs]
    return StereoBlobs(rows[:, :4], rows[:, 4], rows[:, 5], rows[:, 6], rows[:, 7])
