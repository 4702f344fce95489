"""Cue: the KLT point tracker, which follows corners of the target and measures place and size.

Tracking chapter 3.2.3: Shi-Tomasi corners are followed by pyramidal Lucas-Kanade, there and back; those that
do not move as the others do, or that no longer look as when they were chosen, are dropped and replaced.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from bayesnet_track.numerics.arrays import Image
from bayesnet_track.observation.cue import (
    CueDeclaration,
    CueParameters,
    Floats,
    Hypotheses,
    Measurement,
    MeasuringCue,
    Reference,
)
from bayesnet_track.observation.planes import Plane, Planes, Region, region_of_boxes
from bayesnet_track.vision.planes import WholeFrame
from bayesnet_track.vision.points import (
    COARSEST,
    FEW,
    Following,
    PointMotion,
    clearest_mix,
    corners_in,
    correlations,
    cut_region,
    find_agreement,
    followed,
    mix_channels,
    patches_at,
)


class KltParameters(CueParameters):
    """Parameters of the KLT tracker."""

    against: Literal["place", "velocity"] = Field(
        default="place",
        description="What it measures: where the target is, which may drift off it, or how fast it is (`vx`, "
        "`vy` of the state).",
    )
    points: int = Field(default=40, ge=1, le=100, description="Largest number of tracked points (count).")
    spacing_px: float = Field(default=5.0, ge=1, description="Smallest distance between two points (px).")
    inner: float = Field(
        default=0.8, gt=0, le=1, description="Points lie in this share of the box's sides about its centre."
    )
    min_gradient_gray: float = Field(
        default=2.0,
        gt=0,
        description="Smallest gradient of a point in its weakest direction (gray levels of 255 per px).",
    )
    half_window_px: int = Field(
        default=5, ge=2, le=15, description="A patch reaches this far around its point (px of each level)."
    )
    reach_px: int = Field(
        default=24, ge=4, le=128, description="Largest displacement from the prediction in x and in y (px)."
    )
    agree_px: float = Field(
        default=1.5,
        gt=0,
        description="Largest distance of a point from where tracking there and back takes it, and from where "
        "the motion of all takes it (px).",
    )
    max_scale: float = Field(
        default=1.5,
        gt=1,
        description="Largest change of size since the last frame in which it was seen (factor).",
    )
    min_correlation: float = Field(
        default=0.6,
        ge=-1,
        le=1,
        description="Smallest correlation of a point's patch with that of the frame in which it was chosen "
        "(no unit).",
    )
    min_seen: float = Field(
        default=0.3, gt=0, le=1, description="Smallest share of agreeing points at which the target is seen."
    )
    patience: float = Field(
        default=10.0,
        ge=0,
        description="How long missing points are searched for before new ones are chosen at the estimate "
        "(frame intervals).",
    )
    sd_px: float = Field(default=0.5, gt=0, description="Error of the place with however many points (px).")
    sd_log_size: float = Field(
        default=0.02, gt=0, description="The same of the size, in its logarithm (no unit)."
    )


@dataclass(frozen=True)
class Klt:
    """The KLT tracker at work.

    Reference: `at` (N, 2) the points, frame px; `patches` (N, P, P) what each looked like when it was chosen;
    `turns` (N,) complex, its scale and rotation since then; `box` (4,) and `time` () of the last look, px and
    frame intervals; `image` (rows, columns, 3) uint8 the picture around the target then, `origin` (2,) its
    first pixel; `mix` (3,) the weights of B, G, R that are followed.
    """

    parameters: KltParameters
    how: Following
    context: ClassVar[float] = 0.0

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The picture: patches reach beyond the hypotheses' boxes."""
        return (WholeFrame(),)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """New points on the corners inside the centre box (4,)."""
        p = self.parameters
        nearby = region_of_boxes(box[None]).within(planes.frame)
        region = nearby if nearby.is_empty else _aligned(nearby.grown(self.how.margin))
        image, origin = cut_region(planes[WholeFrame()], region), (region.x0, region.y0)
        mix = clearest_mix(image, origin, self._inner(box), p.min_gradient_gray)
        corners, patches = self._chosen(image, origin, box, mix)
        return {
            "at": corners,
            "patches": patches,
            "turns": np.ones(len(corners), dtype=np.complex128),
            "box": np.array(box, dtype=np.float64),
            "time": np.array(float(planes.frame.time)),
            "image": image,
            "origin": np.array(origin, dtype=np.int64),
            "mix": mix,
        }

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """The old points where the new picture shows them, and new ones for those that are lost.

        The box that the points carry moves toward the new one by `rate`. Rate 0 keeps the old reference and 1
        takes the new one, and so does it after `patience` frame intervals in which the points are not found.
        """
        dt = float(new["time"] - old["time"])
        if rate <= 0.0:
            return old
        if rate >= 1.0 or dt <= 0.0 or len(old["at"]) == 0:
            return new
        motion = self._motion(old, new["image"], _origin(new), new["box"])
        if motion is None:
            return old if dt < self.parameters.patience else new
        box = (1.0 - rate) * self._carried(old, motion) + rate * new["box"]
        kept = motion.kept & (np.abs(motion.places - box[:2]) <= box[2:] / 2).all(axis=1)
        fresh, patches = new["at"], new["patches"]
        if not np.array_equal(old["mix"], new["mix"]):
            fresh, patches = self._chosen(new["image"], _origin(new), new["box"], old["mix"])
        away = np.abs(fresh[:, None] - motion.places[kept][None]).max(axis=2, initial=0.0)
        gaps = (away >= self.parameters.spacing_px).all(axis=1)
        gaps &= np.cumsum(gaps) <= self.parameters.points - kept.sum()
        turns = np.concatenate([old["turns"][kept] * motion.factor, np.ones(int(gaps.sum()))])
        return {
            **new,
            "at": np.concatenate([motion.places[kept], fresh[gaps]]),
            "patches": np.concatenate([old["patches"][kept], patches[gaps]]),
            "turns": turns,
            "box": box,
            "mix": old["mix"],
        }

    def measure(
        self, planes: Planes, hypotheses: Hypotheses, weights: Floats, reference: Reference
    ) -> Measurement | None:
        """Box that the points carry, with w and h when they say anything of size; None when not seen.

        It is not seen when fewer than `min_seen` of its points agree. The covariance is that of the least
        squares fit at the box's centre, variance (1 / n + d^2 / spread), and what always remains.
        """
        p = self.parameters
        motion = self._motion(reference, planes[WholeFrame()], None, weights @ hypotheses.boxes)
        if motion is None:
            return None
        if p.against == "velocity":
            return self._velocity(planes, reference, motion)
        box, n = self._carried(reference, motion), int(motion.kept.sum())
        # Of few points the residuals say little: their error is no less than a part of the tolerance.
        variance = max(motion.variance, (p.agree_px / 3.0) ** 2)
        if n <= FEW:
            return Measurement(("x", "y"), box[:2], np.eye(2) * (variance / n + p.sd_px**2), p.floor)
        x, y = reference["box"][:2]
        lever = abs(complex(x, y) - motion.source) ** 2 / motion.spread
        place = variance * (1.0 / n + lever) + p.sd_px**2
        log_size = variance / motion.spread / abs(motion.factor) ** 2
        size = np.outer(box[2:], box[2:]) * log_size + np.diag((p.sd_log_size * box[2:]) ** 2)
        covariance = np.zeros((4, 4))
        covariance[:2, :2], covariance[2:, 2:] = np.eye(2) * place, size
        return Measurement(("x", "y", "w", "h"), box, covariance, p.floor)

    def _velocity(self, planes: Planes, reference: Reference, motion: PointMotion) -> Measurement | None:
        """Velocity of the points since the last look: the variance of their mean over the time squared."""
        p, dt = self.parameters, float(planes.frame.time - reference["time"])
        if dt <= 0.0:
            return None
        variance = max(motion.variance, (p.agree_px / 3.0) ** 2) / motion.kept.sum() + p.sd_px**2
        speed = (motion.of(reference["box"][:2]) - reference["box"][:2]) / dt
        return Measurement(("vx", "vy"), speed, np.eye(2) * variance / dt**2, p.floor)

    def followed(self, planes: Planes, box: Floats, reference: Reference) -> PointMotion | None:
        """Motion of the points, looked for around a predicted centre box (4,); None when too few agree."""
        return self._motion(reference, planes[WholeFrame()], None, box)

    def _motion(
        self, reference: Reference, image: Image, origin: tuple[int, int] | None, box: Floats
    ) -> PointMotion | None:
        """Motion as of `followed`, in an image whose first pixel is `origin`; None for a whole frame."""
        p, points, mix = self.parameters, reference["at"], reference["mix"]
        if len(points) == 0 or image.size == 0:
            return None
        rows, columns = reference["image"].shape[:2]
        step = np.rint((box[:2] - reference["box"][:2]) / COARSEST).astype(int) * COARSEST
        guess = (int(step[0]), int(step[1]))
        x, y = (a + b - c for a, b, c in zip(_origin(reference), guess, origin or (0, 0), strict=True))
        view = cut_region(image, Region(x, y, x + columns, y + rows))
        if view.size == 0:
            return None
        mixed_image = mix_channels(view, mix)
        new_points, clear = followed(
            mix_channels(reference["image"], mix), mixed_image, _origin(reference), guess, points, self.how
        )
        motion = find_agreement(points, new_points, clear, self.how)
        if motion is None:
            return None
        first = (_origin(reference)[0] + guess[0], _origin(reference)[1] + guess[1])
        looks = patches_at(mixed_image, first, new_points, reference["turns"] * motion.factor, _side(p))
        correlations_alike = motion.kept & (correlations(reference["patches"], looks) >= p.min_correlation)
        if correlations_alike.sum() < max(p.min_seen * len(points), 1.0):
            return None
        return find_agreement(points, new_points, correlations_alike, self.how)

    def _carried(self, reference: Reference, motion: PointMotion) -> Floats:
        old_box = reference["box"]
        return np.concatenate([motion.of(old_box[:2]), old_box[2:] * abs(motion.factor)])

    def _inner(self, box: Floats) -> Floats:
        return np.concatenate([box[:2], self.parameters.inner * box[2:]])

    def _chosen(
        self, image: Image, origin: tuple[int, int], box: Floats, mix: Floats
    ) -> tuple[Floats, Floats]:
        p, gray = self.parameters, mix_channels(image, mix)
        corners = corners_in(gray, origin, self._inner(box), p.min_gradient_gray, p.spacing_px, p.points)
        return corners, patches_at(
            gray, origin, corners, np.ones(len(corners), dtype=np.complex128), _side(p)
        )


def _side(parameters: KltParameters) -> int:
    return 2 * parameters.half_window_px + 1


def _origin(reference: Reference) -> tuple[int, int]:
    return int(reference["origin"][0]), int(reference["origin"][1])


def _aligned(region: Region) -> Region:
    """Grown to multiples of the coarsest level's pixels."""
    low, high = (region.x0, region.y0), (region.x1, region.y1)
    return Region(*(v // COARSEST * COARSEST for v in low), *(-(-v // COARSEST) * COARSEST for v in high))


def _make(parameters: KltParameters) -> MeasuringCue:
    import cv2  # noqa: F401  (loaded when tracking starts, not at the first frame)

    p = parameters
    return Klt(p, Following(p.half_window_px, p.reach_px, p.agree_px, p.max_scale, p.min_correlation))


CUE = CueDeclaration(
    name="klt",
    summary="KLT point tracker: measures where corners of the target have moved.",
    parameters=KltParameters,
    make=_make,
    cost_ms=0.9,
    rate_max=0.2,
    measures=True,
    reads=lambda parameters: ("vx", "vy") if parameters.against == "velocity" else (),
)
