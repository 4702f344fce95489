"""How detections measure targets: the leaf of association, of which a box is one case.

A sensor knows what a detection would be of a state, z = h(x) + N(0, R): which detections are near enough to a
target's prediction, with their log densities; how beliefs are updated by those that may be theirs; how dense
detections of nobody are; and which state one of them starts with. Association, existence and births ask
nothing else of it. Boxes are here, quantities that are functions of the state in `measuring`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.association import near_along_x
from bayesnet_track.adapt.cameras import PlateErrors
from bayesnet_track.adapt.existence import DetectionModel, Pairs
from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.motion.start_prior import start_moments_of_each
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.gaussian import chi_square_quantile
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import AssociationRule
from bayesnet_track.observation.planes import FramePair

COVERED = 0.5
"""A target counts as covered when another one covers this share of its box."""

LOG_TURN = math.log(2.0 * math.pi)


@dataclass(frozen=True, eq=False)
class Found:
    """Detections of a look that one plate is given, the best first.

    Attributes:
        values: (N, K) what was measured: centre boxes x, y, w, h, else a column for each quantity.
        scores: (N,) 0..1.
        numbers: (N,) their numbers in the look.
        labels: what each is; empty where nothing goes by labels.
    """

    values: Floats
    scores: Floats
    numbers: Ints
    labels: tuple[str, ...] = ()

    @property
    def boxes(self) -> Floats:
        """(N, 4) the values of a look for boxes."""
        return self.values

    @classmethod
    def none(cls, width: int = 4) -> Self:
        """Nothing, of so many values."""
        return cls(np.empty((0, width)), np.empty(0), np.empty(0, np.int64))

    @classmethod
    def expected(cls, values: Floats) -> Self:
        """Sure detections of targets where these (T, K) are finite."""
        rows = np.flatnonzero(np.isfinite(values).all(axis=1))
        return cls(values[rows], np.ones(len(rows)), rows)

    def only(self, selection: NDArray[np.bool_] | Ints) -> Found:
        """Some of them."""
        labels = tuple(np.array(self.labels, dtype=object)[selection]) if self.labels else ()
        return Found(self.values[selection], self.scores[selection], self.numbers[selection], labels)


@dataclass(frozen=True, eq=False)
class Begun:
    """States that detections start with.

    Attributes:
        which: (M,) the detections that can start a target.
        mean: (M, D).
        covariance: (M, D, D).
    """

    which: Ints
    mean: Floats
    covariance: Floats


@dataclass(frozen=True, eq=False)
class Mixed:
    """Pairs of targets and detections with their weights, for an update.

    Attributes:
        starts: (T + 1,) where the detections of each begin in the next two.
        columns: (P,) which detection.
        weights: (P,) the probability that it is the target's.
        missed: (T,) that none is.
    """

    starts: Ints
    columns: Ints
    weights: Floats
    missed: Floats

    @property
    def rows(self) -> Ints:
        """(P,) which target."""
        return np.repeat(np.arange(len(self.missed)), np.diff(self.starts))

    @property
    def shares(self) -> tuple[Floats, Floats]:
        """(P,) and (T,) the probabilities."""
        return self.weights, self.missed


class CalibratedCamera(Protocol):
    """A camera through which a sensor sees targets on the ground."""

    @property
    def name(self) -> str:
        """The camera's, or that of the view where there is one image."""

    @property
    def bias_sd(self) -> float:
        """Sd of the error of its calibration, px; 0 where that is exact."""

    def check(self, mean: Floats, covariance: Floats, detections: Found, mixed: Mixed) -> dict[str, float]:
        """Innovations of detections of targets that were expected so, in sums; empty without targets."""


class Sensor(Protocol):
    """Interface of detectors and other sensors for association."""

    @property
    def association(self) -> AssociationRule:
        """The gate, and what else says whose a detection is."""

    @property
    def log_scale(self) -> float:
        """The term that the log densities of `gate` lack: log of (2 pi)^(-K / 2)."""

    @property
    def has_extent(self) -> bool:
        """True where detections have a size, which says how far a target may move."""

    @property
    def camera(self) -> CalibratedCamera | None:
        """The camera through which it sees targets on the ground; None of other sensors."""

    def at(self, frames: FramePair, errors: PlateErrors | None) -> Sensor:
        """The sensor in these frames, with what is known of the errors of cameras."""

    def gate(self, mean: Floats, covariance: Floats, detections: Found) -> Pairs:
        """Possible pairs, with -d^2 / 2 - log det S / 2; of means (T, D) and covariances (T, D, D)."""

    def log_gains(self, mean: Floats, covariance: Floats, detections: Found) -> Floats:
        """(T, N) -d^2 / 2 - log det S / 2 of all pairs."""

    def mix(self, mean: Floats, covariance: Floats, detections: Found, mixed: Mixed) -> None:
        """Update beliefs (T, D), (T, D, D), in place, to the moments of the mixture of their updates."""

    def cover(self, mean: Floats, existence: Floats) -> Floats:
        """(T,) how probable it is that another target covers each."""

    def in_image(self, mean: Floats, covariance: Floats) -> Floats:
        """(T,) probability that each is in what the sensor looks at."""

    def near(
        self, mean: Floats, existence: Floats, detections: Found, area_px2: float
    ) -> tuple[Floats, float]:
        """(N,) how probably a target covers each detection, and the share of the frame that is on targets."""

    def learn(self, detection_model: DetectionModel, detections: Found) -> DetectionModel:
        """Learn of detections as such."""

    def log_density(self, detection_model: DetectionModel, detections: Found, area_px2: float) -> Floats:
        """(N,) log density of detections that are nobody's, in a frame of this area."""

    def begin(self, motion: MotionModel, detections: Found) -> Begun:
        """The states that detections start with."""

    def boxes(self, mean: Floats) -> Floats:
        """(T, 4) centre boxes in the image of states (T, D), px."""

    def detect(self, mean: Floats) -> Found:
        """The detections of targets in states (T, D) without errors; their numbers are rows of those seen."""


@dataclass(frozen=True, eq=False)
class BoxSensor:
    """A detector of boxes: h is the box of the state, R grows with the detection's own size.

    Attributes:
        association: the agent's rule.
    """

    association: AssociationRule
    log_scale: float = -2.0 * LOG_TURN
    has_extent: bool = True
    camera: CalibratedCamera | None = None

    def at(self, frames: FramePair, errors: PlateErrors | None) -> BoxSensor:
        """The same in every frame."""
        return self

    def boxes(self, mean: Floats) -> Floats:
        """The boxes of the states."""
        return mean[:, :4]

    def detect(self, mean: Floats) -> Found:
        """The boxes of the states."""
        return Found.expected(mean[:, :4])

    def gate(self, mean: Floats, covariance: Floats, detections: Found) -> Pairs:
        """Possible pairs; boxes that overlap the prediction by less than `min_overlap` are out, too."""
        return gate_boxes(self.association, mean, covariance, detections.values)

    def log_gains(self, mean: Floats, covariance: Floats, detections: Found) -> Floats:
        """Log densities of all pairs, as of every sensor."""
        noise = self.association.variances(detections.values)[:, :, None] * np.eye(4)
        spread = covariance[:, None, :4, :4] + noise
        offsets = detections.values - mean[:, None, :4]
        d2 = np.einsum("tni,tni->tn", offsets, np.linalg.solve(spread, offsets[..., None])[..., 0])
        return np.asarray(-0.5 * (d2 + np.linalg.slogdet(spread)[1]))

    def mix(self, mean: Floats, covariance: Floats, detections: Found, mixed: Mixed) -> None:
        """Update beliefs, as of every sensor; sides stay at least 1 px."""
        from bayesnet_track.numerics.kernels.pair_kernels import mix_rows

        boxes = np.ascontiguousarray(detections.values[mixed.columns])
        variances = self.association.variances(boxes)
        mix_rows(mean, covariance, mixed.starts, boxes, variances, mixed.weights, mixed.missed)

    def cover(self, mean: Floats, existence: Floats) -> Floats:
        """By the share of the predicted box that the other's covers."""
        from bayesnet_track.numerics.kernels.pair_kernels import cover_rows

        order = np.argsort(mean[:, 0] - mean[:, 2] / 2, kind="stable")
        return np.asarray(cover_rows(np.ascontiguousarray(mean), existence, order, COVERED))

    def in_image(self, mean: Floats, covariance: Floats) -> Floats:
        """Sure: motions keep targets inside."""
        return np.ones(len(mean))

    def near(
        self, mean: Floats, existence: Floats, detections: Found, area_px2: float
    ) -> tuple[Floats, float]:
        """By the share of the detection that a predicted box covers."""
        return near_boxes(mean[:, :4], existence, detections.values, area_px2)

    def learn(self, detection_model: DetectionModel, detections: Found) -> DetectionModel:
        """The sizes that detections have."""
        return detection_model.with_sizes(detections.values)

    def log_density(self, detection_model: DetectionModel, detections: Found, area_px2: float) -> Floats:
        """Uniform over the frame, of the sizes that detections have."""
        return detection_model.log_density(detections.values, area_px2)

    def begin(self, motion: MotionModel, detections: Found) -> Begun:
        """The box itself, with the detection's error."""
        boxes = detections.values
        mean, covariance = start_moments_of_each(motion, boxes)
        diagonal = np.arange(4)
        covariance[:, diagonal, diagonal] += self.association.variances(boxes)
        return Begun(np.arange(len(boxes)), mean, covariance)


def near_boxes(boxes: Floats, existence: Floats, detected: Floats, area_px2: float) -> tuple[Floats, float]:
    """(N,) how probably a box (T, 4) covers each of those found (N, 4), and the area's share on boxes."""
    from bayesnet_track.numerics.kernels.pair_kernels import cover_rows

    count, nothing = len(boxes), np.zeros(len(detected))
    if not count or not len(detected):
        return nothing, 1.0
    all_boxes = np.concatenate([boxes, detected])
    order = np.argsort(all_boxes[:, 0] - all_boxes[:, 2] / 2, kind="stable")
    cover = cover_rows(all_boxes, np.concatenate([existence, nothing]), order, COVERED)[count:]
    return cover, min(float(existence @ (boxes[:, 2] * boxes[:, 3])) / area_px2, 1.0)


def gate_boxes(rule: AssociationRule, mean: Floats, covariance: Floats, boxes: Floats) -> Pairs:
    """The detections (N, 4) that may be whose, with -d^2 / 2 - log det S / 2; means (T, D), and (T, D, D)."""
    from bayesnet_track.numerics.kernels.pair_kernels import gate_rows

    nothing = np.empty(0, np.int64)
    if not len(boxes) or not len(mean):
        return Pairs(nothing, nothing, np.empty(0))
    boxes, variances = np.ascontiguousarray(boxes), rule.variances(boxes)
    limit, min_overlap = chi_square_quantile(rule.gate, 4), rule.min_overlap

    def find_reach() -> Floats:
        reach = np.sqrt(limit * (covariance[:, 0, 0] + variances[:, 0].max())) * (1 + 1e-9)
        touches = (mean[:, 2] + boxes[:, 2].max()) / 2
        return np.asarray(np.minimum(reach, touches) if min_overlap > 0.0 else reach)

    neighbours = near_along_x(mean[:, 0], boxes, find_reach)
    return Pairs(*gate_rows(mean, covariance, boxes, variances, *neighbours, limit, min_overlap))


def with_looks(
    rule: AssociationRule, pairs: Pairs, log_looks: Callable[[Ints, Floats], Floats], boxes: Floats
) -> Pairs:
    """The pairs with what their targets look like: their values and appearance log L."""
    values, order = pairs.values.copy(), np.argsort(pairs.rows, kind="stable")
    values[order] += rule.appearance * log_looks(pairs.rows[order], boxes[pairs.columns[order]])
    return evolve(pairs, values=values)
