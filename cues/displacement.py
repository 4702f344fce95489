"""Displacement cue: where the target's points have moved, by filtered matrices of displacement.

Section 3 of the General Distribution Filter as an agent that measures: each point of the target has a
distribution of displacement from patch matching, filtered over the frames; the target moves by the mean of
their sum, and each point by its probable displacement nearest to that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesnet_track.observation.cue import (
    CueDeclaration,
    CueParameters,
    Floats,
    Hypotheses,
    Measurement,
    Reference,
)
from bayesnet_track.observation.geometry import crop_of
from bayesnet_track.observation.planes import Region, for_reading, region_of_boxes
from bayesnet_track.vision.planes import GrayPlane
from bayesnet_track.vision.points import (
    Displaced,
    Matching,
    Points,
    cut_patches,
    displace,
    flat_motion,
)

if TYPE_CHECKING:
    from bayesnet_track.observation.geometry import crop_of
from bayesnet_track.observation.planes import Plane, Planes


class DisplacementParameters(CueParameters):
    """Parameters of the displacement cue."""

    points: int = Field(default=24, ge=1, le=200, description="Largest number of tracked points, count.")
    spacing_px: int = Field(
        default=6, ge=3, le=128, description="Width of the lattice cells that hold one point each, pixels."
    )
    patch_px: int = Field(default=9, ge=3, le=31, description="Side of a point's patch, odd, pixels.")
    reach_px: int = Field(
        default=12,
        ge=1,
        le=64,
        description="Largest distance, in x and in y, of a displacement from the predicted one, pixels per "
        "frame interval.",
    )
    min_gradient_gray: float = Field(
        default=2.0,
        gt=0,
        description="Smallest gradient of a point in its weakest direction, gray levels of 255 per pixel.",
    )
    sd_gray: float = Field(
        default=8.0,
        gt=0,
        description="Standard deviation of the difference between patch and image, gray levels of 255.",
    )
    sd_motion_px: float = Field(
        default=1.0,
        ge=0,
        description="Change of a point's velocity, pixels per frame, per frame interval.",
    )
    forget: float = Field(
        default=1.0, ge=1, description="k: each matrix is raised to 1/k before it is used again (no unit)."
    )
    epsilon: float = Field(
        default=0.3,
        gt=0,
        le=1,
        description="A point moves to the displacement nearest to the object's with at least this share of "
        "the largest probability.",
    )
    min_seen: float = Field(
        default=0.25, gt=0, le=1, description="Smallest share of the points whose patch must fit somewhere."
    )
    correlation: float = Field(
        default=0.2,
        ge=0,
        le=1,
        description="Correlation c of the points' errors: the mean of n has the variance of one times (1 + (n"
        " - 1) c) / n.",
    )


@dataclass(frozen=True)
class DisplacementCue:
    """Finds the target by the displacement of its points.

    Reference: `at` (N, 2), `patches` (N, P, P), `motion` (N, K, K), `centre` (2,) of the points (see
    `bayesnet_track.vision.points`); `box` (4,) where the target was, px; `time` () when, frame
    intervals; `image` (rows, columns) uint8 the picture around it then, `origin` (2,) its first pixel.
    """

    parameters: DisplacementParameters
    matching: Matching
    gray: GrayPlane
    context: ClassVar[float] = 1.0

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The gray plane."""
        return (self.gray,)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The points on corners inside the centre box (4,), nothing known of their motion."""
        region = region_of_boxes(np.asarray(box)[None], self.context).within(planes.frame)
        image, origin = _crop(planes, self.gray, region)
        side = 2 * (self.parameters.patch_px // 2) + 1
        corners = self._corners(image, origin, np.asarray(box, dtype=np.float64))
        patches, is_valid = cut_patches(image, origin, corners, side)
        is_valid &= patches.var(axis=(1, 2)) > 0
        return {
            "at": corners[is_valid],
            "patches": patches[is_valid],
            "motion": flat_motion(int(is_valid.sum()), self.matching),
            "centre": np.zeros(2, dtype=np.int64),
            "box": np.array(box, dtype=np.float64),
            "time": np.array(float(planes.frame.time)),
            "image": image,
            "origin": np.array(origin, dtype=np.int64),
        }

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """The old points where the new picture shows them, their patches `rate` new; new ones in the gaps.

        Rate 0 keeps the old reference and 1 takes the new one, whose points have no past.
        """
        dt = float(new["time"] - old["time"])
        if rate <= 0.0:
            return old
        if rate >= 1.0 or dt <= 0:
            return new
        found = self._displaced(old, new["image"], _origin(new), dt, new["box"])
        if found is None:
            return new
        points = found.points
        patches, whole = cut_patches(new["image"], _origin(new), points.at, points.patches.shape[1])
        away = np.abs(points.at - new["box"][:2])
        kept = np.flatnonzero(whole & (away <= new["box"][2:] / 2).all(axis=1))
        mixed = np.where(
            found.seen[:, None, None], (1 - rate) * points.patches + rate * patches, points.patches
        )
        fresh = _far_from(new["at"], points.at[kept], self.parameters.spacing_px)
        fresh = fresh[: max(self.parameters.points - len(kept), 0)]
        return {
            **new,
            "at": np.concatenate([points.at[kept], new["at"][fresh]]),
            "patches": np.concatenate([mixed[kept], new["patches"][fresh]]),
            "motion": np.concatenate([points.motion[kept], new["motion"][fresh]]),
            "centre": points.centre,
        }

    def measure(
        self, planes: Planes, hypotheses: Hypotheses, weights: Floats, reference: Reference
    ) -> Measurement | None:
        """The last place of the target plus the mean of P_sum, over the time since; None when not seen.

        It is not seen when fewer than `min_seen` of its points are. P_sum holds what earlier frames said of
        the velocity, so that errors persist over frames; its variance is shared by the points as their
        `correlation` says. A pixel's own 1/12 is added. The matrices are centred on the prediction.
        """
        dt = float(planes.frame.time - reference["time"])
        dt = dt if dt > 0 else 1.0
        region = region_of_boxes(hypotheses.boxes).within(planes.frame)
        image, origin = _crop(planes, self.gray, region)
        displaced = self._displaced(reference, image, origin, dt, weights @ hypotheses.boxes)
        if displaced is None or displaced.seen.mean() < self.parameters.min_seen:
            return None
        count = int(displaced.seen.sum())
        shared = (1.0 + (count - 1) * self.parameters.correlation) / count
        covariance = dt**2 * (displaced.covariance * shared + np.eye(2) / 12.0)
        return Measurement(
            ("x", "y"), reference["box"][:2] + dt * displaced.motion, covariance, self.parameters.floor
        )

    def _displaced(
        self, reference: Reference, image: NDArray[np.uint8], origin: tuple[int, int], dt: float, box: Floats
    ) -> Displaced | None:
        """The reference's points in a new picture, looked for around the motion that leads to `box`."""
        if len(reference["at"]) == 0 or image.size == 0:
            return None
        centre = np.rint((box[:2] - reference["box"][:2]) / dt).astype(np.int64)
        points = Points(reference["at"], reference["patches"], reference["motion"], reference["centre"])
        return displace(points, image, origin, dt, centre, self.matching)

    def _corners(self, image: NDArray[np.uint8], origin: tuple[int, int], box: Floats) -> NDArray[np.int64]:
        """(N, 2) x, y of the strongest corners in the box, one to a cell of the frame's lattice at most."""
        from bayesnet_track.vision.kernels import flow_kernels

        settings = self.parameters
        if image.size == 0:
            return np.zeros((0, 2), dtype=np.int64)
        scores = np.zeros(image.shape)
        flow_kernels.corner_scores(for_reading(image), settings.min_gradient_gray**2, scores)
        # Patches that reach over the target's border would hold as much of the background.
        inner = box[2:] / 2 - np.minimum(settings.patch_px // 2, box[2:] / 4)
        low, high = np.ceil(box[:2] - inner), np.floor(box[:2] + inner)
        x, y = (np.arange(n) + origin[k] for k, n in ((0, image.shape[1]), (1, image.shape[0])))
        is_outside = ~np.outer((y >= low[1]) & (y <= high[1]), (x >= low[0]) & (x <= high[0]))
        scores[is_outside] = 0.0
        rows, columns = np.nonzero(scores > 0)
        order = np.argsort(-scores[rows, columns], kind="stable")
        places = np.column_stack([columns, rows])[order] + np.array(origin)
        if len(places) == 0:  # too small for a corner: its middle, if there is anything to be seen
            places = np.rint(box[None, :2]).astype(np.int64)
        _, first = np.unique(places // settings.spacing_px, axis=0, return_index=True)
        return np.asarray(places[np.sort(first)][: settings.points], dtype=np.int64)


def _crop(planes: Planes, gray: GrayPlane, region: Region) -> tuple[NDArray[np.uint8], tuple[int, int]]:
    """A copy of the gray values on the part of `region` that the planes cover, and its first pixel."""
    values, first = crop_of(planes, gray, region)
    return np.array(values, dtype=np.uint8), first


def _origin(reference: Reference) -> tuple[int, int]:
    return int(reference["origin"][0]), int(reference["origin"][1])


def _far_from(places: NDArray[Any], obstacles: NDArray[Any], min_distance: float) -> NDArray[np.intp]:
    """Indices of the places at least `min_distance` px from all others."""
    if len(obstacles) == 0:
        return np.arange(len(places))
    distances = np.abs(places[:, None] - obstacles[None]).max(axis=2).min(axis=1)
    return np.flatnonzero(distances >= min_distance)


def _make(parameters: DisplacementParameters) -> DisplacementCue:
    import cv2  # noqa: F401  (loaded when tracking starts, not at the first frame)

    matching = Matching(
        parameters.reach_px,
        parameters.sd_gray,
        parameters.sd_motion_px,
        parameters.forget,
        parameters.epsilon,
    )
    return DisplacementCue(parameters, matching, GrayPlane())


CUE = CueDeclaration(
    name="displacement",
    summary="Where the target's points have moved, by filtered matrices of displacement.",
    parameters=DisplacementParameters,
    make=_make,
    cost_ms=1.5,
    is_appearance=False,
    rate_max=0.3,
    measures=True,
)
