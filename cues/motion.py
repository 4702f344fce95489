"""Motion cue: the optical flow inside a box against that of the target.

Thesis 3.5, eq. 3.9, corrected (both terms of the exponent are negative, each with its own deviation). The
thesis compares the mean flow of the box. Where two things overlap the mean is the flow of neither; then it
is better to compare each vector, so that a box scores the share of it that moves as the target does.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from bayesnet_track.numerics.distributions import follow_spread, spread_of, start_spread
from bayesnet_track.numerics.log_weights import SHARPER, factor_of, relax, sharpen
from bayesnet_track.observation.cue import (
    CueDeclaration,
    Floats,
    Hypotheses,
    Reference,
    SizedCueParameters,
    blend_arrays,
    floored,
    log_size_penalty,
)
from bayesnet_track.vision import motion_planes
from bayesnet_track.vision.dense_flow_planes import DenseFlowPlane

if TYPE_CHECKING:
    from bayesnet_track.observation.planes import Plane, Planes

BLOCK = 2**18
"""Pairs of a box and a vector that are compared in one go."""

STEP = 0.7
"""Factor of a local action on the sds of flow: all three leave 0.7 px of the default, above its error."""


class MotionParameters(SizedCueParameters):
    """Parameters of the motion cue."""

    flow: Literal["sparse", "dense", "odp"] = Field(
        default="sparse",
        description="How flow is found: at corners by Lucas and Kanade's method, or for every pixel by dense "
        "inverse search or by orthogonal dynamic programming (expensive: for small boxes).",
    )
    camera: Literal["ignore", "auto", "compensate"] = Field(
        default="ignore",
        description="Whether the camera's motion is subtracted from all flow: never, if the image clearly "
        "moves as a whole, or whenever it can be estimated.",
    )
    compare: Literal["mean", "each"] = Field(
        default="mean",
        description="What is compared with the target's flow: the box's mean flow, or each of its vectors.",
    )
    against: Literal["reference", "velocity"] = Field(
        default="reference",
        description="What it is compared with: the flow that was learned, or each hypothesis' own velocity "
        "(`vx`, `vy` of the state), which turns with it.",
    )
    sd_x_px: float = Field(
        default=2.0, gt=0, description="Standard deviation of that flow in x, pixels per frame interval."
    )
    sd_y_px: float = Field(
        default=2.0, gt=0, description="Standard deviation of that flow in y, pixels per frame interval."
    )
    sd_memory_frames: float | None = Field(
        default=None,
        ge=2,
        description="The standard deviations follow how much the target's own flow changes, over about so "
        "many frames; they stay as given when absent. For `compare: mean` against the `reference`.",
    )
    spacing_px: int = Field(
        default=12,
        ge=4,
        le=128,
        description="`sparse`: width of the lattice cells that hold one corner each, pixels.",
    )
    min_gradient_gray: float = Field(
        default=3.0,
        gt=0,
        description="Smallest gradient of a point in its weakest direction, gray levels of 255 per pixel.",
    )
    half_window_px: int = Field(
        default=5,
        ge=2,
        le=15,
        description="`sparse`: the matched patch reaches this far around a corner, pixels of each level.",
    )
    reach_px: int = Field(
        default=24, ge=4, le=128, description="Largest displacement that can be found, pixels in x and in y."
    )
    agree_px: float = Field(
        default=1.0,
        gt=0,
        description="Largest error of tracking a point forward and back again, pixels.",
    )
    coherent_px: float | None = Field(
        default=None,
        gt=0,
        description="Learn the flow only where the vectors in the box agree: largest root mean square "
        "distance from their mean, pixels per frame interval; always when absent.",
    )
    sharpness: float = Field(
        default=1.0, gt=0, description="Factor on the log-likelihood before the floor (no unit)."
    )

    @model_validator(mode="after")
    def _one_flow_is_followed(self) -> Self:
        if self.sd_memory_frames and (self.compare, self.against) != ("mean", "reference"):
            raise ValueError("sd_memory_frames needs compare: mean and against: reference")
        return self


@dataclass(frozen=True)
class MotionCue:
    """Compares mean flow.

    Reference: `flow` (2,) mean of the valid vectors, pixels per frame interval; `valid` () their number;
    `size` (2,) width and height in pixels; `known` () 1, or 0 when no valid vector was seen; `sharper` ()
    factor on the standard deviations of flow; `spread` (2,) another on each, where they follow the target.
    """

    parameters: MotionParameters
    flow: motion_planes.FlowPlane | DenseFlowPlane
    camera: motion_planes.CameraPlane | None
    context: ClassVar[float] = 0.0

    @cached_property
    def needs(self) -> tuple[Plane, ...]:
        """The flow plane, and that of the camera's motion."""
        return (self.flow,) if self.camera is None else (self.flow, self.camera)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The mean flow inside the centre box (4,); unknown without a valid vector, or when they disagree.

        Where two things overlap, their vectors disagree, and the mean is the flow of neither.
        """
        vectors = self.vectors(planes)
        counts, means = self._inside(vectors, np.asarray(box, dtype=np.float64)[None], planes)
        is_known = counts[0] > 0 and self._agrees(vectors, box, means[0])
        return {
            "flow": means[0],
            "valid": np.array(counts[0]),
            "size": np.array(box[2:], dtype=np.float64),
            "known": np.array(float(is_known)),
            SHARPER: np.array(1.0),
            **start_spread(2, self.parameters.sd_memory_frames),
        }

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Linear (eq. 2.15); an unknown reference gives way to a known one whole."""
        if not new["known"]:
            return old
        p, both_known = self.parameters, rate and old["known"]
        changes = list((new["flow"] - old["flow"])[:, None]) if both_known else [np.empty(0)] * 2
        spread = follow_spread(old, changes, (p.sd_x_px, p.sd_y_px), p.sd_memory_frames)
        blended = blend_arrays(old, new, rate) if old["known"] else new
        return {**blended, **relax(old, new, rate), **spread}

    def adapt(self, reference: Reference, attempt: int) -> Reference | None:
        """Flows compared more strictly; None at once when the target's is unknown."""
        return sharpen(reference, attempt, STEP) if reference["known"] else None

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """(N,) log of min(n / n_ref, 1) exp(-(dx^2 / 2 sd_x^2 + dy^2 / 2 sd_y^2)), thesis eq. 3.9, corrected.

        n counts the valid vectors inside the box: it multiplies the likelihood, so that a box without flow
        does not match. dx, dy is the mean flow less the target's; comparing `each`, the exponential is taken
        of every vector and averaged over the box. All 0 (no evidence) when the reference is unknown.

        Against `velocity`, it is the mean flow less the hypothesis' own velocity; no evidence about boxes
        that have none.
        """
        settings = self.parameters
        velocity = _velocities(hypotheses) if settings.against == "velocity" else reference["flow"]
        if not reference["known"] or velocity is None:
            return np.zeros(len(hypotheses))
        vectors = self.vectors(planes)
        with np.errstate(divide="ignore"):
            if settings.compare == "each" and settings.against == "velocity":
                counts, log = self._log_share(vectors, hypotheses.boxes, velocity, reference)
            elif settings.compare == "each":
                agreement = np.exp(self._log_agreement(vectors[:, 2:4], velocity, reference))
                points = np.column_stack([vectors[:, :2], agreement, agreement])
                counts, means = self._inside(points, hypotheses.boxes, planes)
                log = np.log(means[:, 0])
            else:
                counts, means = self._inside(vectors, hypotheses.boxes, planes)
                log = self._log_agreement(means, velocity, reference)
            log = np.log(np.minimum(counts / reference["valid"], 1.0)) + log
        penalty = log_size_penalty(
            hypotheses.boxes, reference["size"], settings.sd_log_area, settings.sd_log_aspect
        )
        return floored(settings.sharpness * log + penalty, settings.floor)

    def residuals(self, planes: Planes, box: Floats, reference: Reference) -> dict[str, Floats]:
        """Differences of eq. 3.9: flow of the centre box (4,) less the target's, px per frame interval."""
        vectors = self.vectors(planes)
        if self.parameters.compare == "each":
            flows = vectors[(np.abs(vectors[:, :2] - box[:2]) <= box[2:] / 2).all(axis=1), 2:4]
        else:
            counts, means = self._inside(vectors, np.asarray(box, dtype=np.float64)[None], planes)
            flows = means[counts > 0]
        differences = flows - reference["flow"] if reference["known"] else np.empty((0, 2))
        return {"sd_x_px": differences[:, 0], "sd_y_px": differences[:, 1]}

    def vectors(self, planes: Planes) -> Floats:
        """(P, 4) x, y, dx, dy of the valid vectors, the camera's motion taken off."""
        pixels = None if self.flow.is_points else planes.region
        vectors = motion_planes.valid_vectors_of(planes[self.flow], pixels)
        if self.camera is None:
            return vectors
        return motion_planes.against_background(vectors, planes[self.camera])

    def _agrees(self, vectors: Floats, box: Floats, mean: Floats) -> bool:
        limit = self.parameters.coherent_px
        if limit is None:
            return True
        is_inside = (np.abs(vectors[:, :2] - box[:2]) <= box[2:] / 2).all(axis=1)
        return bool(np.mean(np.sum((vectors[is_inside, 2:4] - mean) ** 2, axis=1)) <= limit**2)

    def _log_share(
        self, vectors: Floats, boxes: Floats, velocities: Floats, reference: Reference
    ) -> tuple[Floats, Floats]:
        """(N,) vectors inside each box, and the log of their mean agreement with the velocities (N, 2)."""
        counts, log = np.zeros(len(boxes)), np.full(len(boxes), -np.inf)
        for some in np.array_split(np.arange(len(boxes)), max(1, len(boxes) * len(vectors) // BLOCK)):
            half = boxes[some, None, 2:4] / 2
            is_inside = (np.abs(vectors[:, :2] - boxes[some, None, :2]) <= half).all(axis=2)
            counts[some] = is_inside.sum(axis=1)
            share = (
                np.exp(self._log_agreement(vectors[:, 2:4], velocities[some, None], reference)) * is_inside
            )
            log[some] = np.log(share.sum(axis=1) / np.maximum(counts[some], 1.0))
        return counts, log

    def _log_agreement(self, flows: Floats, velocity: Floats, reference: Reference) -> Floats:
        sd = np.array([self.parameters.sd_x_px, self.parameters.sd_y_px]) * factor_of(reference)
        deviations = (flows - velocity) / (sd * spread_of(reference, 2))
        return np.asarray(-0.5 * (deviations**2).sum(axis=-1))

    def _inside(self, points: Floats, boxes: Floats, planes: Planes) -> tuple[Floats, Floats]:
        """(N,) points x, y, u, v inside each box, and (N, 2) their mean u and v."""
        return motion_planes.means_in_boxes(points, boxes, None if self.flow.is_points else planes.region)


def _velocities(hypotheses: Hypotheses) -> Floats | None:
    """(N, 2) vx and vy of hypotheses whose state has them."""
    if not {"vx", "vy"} <= set(hypotheses.fields):
        return None
    return np.stack([hypotheses.fields["vx"], hypotheses.fields["vy"]], axis=1)


def _reads(parameters: MotionParameters) -> tuple[str, ...]:
    return ("vx", "vy") if parameters.against == "velocity" else ()


def _make(parameters: MotionParameters) -> MotionCue:
    import cv2  # noqa: F401  (loaded when tracking starts, not at the first frame)

    from bayesnet_track.vision.kernels import flow_kernels  # noqa: F401

    plane: motion_planes.FlowPlane | DenseFlowPlane
    if parameters.flow == "sparse":
        plane = motion_planes.FlowPlane(
            spacing_px=parameters.spacing_px,
            min_gradient_gray=parameters.min_gradient_gray,
            half_window_px=parameters.half_window_px,
            reach_px=parameters.reach_px,
            agree_px=parameters.agree_px,
        )
    else:
        from bayesnet_track.vision.kernels import dense_flow_kernels  # noqa: F401

        plane = DenseFlowPlane(
            by="dis" if parameters.flow == "dense" else "odp",
            min_gradient_gray=parameters.min_gradient_gray,
            reach_px=parameters.reach_px,
            agree_px=parameters.agree_px,
        )
    camera = None if parameters.camera == "ignore" else motion_planes.CameraPlane(parameters.camera == "auto")
    return MotionCue(parameters, plane, camera)


CUE = CueDeclaration(
    name="motion",
    summary="Optical flow inside the box, compared with the target's.",
    parameters=MotionParameters,
    make=_make,
    cost_ms=1.0,
    is_appearance=False,
    rate_max=1.0,
    adapts=True,
    has_residuals=True,
    reads=_reads,
)
