"""Sensors whose detections are functions of the state: range and bearing, places on the ground, points.

z = h(x) + N(0, R), with h by the graph's expressions. Of a target predicted as N(m, P) a detection is
expected as N(h(m), S), S = H P H' + R, H the derivative of h at m; with `filter: unscented` both come from
sigma points. A state that starts with a detection is where h has the value of it: by the inverse that the
graph gives, else found by following h from a place where its value is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesnet_track.adapt.cameras import PlateErrors
from bayesnet_track.adapt.existence import DetectionModel, Pairs
from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.gaussian.rows import expect_seen
from bayesnet_track.belief.motion.formulas import linearise_seen
from bayesnet_track.belief.motion.start_prior import start_moments_of_each
from bayesnet_track.engine.lifecycle.sensing import (
    LOG_TURN,
    Begun,
    BoxSensor,
    CalibratedCamera,
    Found,
    Mixed,
    Sensor,
)
from bayesnet_track.graph.checked import ANCHORED, CheckedTarget, Inverse, MeasuredAs
from bayesnet_track.graph.expressions.evaluate import values_of
from bayesnet_track.inference.factors import seen_by
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import Expectation, chi_square_quantile
from bayesnet_track.numerics.lenses import follow_line
from bayesnet_track.observation.cue import AssociationRule
from bayesnet_track.observation.planes import FramePair
from bayesnet_track.observation.protocols import Seen


def make_sensor(plate: CheckedTarget, agent: str, rule: AssociationRule, fields: tuple[str, ...]) -> Sensor:
    """The sensor of an agent that is given detections: of boxes, or of the quantities that it names."""
    inverse = plate.inverses.get(agent)
    if inverse is None:
        return BoxSensor(rule)
    parameters: Any = plate.parameters[agent]
    quantities = tuple(parameters.sd)
    limits = np.array([parameters.within[name] for name in quantities])
    return FunctionSensor(
        rule,
        quantities,
        fields,
        plate.measures.get(agent, MeasuredAs({}, {})),
        np.array([*parameters.sd.values()]) ** 2,
        limits[:, 0],
        limits[:, 1],
        inverse,
        is_unscented(plate),
    )


def is_unscented(plate: CheckedTarget) -> bool:
    """True where targets are filtered by sigma points."""
    belief = plate.inference(plate.root).belief
    gaussian = None if belief is None else belief.gaussian
    return gaussian is not None and gaussian.filter == "unscented"


@dataclass(frozen=True, eq=False)
class FunctionSensor:
    """A sensor of quantities that are functions of the state.

    Attributes:
        association: the agent's rule: its gate.
        quantities: names of the K quantities.
        fields: names of the D fields of a state.
        functions: h.
        variances: (K,) of the errors.
        low: (K,) least values that the sensor gives, and
        high: (K,) largest ones; detections of nobody are uniform between them.
        inverse: how a target starts with a detection.
        is_unscented: whether moments are by sigma points.
        has_extent: whether detections have a size.
        seen: h in the frames of `at`.
        camera: none.
    """

    association: AssociationRule
    quantities: tuple[str, ...]
    fields: tuple[str, ...]
    functions: MeasuredAs
    variances: Floats
    low: Floats
    high: Floats
    inverse: Inverse
    is_unscented: bool = False
    has_extent: bool = False
    seen: Seen | None = None
    camera: CalibratedCamera | None = None

    @property
    def log_scale(self) -> float:
        """Log of (2 pi)^(-K / 2)."""
        return -0.5 * len(self.quantities) * LOG_TURN

    def at(self, frames: FramePair, errors: PlateErrors | None) -> FunctionSensor:
        """With h in these frames: it may read the time between them, and their size."""
        return replace(self, seen=seen_by(self.quantities, self.functions, frames))

    def boxes(self, mean: Floats) -> Floats:
        """The boxes of the states."""
        return mean[:, :4]

    def detect(self, mean: Floats) -> Found:
        """The quantities of the states, where h has a value."""
        return Found.expected(self._of(mean))

    def expect(self, mean: Floats, covariance: Floats) -> Expectation:
        """Expected detections of targets (T, D), (T, D, D), by a sensor without errors."""
        return expect_seen(self._seen, self.fields, (mean, covariance), self.is_unscented)

    def gate(self, mean: Floats, covariance: Floats, detections: Found) -> Pairs:
        """Possible pairs: d^2 = v' S^-1 v, v the shorter way round of angles."""
        nothing = np.empty(0, np.int64)
        if not len(mean) or not len(detections.values):
            return Pairs(nothing, nothing, np.empty(0))
        d2, log_gains = self._distances(mean, covariance, detections)
        limit = chi_square_quantile(self.association.gate, len(self.quantities))
        rows, columns = np.nonzero((d2 <= limit) & (d2 < np.inf))
        return Pairs(rows, columns, log_gains[rows, columns])

    def log_gains(self, mean: Floats, covariance: Floats, detections: Found) -> Floats:
        """Log densities of all pairs; -inf where h has no value."""
        return self._distances(mean, covariance, detections)[1]

    def _distances(self, mean: Floats, covariance: Floats, detections: Found) -> tuple[Floats, Floats]:
        """(T, N) d^2, and -d^2 / 2 - log det S / 2; infinite where h has no value."""
        expected = self.expect(mean, covariance)
        offsets = self._seen.less(detections.values[None], expected.values[:, None])
        lower = np.linalg.cholesky(expected.spread + np.diag(self.variances))
        scaled = np.linalg.solve(lower, np.swapaxes(offsets, 1, 2))
        d2 = np.where(expected.is_known[:, None], (scaled**2).sum(axis=1), np.inf)
        half = np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
        return d2, -0.5 * d2 - half[:, None]

    def mix(self, mean: Floats, covariance: Floats, detections: Found, mixed: Mixed) -> None:
        """Update beliefs: each choice gives the update of the extended or unscented filter."""
        from bayesnet_track.numerics.kernels.view_kernels import mix_expected

        if len(mixed.columns):
            expected, noise = self.expect(mean, covariance), np.diag(self.variances)
            offsets = self._seen.less(detections.values[mixed.columns], expected.values[mixed.rows])
            noises = np.broadcast_to(noise, (len(offsets), *noise.shape))
            mix_expected((mean, covariance), expected, (offsets, noises), (mixed.starts, *mixed.shares))
        np.maximum(mean[:, 2:4], 1.0, out=mean[:, 2:4])

    def cover(self, mean: Floats, existence: Floats) -> Floats:
        """(T,) none: what has no extent hides nothing."""
        return np.zeros(len(mean))

    def in_image(self, mean: Floats, covariance: Floats) -> Floats:
        """Sure: a sensor has no border."""
        return np.ones(len(mean))

    def near(
        self, mean: Floats, existence: Floats, detections: Found, area_px2: float
    ) -> tuple[Floats, float]:
        """Nothing has an extent here, so that no detection is on a target."""
        return np.zeros(len(detections.values)), 1.0

    def learn(self, detection_model: DetectionModel, detections: Found) -> DetectionModel:
        """Nothing."""
        return detection_model

    def log_density(self, detection_model: DetectionModel, detections: Found, area_px2: float) -> Floats:
        """Uniform between the least and the largest values that the sensor gives."""
        return np.full(len(detections.values), -float(np.log(self.high - self.low).sum()))

    def begin(self, motion: MotionModel, detections: Found) -> Begun:
        """States where h has the values measured, as surely as they say; other fields as of every start.

        The covariance is the inverse of H' R^-1 H, plus the inverse variances that fields start with which
        the detection does not place.
        """
        with np.errstate(all="ignore"):
            return self._begin(motion, detections)

    def _begin(self, motion: MotionModel, detections: Found) -> Begun:
        first, spread = motion.start_moments(np.array([0.0, 0.0, 1.0, 1.0]))
        states = np.tile(first, (len(detections.values), 1))
        names = dict(zip(self.quantities, detections.values.T, strict=True)) | dict(self.inverse.constants)
        terms, anchor = self.inverse.terms, self.inverse.anchor
        columns = [self.fields.index(name) for name in terms or ANCHORED]
        if terms:
            for column, term in zip(columns, terms.values(), strict=True):
                states[:, column] = values_of(term, names)
        elif anchor is None:
            return Begun(np.empty(0, np.int64), states[:0], np.empty((0, *spread.shape)))
        else:

            def measure_at(places: Floats) -> Floats:
                shifted = np.tile(states, (len(places) // len(states), 1))
                shifted[:, columns] = places
                return self._of(shifted)

            way = self._seen.less(detections.values, anchor.values)
            less, place = self._seen.less, anchor.place
            states[:, columns] = follow_line(measure_at, less, place, anchor.values, way, self.variances)
        means, spreads = start_moments_of_each(motion, states[:, :4])
        unplaced = [column for column in range(states.shape[1]) if column not in columns]
        states[:, unplaced] = means[:, unplaced]
        return self._spread(states, spreads, columns, detections)

    def _spread(self, states: Floats, spread: Floats, columns: list[int], detections: Found) -> Begun:
        expected, slopes = linearise_seen(states, self.fields, self._seen)
        prior = np.diagonal(spread, axis1=1, axis2=2).copy()
        prior[:, columns] = math.inf
        free = np.flatnonzero(prior.max(axis=0) > 0.0)
        heights = slopes[:, :, free]
        weighted = np.swapaxes(heights / self.variances[:, None], 1, 2)
        information = weighted @ heights + (1.0 / prior[:, free])[:, :, None] * np.eye(len(free))
        usable = np.isfinite(states).all(axis=1) & np.isfinite(information).all(axis=(1, 2))
        usable &= np.isfinite(expected).all(axis=1)
        information[~usable] = np.eye(len(free))
        usable &= np.linalg.cond(information) < 1e14
        information[~usable] = np.eye(len(free))
        posterior = np.linalg.inv(information)
        offsets = self._seen.less(detections.values, expected)
        states[:, free] += np.einsum(
            "nij,njk,nk->ni", posterior, weighted, np.where(usable[:, None], offsets, 0.0)
        )
        covariance = np.zeros_like(spread)
        covariance[np.ix_(np.arange(len(states)), free, free)] = (
            posterior + np.swapaxes(posterior, 1, 2)
        ) / 2
        indices = np.flatnonzero(usable)
        return Begun(indices, states[indices], covariance[indices])

    @property
    def _seen(self) -> Seen:
        assert self.seen is not None
        return self.seen

    def _of(self, states: Floats) -> Floats:
        """(N, K) h of states (N, D)."""
        return self._seen.function(dict(zip(self.fields, states.T, strict=True)))
