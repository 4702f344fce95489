"""Detections of boxes in the image of a camera, of targets on the ground: a sensor whose h is a projection.

Association takes place in the image: of a target predicted as N(m, P) a box is expected as N(h(m), H P H' +
R), R that of a detection of the box h(m). A target that starts stands where its box says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesnet_track.adapt.cameras import PlateErrors
from bayesnet_track.adapt.existence import DetectionModel, Pairs
from bayesnet_track.belief.contract import LEAST_SIDE_M, MotionModel
from bayesnet_track.belief.gaussian.rows import expect_seen
from bayesnet_track.belief.gaussian.update import measured_columns
from bayesnet_track.engine.lifecycle.measuring import is_unscented
from bayesnet_track.engine.lifecycle.sensing import COVERED, LOG_TURN, Begun, Found, Mixed, near_boxes
from bayesnet_track.graph.checked import BY_PLACE, CheckedTarget, LastingError
from bayesnet_track.inference.views import View, Views, place
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.cameras import UNSEEN
from bayesnet_track.numerics.gaussian import Expectation, chi_square_quantile
from bayesnet_track.numerics.outlines import cut_covariance
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import AssociationRule
from bayesnet_track.observation.planes import FramePair


@dataclass(frozen=True, eq=False)
class ViewSensor:
    """A detector of boxes in the image of a camera.

    Attributes:
        association: the agent's rule.
        agent: the agent.
        fields: names of the D fields of a state.
        views: of the plate.
        view: through which it looks.
        is_one_of_several: whether others see targets that are not in its image.
        is_unscented: whether moments are by sigma points.
        has_extent: False: a target moves in metres, as its motion says, not in sides of a box.
        errors: what is known of the errors of cameras in this frame; None where none is shared.
    """

    association: AssociationRule
    agent: str
    fields: tuple[str, ...]
    views: Views
    view: View
    is_one_of_several: bool = False
    is_unscented: bool = False
    has_extent: bool = False
    errors: PlateErrors | None = None

    @cached_property
    def width(self) -> int:
        """Number of quantities that a detection measures: x and y of a point, x, y, w and h of a box."""
        return 2 if self.association.is_of_points else 4

    @property
    def log_scale(self) -> float:
        """Log of (2 pi)^(-K / 2)."""
        return -0.5 * self.width * LOG_TURN

    def at(self, frames: FramePair, errors: PlateErrors | None) -> ViewSensor:
        """With what is known of the errors of cameras; the same in every frame."""
        return self if errors is None else evolve(self, errors=errors)

    @property
    def camera(self) -> ViewSensor:
        """Itself: each looks through one."""
        return self

    @property
    def name(self) -> str:
        """Name of the camera."""
        return self.view.seen_by

    def boxes(self, mean: Floats) -> Floats:
        """(T, 4) boxes in the image of states (T, D), as the camera shows them."""
        boxes = self.view.boxes(self.views.named(mean))
        return np.where(np.isfinite(boxes).all(axis=1, keepdims=True), boxes, np.array(UNSEEN))

    def detect(self, mean: Floats) -> Found:
        """Boxes in the image as the agent finds them, of states that the camera sees."""
        return Found.expected(self.view.boxes(self.views.named(mean), self.agent))

    def expect(self, mean: Floats, covariance: Floats) -> Expectation:
        """Expected detections of targets (T, D), (T, D, D), by a detector without errors."""
        seen = self.view.box_quantities(self.agent, width=self.width)
        return expect_seen(seen, self.fields, (mean, covariance), self.is_unscented)

    def gate(self, mean: Floats, covariance: Floats, detections: Found) -> Pairs:
        """Possible pairs, as of every sensor."""
        nothing = np.empty(0, np.int64)
        if not len(mean) or not len(detections.values):
            return Pairs(nothing, nothing, np.empty(0))
        d2, log_gains = self._distances(mean, covariance, detections)
        limit = chi_square_quantile(self.association.gate, self.width)
        rows, columns = np.nonzero((d2 <= limit) & (d2 < np.inf))
        return Pairs(rows, columns, log_gains[rows, columns])

    def log_gains(self, mean: Floats, covariance: Floats, detections: Found) -> Floats:
        """Log densities of all pairs; -inf of a target that the camera cannot see."""
        return self._distances(mean, covariance, detections)[1]

    def mix(self, mean: Floats, covariance: Floats, detections: Found, mixed: Mixed) -> None:
        """Update beliefs: each choice gives the update of the extended or unscented filter."""
        from bayesnet_track.numerics.kernels.view_kernels import mix_expected

        if len(mixed.columns):
            expected, rows = self.expect(mean, covariance), mixed.rows
            boxes = detections.values[mixed.columns]
            noises = self._noise(expected)[rows] + self._cut(boxes)
            innovations = boxes[:, : self.width] - expected.values[rows]
            choices = (mixed.starts, *mixed.shares)
            considered = measured_columns(self.view.shared, self.fields)
            mix_expected((mean, covariance), expected, (innovations, noises), choices, considered)
        np.maximum(mean[:, 2:4], LEAST_SIDE_M, out=mean[:, 2:4])

    def cover(self, mean: Floats, existence: Floats) -> Floats:
        """By the share of the predicted box that the other's covers in the image."""
        from bayesnet_track.numerics.kernels.pair_kernels import cover_rows

        boxes = np.ascontiguousarray(self.boxes(mean))
        in_view = boxes[:, 0] != UNSEEN[0]
        order = np.argsort(boxes[:, 0] - boxes[:, 2] / 2, kind="stable")
        return np.asarray(cover_rows(boxes, existence * in_view, order, COVERED) * in_view)

    def in_image(self, mean: Floats, covariance: Floats) -> Floats:
        """Probability that a part of its box is, a Gaussian in the image; 1 where nobody looks elsewhere."""
        from scipy.special import ndtr

        size = self.view.camera.size
        if size is None or not self.is_one_of_several or not len(mean):
            return np.ones(len(mean))
        expected = self.expect(mean, covariance)
        sd = np.sqrt(np.maximum(np.diagonal(expected.spread, axis1=1, axis2=2)[:, :2], 1e-12))
        centres = expected.values[:, :2]
        half = expected.values[:, 2:] / 2.0 if self.width > 2 else np.zeros_like(centres)
        low, high = (-0.5 - half - centres) / sd, (np.array(size) - 0.5 + half - centres) / sd
        shares = ndtr(high) - ndtr(low)
        return np.where(expected.is_known, shares.prod(axis=1), 0.0)

    def near(
        self, mean: Floats, existence: Floats, detections: Found, area_px2: float
    ) -> tuple[Floats, float]:
        """By the share of the detection that a predicted box covers in the image; of points none."""
        if self.width == 2:
            return np.zeros(len(detections.values)), 1.0
        boxes = np.ascontiguousarray(self.boxes(mean))
        return near_boxes(boxes, existence * (boxes[:, 0] != UNSEEN[0]), detections.values, area_px2)

    def learn(self, detection_model: DetectionModel, detections: Found) -> DetectionModel:
        """The sizes that detections have."""
        return detection_model if self.width == 2 else detection_model.with_sizes(detections.values)

    def log_density(self, detection_model: DetectionModel, detections: Found, area_px2: float) -> Floats:
        """Uniform over the frame, of the sizes that detections have."""
        if self.width == 2:
            return np.full(len(detections.values), -math.log(area_px2))
        return detection_model.log_density(detections.values, area_px2)

    def begin(self, motion: MotionModel, detections: Found) -> Begun:
        """States where the boxes stand, as surely as they say; none above the horizon."""
        variances = self.association.variances(detections.values)
        view, boxes, errors = self.view, detections.values, self.errors
        bias = [] if errors is None else errors.bias_of.get(view.node, [])
        bias_mean, bias_variances = np.zeros(0), np.zeros(0)
        if errors is not None and bias:
            bias_mean, spread = errors.moments(bias)
            bias_variances = np.diagonal(spread)
            sds = dict(zip("xy", np.sqrt(bias_variances).tolist(), strict=True))
            lasting = (evolve(e, sd=sds[e.axis]) if self.is_bias(e) else e for e in view.lasting)
            view, boxes = evolve(view, lasting=tuple(lasting)), boxes.copy()
            boxes[:, :2] -= bias_mean
        placed = place([view], boxes, variances, self.views.start, self.agent)
        moments = [motion.start_moments(state) for state in placed.states]
        size, first = len(motion.fields), len(motion.fields) - len(self.views.lasting)
        mean = np.array([moment for moment, _ in moments]).reshape(-1, size)
        covariance = np.array([moment for _, moment in moments]).reshape(-1, size, size)
        places = np.arange(size)[view.columns]
        covariance[:, places[:, None], places] += placed.covariances
        covariance[:, places, first:] += placed.cross
        covariance[:, first:, places] += np.swapaxes(placed.cross, 1, 2)
        mean[:, bias], covariance[:, bias, bias] = bias_mean, bias_variances
        if errors is not None:
            mean, covariance = errors.begun(self.view.node, mean, covariance)
        return Begun(placed.which, mean, covariance)

    def _distances(self, mean: Floats, covariance: Floats, detections: Found) -> tuple[Floats, Floats]:
        """(T, N) d^2, and -d^2 / 2 - log det S / 2; infinite where the camera sees nothing."""
        expected = self.expect(mean, covariance)
        cut = self._cut(detections.values)
        spread = np.where(
            expected.is_known[:, None, None], expected.spread + self._noise(expected), np.eye(self.width)
        )
        lower = np.linalg.cholesky(spread[:, None] + cut)
        offsets = detections.values[None, :, : self.width] - expected.values[:, None]
        scaled = np.linalg.solve(lower, offsets[..., None])[..., 0]
        d2 = np.where(expected.is_known[:, None], (scaled**2).sum(axis=2), np.inf)
        half = np.log(np.diagonal(lower, axis1=2, axis2=3)).sum(axis=2)
        return d2, -0.5 * d2 - half

    def check(self, mean: Floats, covariance: Floats, detections: Found, mixed: Mixed) -> dict[str, float]:
        """Innovations of detections of targets that were expected as N(mean, covariance), in a few sums.

        Innovations nu, (T, 4), have the covariance S of the prediction and the detection's error R, given the
        lasting errors of cameras b: with C = Cov(nu, b) it is S - C P_bb^-1 C'. Each pair counts with the
        probability w that the detection is the target's: the mean of w nu' S^-1 nu is then that of w times
        the degrees of freedom, where R is right. An edge that was cut takes one of those of its axis.

        `targets`: number of those expected in the image; `detections`: sum of w. Of places (x, y) and sizes
        (w, h) each: `nis`, sum of w nu' S^-1 nu; `dof`, its degrees of freedom; `noise`, the part of them
        that R is of S. `x_px`, `y_px`: mean innovation, weighted by w S^-1, and `xx`, `xy`, `yy`: the
        sums of these weights, px^-2. Empty without targets.
        """
        if not len(mean):
            return {}
        size = self.view.camera.size
        expected = self.expect(mean, covariance)
        visible = expected.is_known.copy()
        if size is not None:
            visible &= ((expected.values[:, :2] >= 0.0) & (expected.values[:, :2] < size)).all(axis=1)
        rows = np.repeat(np.arange(len(mean)), np.diff(mixed.starts))
        pairs = np.flatnonzero(expected.is_known[rows] & (mixed.weights > 0.0))
        rows, columns, weights = rows[pairs], mixed.columns[pairs], mixed.weights[pairs]
        innovations = detections.values[columns, : self.width] - expected.values[rows]
        errors = np.diagonal(self._noise(expected), axis1=1, axis2=2)[rows]
        cut = self._cut(detections.values)[columns]
        spread = expected.spread[rows] + errors[:, :, None] * np.eye(self.width) + cut
        first = mean.shape[1] - len(self.views.lasting)
        if lasting := [first + k for k, error in enumerate(self.views.lasting) if error.is_px]:
            cross, errors_of = expected.cross[rows][:, lasting], covariance[np.ix_(rows, lasting, lasting)]
            spread = spread - np.swapaxes(cross, 1, 2) @ np.linalg.solve(errors_of, cross)
        free = 1.0 * (np.diagonal(cut, axis1=1, axis2=2) == 0.0) * weights[:, None]
        precisions = free / np.diagonal(spread, axis1=1, axis2=2)
        numbers = {"targets": float(visible.sum()), "detections": float(weights.sum())}
        for part, axes in (("place", slice(0, 2)), ("size", slice(2, 4))):
            offset = innovations[:, axes]
            scaled = np.linalg.solve(spread[:, axes, axes], offset[:, :, None])[:, :, 0]
            numbers[f"{part}_nis"] = float(weights @ (offset * scaled).sum(axis=1))
            numbers[f"{part}_dof"] = float(free[:, axes].sum()) * self.share_gated
            numbers[f"{part}_noise"] = float((precisions * errors)[:, axes].sum())
        inverses = weights[:, None, None] * np.linalg.inv(spread[:, :2, :2])
        information = inverses.sum(axis=0)
        pull = np.einsum("kij,kj->i", inverses, innovations[:, :2])
        mean_px = np.linalg.solve(information, pull) if len(pairs) else np.zeros(2)
        numbers |= {"x_px": float(mean_px[0]), "y_px": float(mean_px[1])}
        numbers |= {"xx": float(information[0, 0]), "xy": float(information[0, 1])}
        numbers["yy"] = float(information[1, 1])
        return numbers

    @cached_property
    def share_gated(self) -> float:
        """E[d^2 | d^2 <= q] / K of a chi-square of K degrees that the gate cuts at q."""
        from scipy.special import gammainc

        half, degrees = chi_square_quantile(self.association.gate, self.width) / 2.0, self.width / 2
        return float(gammainc(degrees + 1, half) / gammainc(degrees, half)) if np.isfinite(half) else 1.0

    @property
    def bias_sd(self) -> float:
        """Sd of the error of the camera's calibration, px; 0 where that is exact."""
        errors = {e.axis: e.sd for e in self.view.lasting if e.node == self.view.node and e.is_px}
        return float(np.hypot(errors.get("x", 0.0), errors.get(BY_PLACE[0], 0.0)))

    def is_bias(self, error: LastingError) -> bool:
        """True of the error of the camera's calibration."""
        return error.node == self.view.node and error.is_bias

    def _noise(self, expected: Expectation) -> Floats:
        """(T, K, K) of errors that differ from frame to frame, of detections of expected boxes."""
        if self.width == 2:
            return np.tile(self.association.sd_place_px**2 * np.eye(2), (len(expected.values), 1, 1))
        return self.association.variances(expected.at_mean)[:, :, None] * np.eye(self.width)

    def _cut(self, boxes: Floats) -> Floats:
        """(N, K, K) further errors of detections that were cut at the border; of points none."""
        if self.width == 2:
            return np.zeros((len(boxes), 2, 2))
        return cut_covariance(self.view.camera, boxes)


def make_view_sensor(
    plate: CheckedTarget,
    agent: str,
    rule: AssociationRule,
    fields: tuple[str, ...],
    views: Views,
    is_one_of_several: bool,
) -> ViewSensor:
    """The sensor of an agent below a view that is given detections of boxes."""
    seen_by = plate.seen_by(agent)
    assert seen_by is not None
    view = next(entry for entry in views.views.values() if entry.seen_by == seen_by.name)
    return ViewSensor(rule, agent, fields, views, view, is_one_of_several, is_unscented(plate))
