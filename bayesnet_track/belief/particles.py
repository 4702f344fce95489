"""The particle belief: a weighted set of hypotheses, stepped by the bootstrap filter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Evaluate, Evidence, Motion, Stream
from bayesnet_track.belief.map import map_index
from bayesnet_track.cue import Hypotheses
from bayesnet_track.graph import spec
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


@dataclass(frozen=True, eq=False)
class Step:
    """One frame of a belief.

    Attributes:
        posterior: the belief after the frame.
        log_evidence: log sum beta L, an unbiased estimate of the frame's evidence in the natural scale;
            -inf when degenerate.
        prior: beta, the weights of the same hypotheses before the evidence.
        evidence: what the net said of them.
        map_state: (D,) maximum a posteriori hypothesis, prior density included.
        resampled: whether the hypotheses were resampled before they moved.
        degenerate: why the evidence could not be used (the posterior is the prior then), or None.
    """

    posterior: ParticleSet
    log_evidence: float
    prior: LogWeights
    evidence: Evidence
    map_state: Floats
    resampled: bool
    degenerate: str | None = None


@dataclass(frozen=True)
class ParticleFilter:
    """The bootstrap filter, as `settings` say."""

    settings: spec.Particles

    def start(self, box: Floats, motion: Motion, stream: Stream) -> ParticleSet:
        """Equal hypotheses for a target first seen in the centre box (4,)."""
        size = self.settings.size
        return ParticleSet(motion.start(box, size, stream("start")), motion.fields, LogWeights.uniform(size))

    def step(self, prior: ParticleSet, motion: Motion, dt: float, evaluate: Evaluate, stream: Stream) -> Step:
        """The belief after `dt` frame intervals and the evidence of a frame.

        The prior weights beta are 1/N after resampling, and those of the last posterior otherwise. Evidence
        that leaves no positive, finite weight is not used: the posterior is the predicted prior.
        """
        # Resample
        resampled = self._must_resample(prior)
        parents = self._resample(prior, stream("resample")) if resampled else prior
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

        best = map_index(log_likelihood, moved.states, prior.states, prior.weights, motion, dt)
        return Step(
            posterior=replace(moved, weights=weights),
            log_evidence=log_evidence,
            prior=beta,
            evidence=evidence,
            map_state=moved.states[best],
            resampled=resampled,
            degenerate=degenerate,
        )

    def _must_resample(self, prior: ParticleSet) -> bool:
        when = self.settings.when
        return not isinstance(when, spec.EssBelow) or prior.weights.ess < when.ess_below * len(prior)

    def _resample(self, prior: ParticleSet, rng: np.random.Generator) -> ParticleSet:
        size = self.settings.size
        ancestors = resample(self.settings.resample, prior.weights.weights, size, rng)
        return replace(prior, states=prior.states[ancestors], weights=LogWeights.uniform(size))
