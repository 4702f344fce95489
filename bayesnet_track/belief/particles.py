"""The particle belief: a weighted set of hypotheses, stepped by the bootstrap filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Evaluate, Motion, Step, Stream
from bayesnet_track.belief.map import map_index
from bayesnet_track.cue import Hypotheses
from bayesnet_track.graph import spec
from bayesnet_track.numerics.divergence import uncertainty_deviation
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.numerics.resampling import resample

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ParticleSet:
    """N weighted hypotheses.

    Attributes:
        states: (N, D) float64, the box (x, y, w, h; centre, px) first.
        fields: names of the D columns.
        weights: their normalised log-weights.
    """

    states: Floats
    fields: tuple[str, ...]
    weights: LogWeights

    def __len__(self) -> int:
        return int(self.states.shape[0])

    @property
    def boxes(self) -> Floats:
        """(N, 4) centre boxes."""
        return self.states[:, :4]

    @property
    def hypotheses(self) -> Hypotheses:
        """What cues see of it: the boxes, and the further fields by name."""
        further = {name: self.states[:, k] for k, name in enumerate(self.fields) if k >= 4}
        return Hypotheses(self.boxes, further)

    @property
    def mean(self) -> Floats:
        """(D,) weighted mean, which lies between the modes of a bimodal belief."""
        return np.asarray(self.weights.weights @ self.states)

    @property
    def covariance(self) -> Floats:
        """(D, D) sum w (x - mean)(x - mean)'; zeros when one hypothesis holds all weight.

        Without the correction for degrees of freedom, which divides by zero there.
        """
        weights = self.weights.weights
        away = self.states - weights @ self.states
        return np.asarray((away * weights[:, None]).T @ away)

    def uncertainty(self, about: Floats, columns: Sequence[int]) -> float:
        """UD = sum w |s - about|^2 over the columns of the state."""
        chosen = list(columns)
        return uncertainty_deviation(self.states[:, chosen], self.weights.weights, about[chosen])

    def region(self, share: float) -> tuple[float, float, float, float]:
        """x_low, x_high, y_low, y_high in px: the central `share` of the centre's weight on each axis."""
        weights = self.weights.weights
        tails = np.array([(1.0 - share) / 2.0, (1.0 + share) / 2.0])
        x_low, x_high = weighted_quantiles(self.states[:, 0], weights, tails)
        y_low, y_high = weighted_quantiles(self.states[:, 1], weights, tails)
        return x_low, x_high, y_low, y_high

    def draw(self, size: int, rng: np.random.Generator) -> Floats:
        """(size, 4) boxes of hypotheses, drawn systematically."""
        return self.boxes[resample("systematic", self.weights.weights, size, rng)]


def weighted_quantiles(values: Floats, weights: Floats, shares: Floats) -> tuple[float, ...]:
    """The least value that has at least the share of the weight up to it, for each share."""
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    found = np.searchsorted(cumulative, shares * cumulative[-1])
    return tuple(float(q) for q in values[order][found])


def map_state(
    log_likelihood: Floats, states: Floats, before: ParticleSet, motion: Motion, dt: float
) -> Floats:
    """(D,) the one of `states` (N, D) with the largest posterior density, prior density included."""
    return np.asarray(states[map_index(log_likelihood, states, before.states, before.weights, motion, dt)])


@dataclass(frozen=True)
class ParticleFilter:
    """The bootstrap filter, as `settings` say."""

    settings: spec.Particles

    def start(self, box: Floats, motion: Motion, stream: Stream) -> ParticleSet:
        """Equal hypotheses for a target first seen in the centre box (4,)."""
        size = self.settings.size
        return ParticleSet(motion.start(box, size, stream("start")), motion.fields, LogWeights.uniform(size))

    def step(
        self, prior: ParticleSet, motion: Motion, dt: float, evaluate: Evaluate, stream: Stream
    ) -> Step[ParticleSet]:
        """The belief after `dt` frame intervals and the evidence of a frame.

        The prior weights beta are 1/N after resampling, and those of the last posterior otherwise. Evidence
        that leaves no positive, finite weight is not used: the posterior is the predicted prior.
        """
        # Resample
        parents = self._resample(prior, stream("resample")) if self._must_resample(prior) else prior
        beta = parents.weights

        # Propagate
        moved = replace(parents, states=motion.propagate(parents.states, dt, stream("propagate")))

        # Evaluate
        evidence = evaluate(moved.hypotheses, beta.log)

        # Reweight
        log_likelihood, degenerate = evidence.log_likelihood, None
        try:
            with np.errstate(invalid="ignore"):  # -inf + inf is NaN, which `times` refuses
                weights, log_evidence = beta.times(log_likelihood)
        except DegenerateWeights as fault:
            weights, log_evidence, degenerate = beta, -np.inf, str(fault)
            log_likelihood = np.zeros(len(moved))

        posterior = replace(moved, weights=weights)
        return Step(
            posterior=posterior,
            log_evidence=log_evidence,
            support=posterior,
            prior=beta,
            evidence=evidence,
            find_map=partial(map_state, log_likelihood, moved.states, prior, motion, dt),
            degenerate=degenerate,
        )

    def _must_resample(self, prior: ParticleSet) -> bool:
        when = self.settings.when
        return not isinstance(when, spec.EssBelow) or prior.weights.ess < when.ess_below * len(prior)

    def _resample(self, prior: ParticleSet, rng: np.random.Generator) -> ParticleSet:
        size = self.settings.size
        ancestors = resample(self.settings.resample, prior.weights.weights, size, rng)
        return replace(prior, states=prior.states[ancestors], weights=LogWeights.uniform(size))
