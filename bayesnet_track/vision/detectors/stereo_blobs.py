"""Detector: smooth regions of depth of a target's height, in range and off the floor (thesis 3.2)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.detector import (
    Detections,
    Detector,
    DetectorDeclaration,
    DetectorParameters,
    DetectorState,
)
from bayesnet_track.observation.planes import Frame, FramePair, NoDepth, Region
from bayesnet_track.vision.detectors.selection import select
from bayesnet_track.vision.stereo_planes import Correlation, Matcher, Range, SemiGlobal, all_points


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
    """Limits of a blob.

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
    parameters = settings or StereoBlobSettings()
    points = all_points(frame, parameters.matcher, parameters.range, Region(0, 0, frame.width, frame.height))
    points[~parameters.range.keeps(points)] = np.nan
    labels = np.empty(points.shape[:2], dtype=np.int32)
    depth = np.ascontiguousarray(points[..., 2])
    count = label_regions(depth, parameters.range.step_share, parameters.range.min_pixels, labels)
    rows = np.zeros((count, 8))
    for number, window in enumerate(find_objects(labels, count)):
        blob = labels[window] == number + 1
        low, high = (edge(points[window][blob], axis=0) for edge in (np.min, np.max))
        top, left, (tall, wide) = window[0].start, window[1].start, blob.shape
        box = (left + (wide - 1) / 2, top + (tall - 1) / 2, wide, tall)
        rows[number] = (*box, blob.mean(), depth[window][blob].mean(), *(high - low)[:2])
    height = rows[:, 7]
    rows = rows[(height >= parameters.min_height_m) & (height <= parameters.max_height_m)]
    rows = rows[np.argsort(-rows[:, 4], kind="stable")][: parameters.max_blobs]
    return StereoBlobs(rows[:, :4], rows[:, 4], rows[:, 5], rows[:, 6], rows[:, 7])


class StereoBlobsParameters(DetectorParameters):
    """Parameters of the stereo detector."""

    matcher: Literal["correlation", "semi_global"] = Field(
        default="correlation",
        description="How the eyes are matched: normalised correlation or OpenCV's semi-global matching.",
    )
    min_depth_m: float = Field(default=1.0, gt=0, description="Nearest depth of a target (m).")
    max_depth_m: float = Field(default=10.0, gt=0, description="Furthest depth of a target (m).")
    camera_height_m: float | None = Field(
        default=None,
        gt=0,
        description="Height of the camera above the floor (m); without it none is cut off.",
    )
    pitch_deg: float = Field(
        default=0.0, ge=-90, le=90, description="How far the camera looks down (degrees)."
    )
    min_elevation_m: float = Field(default=0.1, description="Points lower than this are floor (m).")
    max_elevation_m: float = Field(default=2.5, description="Points higher than this are no target (m).")
    min_height_m: float = Field(default=0.5, ge=0, description="Least height of a target (m).")
    max_height_m: float = Field(default=2.5, gt=0, description="Largest height of a target (m).")
    min_region_px: int = Field(default=400, ge=1, description="Least size of a region (pixels).")

    @model_validator(mode="after")
    def _ordered(self) -> StereoBlobsParameters:
        for name in ("depth_m", "elevation_m", "height_m"):
            low, high = getattr(self, f"min_{name}"), getattr(self, f"max_{name}")
            if not low < high:
                raise ValueError(f"min_{name} {low:g} is not below max_{name} {high:g}")
        return self


@dataclass(frozen=True)
class StereoBlobDetector:
    """Finds blobs of depth in each frame on its own; no state."""

    parameters: StereoBlobsParameters
    settings: StereoBlobSettings

    def start(self) -> DetectorState:
        """Nothing to remember."""
        return {}

    def detect(self, frames: FramePair, state: DetectorState) -> tuple[Detections, DetectorState]:
        """The blobs, scored by the share of the box that their points fill; raises NoDepth."""
        blobs = detect_stereo_blobs(frames.current, self.settings)
        boxes = np.asarray(blobs.boxes, dtype=np.float64)
        return select(boxes, blobs.scores, frames.current, self.parameters), state


def _make(parameters: StereoBlobsParameters) -> Detector:
    from bayesnet_track.vision.kernels import disparity_kernels  # noqa: F401  load before the first frame

    p = parameters
    reach = Range(
        p.min_depth_m,
        p.max_depth_m,
        p.camera_height_m,
        p.pitch_deg,
        p.min_elevation_m,
        p.max_elevation_m,
        p.min_region_px,
    )
    matcher = Correlation() if p.matcher == "correlation" else SemiGlobal()
    settings = StereoBlobSettings(matcher, reach, p.min_height_m, p.max_height_m, max(4 * p.max_count, 64))
    return StereoBlobDetector(parameters, settings)


DETECTOR = DetectorDeclaration(
    name="stereo_blobs",
    summary="Smooth regions of depth of a target's height.",
    parameters=StereoBlobsParameters,
    make=_make,
    needs_depth=True,
    cost_ms=105.0,
)
