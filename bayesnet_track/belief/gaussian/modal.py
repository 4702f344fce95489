"""Interacting multiple model: a Gaussian for each mode, mixed before every prediction.

Blom and Bar-Shalom 1988. Exact would be a Gaussian for each sequence of modes, K^t of them after t frames.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from statistics import NormalDist

import numpy as np

from bayesnet_track.belief.contract import (
    Evaluate,
    Evidence,
    MotionModel,
    Predicted,
    Report,
    Step,
    Stream,
    WeightedStates,
    hypotheses_of,
)
from bayesnet_track.belief.gaussian.belief import (
    GaussianPosterior,
    draws_of,
    log_floors,
    predict,
    report_gated,
    require_linear,
)
from bayesnet_track.belief.gaussian.rows import stand_for_each, take
from bayesnet_track.belief.gaussian.update import (
    Gated,
    SigmaPoints,
    fit_moments,
    match_moments,
    update_by,
)
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.modes import FIELD, Modal, Modes
from bayesnet_track.graph import spec
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import symmetric
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.observation.cue import Measurement


@dataclass(frozen=True, eq=False)
class ModalPosterior:
    """A mixture of K Gaussians, one for each mode.

    Attributes:
        parts: the Gaussian of the state in each mode.
        mode_probabilities: (K,) of the modes.
    """

    parts: tuple[GaussianPosterior, ...]
    mode_probabilities: Floats

    def __len__(self) -> int:
        return sum(len(part) for part in self.parts)

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the D columns, without the mode."""
        return self.parts[0].fields

    @cached_property
    def mean(self) -> Floats:
        """(D,) of the mixture."""
        return np.asarray(self.mode_probabilities @ np.array([part.mean for part in self.parts]))

    @cached_property
    def covariance(self) -> Floats:
        """(D, D) of the mixture: within modes, and between them."""
        return mixture_moments(
            np.array([part.mean for part in self.parts]),
            np.array([part.covariance for part in self.parts]),
            self.mode_probabilities,
        )[1]

    def uncertainty(self, reference: Floats, columns: Sequence[int]) -> float:
        """UD of the mixture."""
        uds = [part.uncertainty(reference, columns) for part in self.parts]
        return float(self.mode_probabilities @ np.array(uds))

    def mass_within(self, centre: Floats, radius: float) -> tuple[float, float]:
        """Mass within `radius` px of `centre` (2,), exact."""
        shares = [part.mass_within(centre, radius)[0] for part in self.parts]
        return float(self.mode_probabilities @ np.array(shares)), float("inf")

    def regions(self, shares: Sequence[float]) -> Floats:
        """(S, 4) x_low, x_high, y_low, y_high, px: the central share of the centre's weight on each axis."""
        tails = [((1.0 - share) / 2.0, (1.0 + share) / 2.0) for share in shares]
        bounds = [[self._quantiles(axis, pair) for axis in (0, 1)] for pair in tails]
        return np.array(bounds).reshape(-1, 4)

    def draw(self, size: int, rng: np.random.Generator) -> Floats:
        """(size, 4) boxes."""
        counts = rng.multinomial(size, self.mode_probabilities / self.mode_probabilities.sum())
        boxes = [part.draw(int(count), rng) for part, count in zip(self.parts, counts, strict=True)]
        return np.concatenate(boxes)

    def _quantiles(self, axis: int, tails: tuple[float, float]) -> tuple[float, float]:
        """By bisection of the mixture's distribution function."""
        means = [float(part.mean[axis]) for part in self.parts]
        sds = [max(float(np.sqrt(max(part.covariance[axis, axis], 0.0))), 1e-9) for part in self.parts]
        normals = [NormalDist(mean, sd) for mean, sd in zip(means, sds, strict=True)]
        weights = self.mode_probabilities.tolist()
        quantiles = []
        for tail in tails:
            low = min(normal.inv_cdf(tail) for normal in normals)
            high = max(normal.inv_cdf(tail) for normal in normals)
            for _ in range(60):
                middle = 0.5 * (low + high)
                mass = sum(w * normal.cdf(middle) for w, normal in zip(weights, normals, strict=True))
                low, high = (middle, high) if mass < tail else (low, middle)
            quantiles.append(0.5 * (low + high))
        return quantiles[0], quantiles[1]


def mix(prior: ModalPosterior, chain: Floats) -> ModalPosterior:
    """The Gaussian of each mode before it moves: those of all modes that can lead to it, moments matched.

    Mode j is entered from i with probability P_ij mu_i / c_j, where c_j = sum_i P_ij mu_i. Where modes that
    share what follows would be mixed alike, so is everything: no sequence is kept apart.
    """
    joint = chain * prior.mode_probabilities[:, None]
    entered = joint.sum(axis=0)
    means = np.array([part.mean for part in prior.parts])
    covariances = np.array([part.covariance for part in prior.parts])
    parts = []
    for mode, total in enumerate(entered):
        if total <= 0.0:  # no mode leads here
            parts.append(prior.parts[mode])
            continue
        mean, covariance = mixture_moments(means, covariances, joint[:, mode] / total)
        parts.append(replace(prior.parts[mode], mean=mean, covariance=covariance))
    return ModalPosterior(tuple(parts), np.asarray(entered / entered.sum()))


def mixture_moments(means: Floats, covariances: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """(D,) and (D, D) of a mixture of Gaussians of means (K, D), covariances (K, D, D), weights (K,)."""
    mean = weights @ means
    deviations = means - mean
    mean_covariance = np.tensordot(weights, covariances, 1)
    return np.asarray(mean), symmetric(mean_covariance + (deviations * weights[:, None]).T @ deviations)


@dataclass(frozen=True)
class ModalFilter:
    """The Kalman family in modes, as `settings` and `modes` say."""

    settings: spec.Gaussian
    modes: Modes

    def start(self, box: Floats, motion: MotionModel, stream: Stream) -> ModalPosterior:
        """The belief about a target first seen in the centre box (4,).

        Raises:
            ValueError: the filter is `kalman` and a mode's motion is not linear with noise in px.
        """
        modal = modal_in(motion)
        if self.settings.filter == "kalman":
            for part in modal.parts:
                require_linear(part)
        mean, covariance = modal.start_moments(np.asarray(box, dtype=np.float64))
        gaussian = GaussianPosterior(
            mean, covariance, modal.motions[0].fields, draws_of(self.settings, len(mean))
        )
        return ModalPosterior((gaussian,) * len(self.modes), self.modes.start())

    def predict(
        self, prior: ModalPosterior, motion: MotionModel, dt: float, rng: np.random.Generator
    ) -> ModalPosterior:
        """The belief after `dt` frame intervals without evidence; `rng` is not used."""
        mixed = mix(prior, self.modes.chain.over(dt))
        parts = zip(mixed.parts, motions_of(motion), strict=True)
        return replace(
            mixed, parts=tuple(self._predict(part, mode_motion, dt) for part, mode_motion in parts)
        )

    def step(
        self, prior: ModalPosterior, motion: MotionModel, dt: float, evaluate: Evaluate, stream: Stream
    ) -> Step[ModalPosterior]:
        """The belief after `dt` frame intervals and the evidence of a frame.

        A measurement is gated by all modes together: it is used when it lies inside the gate of a mode in
        which the target is seen, and counts as missed otherwise.
        """
        predicted = self.predict(prior, motion, dt, stream("predict"))
        motions = motions_of(motion)
        point_sets = [
            stand_for_each(
                [(part.mean, part.covariance)], mode_motion, self.settings, [stream(f"samples {number}")]
            )[0]
            for number, (part, mode_motion) in enumerate(zip(predicted.parts, motions, strict=True))
        ]
        together = _together(point_sets, predicted.mode_probabilities)
        evidence = evaluate(hypotheses_of(together.states, (*predicted.fields, FIELD)), together.weights.log)
        accepted, gated = self._gate(predicted, evidence)
        log_gated = self._log_gated(gated, evidence, together.states[:, -1])
        sampled = evidence.log_likelihood if evidence.sampled is None else evidence.sampled
        shared = {agent: measurement for agent, measurement in accepted.items() if measurement.choices}
        mode_choices, log_chosen = self._choose(predicted, shared)
        accepted = {agent: measurement for agent, measurement in accepted.items() if agent not in shared}
        log_labels = self._log_labels(accepted)
        parts, log_evidence = [], np.empty(len(point_sets))
        ends = np.cumsum([len(points.states) for points in point_sets])
        for mode, (part, points, end) in enumerate(zip(predicted.parts, point_sets, ends, strict=True)):
            log_likelihood = sampled[end - len(points.states) : end] + log_gated[mode]
            own_choices = take(part.mean, part.covariance, part.fields, mode_choices[mode], 1.0)
            part = replace(part, mean=own_choices.mean, covariance=own_choices.covariance)
            measurements = {
                agent: measurement.in_mode(mode)
                for agent, measurement in accepted.items()
                if not self.modes.hidden[mode]
            }
            updated, log_evidence[mode] = self._update(part, points, log_likelihood, measurements)
            log_evidence[mode] += log_chosen[mode] + log_labels[mode]
            parts.append(updated)
        with np.errstate(divide="ignore"):
            log_prior = np.log(predicted.mode_probabilities)
        try:
            weights, total = LogWeights.normalise(log_prior + log_evidence)
        except DegenerateWeights as fault:
            step = _step(predicted, -np.inf, together, together.weights, evidence)
            return replace(step, degenerate=str(fault))
        posterior = ModalPosterior(tuple(parts), np.array(weights.weights))
        reports = tuple(
            partial(report_gated, outlier, self.settings.gate, len(accepted) + len(shared))
            for outlier in gated
        )
        try:
            support_weights = together.weights.times(evidence.log_likelihood)[0]
        except DegenerateWeights:
            support_weights = together.weights
        visible = tuple(
            Predicted(0.0 if hidden else float(share), part.mean, part.covariance)
            for part, share, hidden in zip(
                predicted.parts, predicted.mode_probabilities, self.modes.hidden, strict=True
            )
        )
        step = _step(posterior, total, together, support_weights, evidence, reports)
        # Where it can hide, what lies outside of every gate is weighed as of the background.
        floors = 0.0 if self.modes.can_hide else log_floors(gated, evidence)
        return replace(step, predicted=visible, log_gated=floors)

    def _predict(self, part: GaussianPosterior, motion: MotionModel, dt: float) -> GaussianPosterior:
        mean, covariance = predict(part.mean, part.covariance, motion, dt, self.settings)
        return replace(part, mean=_bound_size(mean), covariance=covariance)

    def _update(
        self,
        part: GaussianPosterior,
        points: SigmaPoints,
        sampled: Floats,
        measurements: Mapping[str, Measurement],
    ) -> tuple[GaussianPosterior, float]:
        """The Gaussian of a mode after the frame, and its log-evidence; -inf where nothing fits it."""
        update = fit_moments if self.settings.likelihood == "sigma_points" else match_moments
        try:
            mean, covariance, log_evidence = update(part.mean, part.covariance, points, sampled)
        except DegenerateWeights:
            return part, -np.inf
        updated = take(mean, covariance, part.fields, measurements, 1.0, self.settings.filter == "unscented")
        posterior = replace(part, mean=_bound_size(updated.mean), covariance=updated.covariance)
        return posterior, log_evidence + updated.log_evidence

    def _log_labels(self, measurements: Mapping[str, Measurement]) -> Floats:
        """(K,) log-probability of the labels of what was measured, in each mode."""
        log = np.zeros(len(self.modes))
        for measurement in measurements.values():
            if measurement.label is not None:
                log_label = measurement.label.of(self.modes.index)
                log += np.where(self.modes.hidden, measurement.label.log_nobody, log_label)
        return log

    def _choose(
        self, predicted: ModalPosterior, shared: Mapping[str, Measurement]
    ) -> tuple[list[dict[str, Measurement]], Floats]:
        """Shares of each mode in detections that may be the target's, and (K,) its log-evidence by them.

        The weights are those of the association, w_j of detection j and w_0 of none. Given j, mode m has the
        probability mu_m N_m(z_j) / sum; given none, mu_m q_m / sum, q_m the probability that it is missed. So
        the mode has sum_j w_j P(m | j), and in it detection j the weight w_j P(m | j) / P(m).
        """
        prior, hidden = predicted.mode_probabilities, np.array(self.modes.hidden)
        mode_measurements: list[dict[str, Measurement]] = [{} for _ in predicted.parts]
        log = np.zeros(len(prior))
        for agent, measurement in shared.items():
            weights = np.array([measurement.missed, *(weight for weight, _ in measurement.choices)])
            fit = np.zeros((len(prior), len(weights)))
            fit[:, 0] = np.where(hidden, 1.0, self.modes.missed if self.modes.can_hide else 1.0)
            for mode in np.flatnonzero(~hidden).tolist():
                part = predicted.parts[mode]
                fit[mode, 1:] = [
                    np.exp(update.log_likelihood + self._log_labels({agent: choice})[mode])
                    for _, choice in measurement.choices
                    if (update := update_by(part.mean, part.covariance, part.fields, choice)) is not None
                ]
            joint = prior[:, None] * fit
            total = joint.sum(axis=0)
            # What no mode explains says nothing of the mode.
            share = weights * np.where(total > 0.0, joint / np.where(total > 0.0, total, 1.0), prior[:, None])
            posterior = share.sum(axis=1)
            with np.errstate(divide="ignore"):
                log += np.log(posterior) - np.log(prior) + np.log(max(float(weights @ total), 1e-300))
            for mode, mode_shares in enumerate(share):
                if hidden[mode] or posterior[mode] <= 0.0:
                    continue
                choices = tuple(
                    (float(weight / posterior[mode]), choice)
                    for weight, (_, choice) in zip(mode_shares[1:], measurement.choices, strict=True)
                )
                mode_measurements[mode][agent] = replace(measurement, choices=choices)
        return mode_measurements, log

    def _gate(
        self, predicted: ModalPosterior, evidence: Evidence
    ) -> tuple[dict[str, Measurement], tuple[Gated, ...]]:
        """Measurements inside the gate of a visible mode, and the rest as the nearest mode has it."""
        nearest: dict[str, Gated] = {}
        accepted: dict[str, Measurement] = {}
        of_modes = zip(predicted.parts, self.modes.hidden, predicted.mode_probabilities, strict=True)
        for mode, (part, hidden, share) in enumerate(of_modes):
            if hidden or share <= 0.0:
                continue
            is_unscented = self.settings.filter == "unscented"
            update = take(
                part.mean,
                part.covariance,
                part.fields,
                {agent: measurement.in_mode(mode) for agent, measurement in evidence.gaussians.items()},
                self.settings.gate,
                is_unscented,
            )
            accepted |= update.used
            for outlier in update.gated:
                if outlier.agent not in nearest or outlier.d2 < nearest[outlier.agent].d2:
                    nearest[outlier.agent] = outlier
        measurements = {
            agent: measurement for agent, measurement in evidence.gaussians.items() if agent in accepted
        }
        return measurements, tuple(outlier for agent, outlier in nearest.items() if agent not in accepted)

    def _log_gated(self, gated: Sequence[Gated], evidence: Evidence, modes: Floats) -> Floats:
        """(K,) a measurement outside of every gate is of the background, and the target was missed."""
        if not self.modes.can_hide:
            return np.zeros(len(self.modes))
        row = int(np.argmax(np.isin(modes, np.flatnonzero(self.modes.hidden))))
        odds = np.log(self.modes.missed) - np.log1p(-self.modes.missed)
        total = sum(float(evidence.messages[outlier.agent][row]) + odds for outlier in gated)
        return np.where(self.modes.hidden, 0.0, total)


def modal_in(motion: MotionModel) -> Modal:
    """The motion in modes, also inside a confined one.

    Raises:
        TypeError: it has no modes.
    """
    free = motion.motion if isinstance(motion, Confined) else motion
    if not isinstance(free, Modal):
        raise TypeError(f"a {type(free).__name__} has no modes")
    return free


def motions_of(motion: MotionModel) -> tuple[MotionModel, ...]:
    """Motions of the target in each mode, confined where the motion is."""
    modal = modal_in(motion)
    if isinstance(motion, Confined):
        return tuple(replace(motion, motion=part) for part in modal.motions)
    return modal.motions


def _bound_size(mean: Floats) -> Floats:
    bounded = mean.copy()
    np.maximum(bounded[2:4], 1.0, out=bounded[2:4])
    return bounded


def _together(point_sets: Sequence[SigmaPoints], shares: Floats) -> WeightedStates:
    """The hypotheses of all modes, the mode their last field, weighted by how probable it is predicted."""
    with np.errstate(divide="ignore"):
        log = [points.beta.log + share for points, share in zip(point_sets, np.log(shares), strict=True)]
    states = [
        np.concatenate([points.states, np.full((len(points.states), 1), float(mode))], axis=1)
        for mode, points in enumerate(point_sets)
    ]
    return WeightedStates(np.concatenate(states), LogWeights.normalise(np.concatenate(log))[0])


def _step(
    posterior: ModalPosterior,
    log_evidence: float,
    together: WeightedStates,
    weights: LogWeights,
    evidence: Evidence,
    reports: tuple[Report, ...] = (),
) -> Step[ModalPosterior]:
    mode = int(np.argmax(posterior.mode_probabilities))
    return Step(
        posterior=posterior,
        log_evidence=log_evidence,
        support=WeightedStates(np.ascontiguousarray(together.states[:, :-1]), weights),
        prior=together.weights,
        evidence=evidence,
        find_map=lambda: posterior.parts[mode].mean,
        reports=reports,
    )
