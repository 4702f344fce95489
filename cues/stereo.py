"""Stereo cue: depth, height, shape and number of points of the depth blob inside each hypothesis.

Thesis 3.2, eq. 3.6, with a diagonal covariance; of its two readings of the first feature (depth in the
formula, variance of depth in the text) either or both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from bayesnet_track.numerics.log_weights import SHARPER, factor_of, relax, sharpen
from bayesnet_track.observation.cue import (
    CueDeclaration,
    Floats,
    Hypotheses,
    Reference,
    SizedCueParameters,
    blend_sizes,
    floored,
    log_size_penalty,
)
from bayesnet_track.observation.planes import for_reading
from bayesnet_track.vision.stereo_planes import Correlation, Matcher, PointsPlane, Range, SemiGlobal

if TYPE_CHECKING:
    from bayesnet_track.observation.planes import Plane, Planes

STEP = 0.7
"""Factor of a local action on the standard deviations."""

HAIR_M = 0.001
"""Added to width and height before their ratio is taken, so that a blob of one point has one."""


class StereoParameters(SizedCueParameters):
    """Parameters of the stereo cue."""

    depth: Literal["depth", "spread", "both"] = Field(
        default="depth",
        description="First feature: the blob's mean `depth`, the `spread` of all depths in the box, or both.",
    )
    sd_depth_m: float = Field(default=0.3, gt=0, description="Standard deviation of the mean depth (m).")
    sd_spread_m: float = Field(
        default=0.3, gt=0, description="Standard deviation of the spread of depth in the box (m)."
    )
    sd_height_m: float = Field(default=0.25, gt=0, description="Standard deviation of the blob's height (m).")
    sd_log_shape: float = Field(
        default=0.3, gt=0, description="Standard deviation of the log of the blob's width over its height."
    )
    sd_valid: float = Field(
        default=0.15,
        gt=0,
        description="Standard deviation of the number of the blob's points (share of the box).",
    )
    min_valid: float = Field(
        default=0.1, gt=0, le=1, description="A box with fewer points holds no blob (share of the box)."
    )
    cells: int = Field(default=12, ge=4, le=64, description="Samples along each side of a box (count).")
    layer: float = Field(
        default=0.12,
        ge=0.01,
        le=1,
        description="Depth of the layer that makes a blob, as a share of its distance.",
    )
    matcher: Literal["correlation", "semi_global"] = Field(
        default="correlation",
        description="How the two images are matched: by normalised correlation or by semi-global matching.",
    )
    window_px: int = Field(default=7, ge=3, le=21, description="Side of the matched window, odd (px).")
    min_texture_gray: float = Field(
        default=1.5,
        ge=0,
        description="`correlation`: smallest sd of the filtered window (gray levels of 255); removes flat "
        "areas.",
    )
    min_correlation: float = Field(
        default=0.6,
        ge=0,
        le=1,
        description="`correlation`: smallest correlation of a match; removes occlusions.",
    )
    min_difference: float = Field(
        default=0.1,
        ge=0,
        le=1,
        description="`correlation`: smallest relative difference of the two highest peaks; removes "
        "repetitions.",
    )
    separation_px: int = Field(
        default=2, ge=0, le=100, description="`correlation`: peaks nearer than this are one (px)."
    )
    min_depth_m: float = Field(default=1.0, gt=0, description="Nearest depth of a target (m).")
    max_depth_m: float = Field(default=10.0, gt=0, description="Furthest depth of a target (m).")
    camera_height_m: float | None = Field(
        default=None,
        gt=0,
        description="Height of the camera above the floor (m); without it the floor is not removed.",
    )
    pitch_deg: float = Field(
        default=0.0, ge=-90, le=90, description="How far the camera looks down (degrees)."
    )
    min_elevation_m: float = Field(default=0.1, description="Points lower than this are floor (m).")
    max_elevation_m: float = Field(default=2.5, description="Points higher than this are no target (m).")
    min_region_px: int = Field(
        default=40, ge=1, le=400, description="Smallest size of a connected smooth region (pixels)."
    )

    @field_validator("window_px")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError(f"a window has a middle pixel: {value - 1} or {value + 1}, not {value}")
        return value

    @model_validator(mode="after")
    def _ordered(self) -> StereoParameters:
        for low, high in (("min_depth_m", "max_depth_m"), ("min_elevation_m", "max_elevation_m")):
            if not getattr(self, low) < getattr(self, high):
                raise ValueError(f"{low} {getattr(self, low):g} is not below {high} {getattr(self, high):g}")
        return self


@dataclass(frozen=True)
class StereoCue:
    """Compares depth blobs.

    Reference: `features` (5,) depth m, spread m, height m, log of width over height, share of valid points;
    `size` (2,) width and height in px; `known` () 1, or 0 when no blob was seen; `sharper` () factor on the
    standard deviations.
    """

    parameters: StereoParameters
    points: PointsPlane
    context: ClassVar[float] = 0.0

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The points of the frame."""
        return (self.points,)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The features of the centre box (4,); unknown when it holds no blob."""
        features, has_blob = self._features(planes, np.asarray(box, dtype=np.float64)[None])
        return {
            "features": features[0],
            "size": np.array(box[2:], dtype=np.float64),
            "known": np.array(float(has_blob[0])),
            SHARPER: np.array(1.0),
        }

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Linear (eq. 2.15), the size in its logarithm; an unknown one gives way to a known one whole."""
        if not new["known"]:
            return old
        if not old["known"]:
            return {**new, **relax(old, new, rate)}
        return {
            "features": (1.0 - rate) * old["features"] + rate * new["features"],
            "size": blend_sizes(old, new, rate),
            "known": old["known"],
            **relax(old, new, rate),
        }

    def adapt(self, reference: Reference, attempt: int) -> Reference | None:
        """Smaller standard deviations; None at once when the reference is unknown."""
        return sharpen(reference, attempt, STEP) if reference["known"] else None

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """(N,) log of the Gaussian of eq. 3.6 over its largest value, and the size penalty, over the floor.

        A box without a blob is at the floor. All 0 (no evidence) when the reference is unknown.
        """
        if not reference["known"]:
            return np.zeros(len(hypotheses))
        settings, boxes = self.parameters, hypotheses.boxes
        features, has_blob = self._features(planes, boxes)
        deviations = (features - reference["features"]) / (self._sd() * factor_of(reference))
        log = np.where(has_blob, -0.5 * (deviations**2).sum(axis=1), -np.inf)
        size = log_size_penalty(boxes, reference["size"], settings.sd_log_area, settings.sd_log_aspect)
        return floored(log + size, settings.floor)

    def _sd(self) -> Floats:
        """(5,) standard deviations, infinite for a feature that is not used."""
        p = self.parameters
        return np.array(
            [
                np.inf if p.depth == "spread" else p.sd_depth_m,
                np.inf if p.depth == "depth" else p.sd_spread_m,
                p.sd_height_m,
                p.sd_log_shape,
                p.sd_valid,
            ]
        )

    def _features(self, planes: Planes, boxes: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """(N, 5) features of each box, and whether it holds a blob."""
        from bayesnet_track.vision.kernels import blob_kernels as k

        region, raw = planes.region, np.zeros((len(boxes), k.FEATURES))
        points, cells = planes[self.points], self.parameters.cells
        if not region.is_empty:
            origin = np.array([region.x0, region.y0], dtype=np.int64)
            boxes = np.ascontiguousarray(boxes, dtype=np.float64)
            third = float(np.log1p(self.parameters.layer)) / 3.0
            k.blob_features(for_reading(points), boxes, origin, cells, third, raw)
        shape = np.log((raw[:, k.WIDTH] + HAIR_M) / (raw[:, k.HEIGHT] + HAIR_M))
        columns = (raw[:, k.DEPTH], raw[:, k.SPREAD], raw[:, k.HEIGHT], shape, raw[:, k.SHARE])
        return np.column_stack(columns), raw[:, k.SHARE] >= self.parameters.min_valid


def _matcher(p: StereoParameters) -> Matcher:
    if p.matcher == "semi_global":
        return SemiGlobal(window_px=p.window_px)
    return Correlation(
        window_px=p.window_px,
        min_texture_gray=p.min_texture_gray,
        min_correlation=p.min_correlation,
        min_difference=p.min_difference,
        separation_px=p.separation_px,
    )


def _make(parameters: StereoParameters) -> StereoCue:
    import cv2  # noqa: F401  (loaded when tracking starts, not at the first frame)

    from bayesnet_track.vision.kernels import (
        disparity_kernels,  # noqa: F401
    )

    p = parameters
    reach: dict[str, Any] = {
        name: getattr(p, name)
        for name in (
            "min_depth_m",
            "max_depth_m",
            "camera_height_m",
            "pitch_deg",
            "min_elevation_m",
            "max_elevation_m",
        )
    }
    return StereoCue(p, PointsPlane(_matcher(p), Range(**reach, min_pixels=p.min_region_px)))


CUE = CueDeclaration(
    name="stereo",
    summary="Depth, height, shape and points of the depth blob inside the box.",
    parameters=StereoParameters,
    make=_make,
    cost_ms=25.0,
    is_appearance=False,
    rate_max=0.3,
    adapts=True,
)
