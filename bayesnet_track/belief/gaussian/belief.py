"""Gaussian belief: mean and covariance, predicted and updated by a Kalman, extended or unscented filter."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import NormalDist

import numpy as np

from bayesnet_track.belief.contract import (
    LEAST_SIDE_PX,
    Evaluate,
    Evidence,
    GroupEvidence,
    MotionModel,
    Predicted,
    Report,
    Step,
    Stream,
    WeightedStates,
    hypotheses_of,
)
from bayesnet_track.belief.gaussian.rows import Moments, stand_for_each, take_each, update_by_normals
from bayesnet_track.belief.gaussian.update import (
    Gated,
    MeasurementUpdate,
    SigmaPoints,
    fit_moments,
    is_uninformative,
    log_message,
    match_moments,
)
from bayesnet_track.belief.motion.borders import Confined, Reflecting
from bayesnet_track.belief.motion.composed import Nested, shared_columns
from bayesnet_track.belief.motion.formulas import FunctionMotion
from bayesnet_track.belief.motion.models import KinematicMotion, linear_gaussian, linear_moves
from bayesnet_track.graph import spec
from bayesnet_track.journal.events.beliefs import MeasurementGated
from bayesnet_track.journal.events.event import Event
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.distributions import gaussian_mass_in_disc
from bayesnet_track.numerics.gaussian import adopt, root, sigma_points, symmetric
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.planes import for_reading


def predict(
    mean: Floats, covariance: Floats, motion: MotionModel, dt: float, settings: spec.Gaussian
) -> tuple[Floats, Floats]:
    """Mean (D,) and covariance (D, D) after `dt` frame intervals.

    - `kalman`, `extended`: m = f(m), P = F P F' + Q, with F and Q of `motion.linearise` at m. Of a
      linear motion both are exact.
    - `unscented`: the moments of f at the sigma points (tracking chapter 3.10, first paragraph: what it
      describes there is this transform), plus Q at the mean.

    Of a motion that is confined to an image, the predicted mean is confined, and the spread of each field of
    the box is at most that of a target which may be anywhere in the image.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.gaussian import carry

    free = motion.motion if isinstance(motion, Confined) else motion
    transition, noise = free.linearise(mean, dt)
    if settings.filter == "unscented":
        mean, spread = unscented_moments(mean, covariance, free, dt, settings.sigma)
        covariance = symmetric(spread + noise)
    else:
        carried_mean, spread = np.empty(len(mean)), np.empty((len(mean), len(mean)))
        carry(for_reading(transition), plain(noise), plain(mean), plain(covariance), carried_mean, spread)
        is_linear = isinstance(free, KinematicMotion) or (
            isinstance(free, Nested) and free.moves(dt) is not None
        )
        mean = carried_mean if is_linear else free.drift(mean[None], dt)[0]
        covariance = spread
    return motion.confine_moments(mean, covariance) if isinstance(motion, Confined) else (mean, covariance)


def unscented_moments(
    mean: Floats, covariance: Floats, motion: MotionModel, dt: float, sigma: spec.Unscented
) -> tuple[Floats, Floats]:
    """Mean and covariance of f(x), x of the moments given, by the scaled unscented transform.

    The points span the directions in which x varies. Sums are taken about the central point: of small
    alpha its weight is a large negative number. Where a negative weight would leave a negative variance, the
    covariance is that about the central point (Julier and Uhlmann's form), which is never negative.
    """
    lower = root(covariance)
    width = lower.shape[1]
    if width == 0:
        return motion.drift(mean[None], dt)[0], np.zeros_like(covariance)
    scale, weights, central = unscented_weights(width, sigma)
    points = motion.drift(mean + sigma_points(width, scale) @ lower.T, dt)
    deviations = points - points[0]
    shift = weights @ deviations
    about_centre = (deviations * weights[:, None]).T @ deviations  # the central point's own weight falls out
    spread = about_centre + (central - 1.0) * np.outer(shift, shift)
    return points[0] + shift, spread if _is_positive(spread) else about_centre


def unscented_cross(
    mean: Floats, covariance: Floats, motion: MotionModel, dt: float, sigma: spec.Unscented
) -> Floats:
    """(D, D) covariance of x, of the moments given, with f(x), by the points of `unscented_moments`."""
    lower = root(covariance)
    width = lower.shape[1]
    if width == 0:
        return np.zeros_like(covariance)
    scale, weights, _ = unscented_weights(width, sigma)
    offsets = sigma_points(width, scale) @ lower.T
    points = motion.drift(mean + offsets, dt)
    return np.asarray((offsets * weights[:, None]).T @ (points - points[0]))


def cross_covariance(
    belief: GaussianPosterior, motion: MotionModel, dt: float, settings: spec.Gaussian
) -> Floats:
    """(D, D) covariance of the state with the one that it moves to."""
    free = motion.motion if isinstance(motion, Confined) else motion
    if settings.filter == "unscented":
        return unscented_cross(belief.mean, belief.covariance, free, dt, settings.sigma)
    return np.asarray(belief.covariance @ free.linearise(belief.mean, dt)[0].T)


def unscented_weights(width: int, sigma: spec.Unscented) -> tuple[float, Floats, float]:
    """Squared distance of the points, their (2 width + 1,) weights, and the central point's addition.

    The last, 1 - alpha^2 + beta, is added to the central weight in covariances only.
    """
    scale = sigma.alpha**2 * (3.0 if sigma.kappa is None else width + sigma.kappa)
    weights = np.full(2 * width + 1, 0.5 / scale)
    weights[0] = 1.0 - width / scale
    return scale, weights, 1.0 - sigma.alpha**2 + sigma.beta


def require_linear(motion: MotionModel) -> None:
    """Check that the Kalman filter is exact for a motion.

    Raises:
        ValueError: it is not linear, or its noise is not Gaussian in px.
    """
    free = motion.motion if isinstance(motion, Confined) else motion
    free = free.motion if isinstance(free, Nested) else free
    if isinstance(free, Reflecting):
        raise ValueError("the kalman filter is of linear motion; take extended or unscented beside borders")
    if isinstance(free, KinematicMotion):
        if linear_moves(free, 1.0) is None:
            linear_gaussian(free, 1.0)  # says why it is not
    elif isinstance(free, FunctionMotion):
        raise ValueError("the kalman filter is of linear motion; take extended or unscented for functions")


def _is_positive(covariance: Floats) -> bool:
    """True when no direction has a negative variance, up to rounding."""
    sds = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    scale = np.where(sds > 0, sds, 1.0)
    return bool(np.linalg.eigvalsh(symmetric(covariance / np.outer(scale, scale)))[0] > -1e-9)


@dataclass(frozen=True, eq=False)
class GaussianPosterior:
    """A normal distribution of the state.

    Attributes:
        mean: (D,), the box first, its sides at least 1 px.
        covariance: (D, D), symmetric, positive semidefinite.
        fields: names of the D columns.
        size: number of hypotheses at which it asks for likelihoods.
        measured: mean and covariance of the same state by measurements alone, which errors of cameras are
            learnt from; None where no likelihood has told more.
    """

    mean: Floats
    covariance: Floats
    fields: tuple[str, ...]
    size: int
    measured: Moments | None = None

    def __len__(self) -> int:
        return self.size

    def uncertainty(self, reference: Floats, columns: Sequence[int]) -> float:
        """UD = tr Cov + |mean - about|^2 over the columns of the state."""
        mean, point, variances = self.mean.tolist(), reference.tolist(), self.covariance.diagonal().tolist()
        return float(sum(variances[k] + (mean[k] - point[k]) ** 2 for k in columns))

    def mass_within(self, centre: Floats, radius: float) -> tuple[float, float]:
        """Mass within `radius` px of `centre` (2,), exact."""
        return gaussian_mass_in_disc(self.mean[:2] - centre, self.covariance[:2, :2], radius), math.inf

    def regions(self, shares: Sequence[float]) -> Floats:
        """(S, 4) x_low, x_high, y_low, y_high, px: the central share of the centre's weight on each axis."""
        sds, centre = np.sqrt(np.diagonal(self.covariance)[:2]), self.mean[:2]
        reach = [NormalDist().inv_cdf((1.0 + share) / 2.0) * sds for share in shares]
        return np.stack([centre - reach, centre + reach], axis=2).reshape(-1, 4)

    def draw(self, size: int, rng: np.random.Generator) -> Floats:
        """(size, 4) boxes; widths and heights at least 1 px."""
        return draw_boxes(self.mean, root(self.covariance[:4, :4]), size, rng)


def draw_boxes(mean: Floats, lower: Floats, size: int, rng: np.random.Generator) -> Floats:
    """(size, 4) draws of a Gaussian of `mean` (D,) and the root (4, K); widths and heights at least 1 px."""
    boxes = mean[:4] + rng.standard_normal((size, lower.shape[1])) @ lower.T
    np.maximum(boxes[:, 2:], 1.0, out=boxes[:, 2:])
    return np.asarray(boxes)


EvaluateEach = Callable[[Sequence[Hypotheses], Sequence[Floats]], GroupEvidence]
"""`belief.contract.Evaluate` of several targets: the hypotheses and prior log-weights of each."""


@dataclass(frozen=True)
class GaussianFilter:
    """The Kalman family, as `settings` say."""

    settings: spec.Gaussian

    def start(self, box: Floats, motion: MotionModel, stream: Stream) -> GaussianPosterior:
        """The belief about a target first seen in the centre box (4,).

        Raises:
            ValueError: the filter is `kalman` and the motion is not linear with noise in px.
        """
        if self.settings.filter == "kalman":
            require_linear(motion)
        mean, covariance = motion.start_moments(np.asarray(box, dtype=np.float64))
        return GaussianPosterior(mean, covariance, motion.fields, draws_of(self.settings, len(mean)))

    def predict(
        self, prior: GaussianPosterior, motion: MotionModel, dt: float, rng: np.random.Generator
    ) -> GaussianPosterior:
        """The belief after `dt` frame intervals without evidence; `rng` is not used."""
        mean, covariance = predict(prior.mean, prior.covariance, motion, dt, self.settings)
        predicted = posterior_of(mean, covariance, prior.fields, prior.size, motion)
        measured = prior.measured and predict(*prior.measured, motion, dt, self.settings)
        return predicted if measured is None else evolve(predicted, measured=measured)

    def step(
        self, prior: GaussianPosterior, motion: MotionModel, dt: float, evaluate: Evaluate, stream: Stream
    ) -> Step[GaussianPosterior]:
        """The belief after `dt` frame intervals and the evidence of a frame."""

        def evaluate_each(hypotheses: Sequence[Hypotheses], log: Sequence[Floats]) -> GroupEvidence:
            return GroupEvidence([evaluate(hypotheses[0], log[0])])

        return self.step_each([prior], motion, dt, evaluate_each, [stream])[0]

    def step_each(
        self,
        priors: Sequence[GaussianPosterior],
        motion: MotionModel,
        dt: float,
        evaluate_each: EvaluateEach,
        streams: Iterable[Stream],
    ) -> list[Step[GaussianPosterior]]:
        """The beliefs of several targets that move alike, after `dt` frame intervals and their evidence.

        Likelihoods first, then what was measured. The prediction stays where nothing was measured
        near it and no agent distinguishes hypotheses, or where the likelihoods leave none.
        """
        # Predict
        settings = self.settings
        predictions = [predict(prior.mean, prior.covariance, motion, dt, settings) for prior in priors]

        # Evaluate
        point_sets = stand_for_each(predictions, motion, settings, (stream("samples") for stream in streams))
        hypotheses = [hypotheses_of(points.states, motion.fields) for points in point_sets]
        together = evaluate_each(hypotheses, [points.beta.log for points in point_sets])
        evidence = together.by_target

        # Update
        weighed: list[tuple[Floats, Floats, float | str]]
        if together.choices:  # nothing was scored
            weighed = [(*moments, 0.0) for moments in predictions]
        else:
            weighed = [
                self._weigh(*row, motion) for row in zip(predictions, point_sets, evidence, strict=True)
            ]
        moments = [(mean, covariance) for mean, covariance, _ in weighed]
        measured = [
            {} if isinstance(log, str) else evidence_of_target.gaussians
            for evidence_of_target, (_, _, log) in zip(evidence, weighed, strict=True)
        ]
        is_unscented, choices = settings.filter == "unscented", together.choices
        updates = take_each(moments, motion.fields, measured, settings.gate, is_unscented, choices)
        steps = [
            self._stepped(motion, likelihood[2], start, points, evidence_of_target, end)
            for likelihood, start, points, evidence_of_target, end in zip(
                weighed, predictions, point_sets, evidence, updates, strict=True
            )
        ]
        # Update by measurements alone what errors of cameras are learnt from
        is_scored = [not (choices or is_uninformative(sampled_of(each))) for each in evidence]
        rows = zip(priors, predictions, is_scored, strict=True) if shared_columns(motion) else ()
        expected = [self._expect_unscored(*row, motion, dt) for row in rows]
        if any(expected):
            starts = [moments or start for moments, start in zip(expected, predictions, strict=True)]
            ends = take_each(starts, motion.fields, measured, settings.gate, is_unscented, choices)
            for row in [row for row, moments in enumerate(expected) if moments]:
                unscored = ends[row].mean, ends[row].covariance
                posterior = evolve(steps[row].posterior, measured=unscored)
                steps[row] = evolve(steps[row], posterior=posterior)
        return steps

    def _expect_unscored(
        self, prior: GaussianPosterior, predicted: Moments, is_scored: bool, motion: MotionModel, dt: float
    ) -> Moments | None:
        """The prediction by measurements alone, of a target of which likelihoods tell or have told more."""
        if prior.measured is not None:
            return predict(*prior.measured, motion, dt, self.settings)
        return predicted if is_scored else None

    def _weigh(
        self, predicted: tuple[Floats, Floats], points: SigmaPoints, evidence: Evidence, motion: MotionModel
    ) -> tuple[Floats, Floats, float | str]:
        """Mean, covariance and log-evidence by the likelihoods; why they cannot be used, if they cannot."""
        update = fit_moments if self.settings.likelihood == "sigma_points" else match_moments
        try:
            mean, covariance, log_evidence = update(*predicted, points, sampled_of(evidence))
        except DegenerateWeights as fault:
            return *predicted, str(fault)
        for normals in evidence.linear.values():
            updated = update_by_normals(mean, covariance, motion.fields, normals)
            mean, covariance = updated.mean, updated.covariance
            log_evidence += updated.log_likelihood
        if shared := shared_columns(motion):
            prior = predicted[0][[*shared]], predicted[1][np.ix_(shared, shared)]
            mean, covariance = adopt(mean, covariance, shared, prior)
        return mean, covariance, log_evidence

    def _stepped(
        self,
        motion: MotionModel,
        log_evidence: float | str,
        predicted: tuple[Floats, Floats],
        points: SigmaPoints,
        evidence: Evidence,
        update: MeasurementUpdate,
    ) -> Step[GaussianPosterior]:
        """The step of one target; `log_evidence` is that of the likelihoods, or why there is none."""
        fields = motion.fields
        posterior = posterior_of(update.mean, update.covariance, fields, len(points.states), motion)
        if isinstance(log_evidence, str):
            return evolve(_step(posterior, -np.inf, points, points.beta, evidence), degenerate=log_evidence)
        stepped = _step(
            posterior,
            log_evidence + update.log_evidence,
            points,
            _weights(points, evidence, update, fields),
            evidence,
            tuple(
                partial(report_gated, outlier, self.settings.gate, len(update.used))
                for outlier in update.gated
            ),
        )
        return evolve(
            stepped, predicted=(Predicted(1.0, *predicted),), log_gated=log_floors(update.gated, evidence)
        )


def sampled_of(evidence: Evidence) -> Floats:
    """(N,) the net's log-likelihood without Gaussian messages and linear factors."""
    return evidence.log_likelihood if evidence.sampled is None else evidence.sampled


def log_floors(gated: Iterable[Gated], evidence: Evidence) -> float:
    """log of the floors of what was gated out: an outlier is as probable as its agent's floor says.

    Of agents whose log-likelihood is a density.
    """
    agents = [outlier.agent for outlier in gated if outlier.agent in evidence.log_constants]
    return sum(math.log(max(evidence.gaussians[agent].floor, LEAST_FLOOR)) for agent in agents)


LEAST_FLOOR = 1e-300


def draws_of(settings: spec.Gaussian, width: int) -> int:
    """At how many hypotheses a likelihood is asked for a state of `width` fields."""
    if settings.likelihood == "sigma_points":
        return 2 * width + 1
    return max(settings.samples, 2 * (width + 1))


def posterior_of(
    mean: Floats, covariance: Floats, fields: tuple[str, ...], size: int, motion: MotionModel
) -> GaussianPosterior:
    """The Gaussian, its sides no shorter than the motion's least."""
    bounded = mean.copy()
    np.maximum(bounded[2:4], getattr(motion, "least_side", LEAST_SIDE_PX), out=bounded[2:4])
    return GaussianPosterior(bounded, covariance, fields, size)


def _weights(
    points: SigmaPoints,
    evidence: Evidence,
    update: MeasurementUpdate,
    fields: tuple[str, ...],
) -> LogWeights:
    """The hypotheses' posterior weights: by the net's messages, without measurements that were not used.

    Where all were used the weights are those of the net's own total, floors of measurements included, so that
    they compare with its messages.
    """
    if not update.gated:
        return points.beta.times(evidence.log_likelihood)[0]
    total, hypotheses = sampled_of(evidence), hypotheses_of(points.states, fields)
    for measurement in update.used.values():
        total = total + log_message(measurement, hypotheses, fields)
    for factor in evidence.linear:
        total = total + evidence.factors[factor]
    return points.beta.times(total)[0]


def _step(
    posterior: GaussianPosterior,
    log_evidence: float,
    points: SigmaPoints,
    weights: LogWeights,
    evidence: Evidence,
    reports: tuple[Report, ...] = (),
) -> Step[GaussianPosterior]:
    return Step(
        posterior=posterior,
        log_evidence=log_evidence,
        support=WeightedStates(points.states, weights),
        prior=points.beta,
        evidence=evidence,
        find_map=lambda: posterior.mean,
        reports=reports,
    )


def report_gated(outlier: Gated, gate: float, used_count: int, frame: int, target: str) -> Event:
    """The event of a measurement that was gated out, beside `used_count` that were used."""
    bounds = outlier.d2, outlier.limit, gate, outlier.degrees, outlier.turning
    return MeasurementGated(frame, target, outlier.agent, *bounds, used_count)
