"""The particle filter: a weighted set of hypotheses, stepped in passes over hypotheses of a frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.belief.contract import Evaluate, MotionModel, Report, Step, Stream
from bayesnet_track.belief.particles.adaptive_size import start_size
from bayesnet_track.belief.particles.importance import proposal_of
from bayesnet_track.belief.particles.map import map_index
from bayesnet_track.belief.particles.particle_set import Inputs, ParticleSet
from bayesnet_track.belief.particles.sample_size import SizeMemory
from bayesnet_track.belief.particles.weighted_sample import WeightedSample, prior_of
from bayesnet_track.graph import spec
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.numerics.records import changed

__all__ = ["Inputs", "ParticleFilter", "ParticleSet"]


class ParticleFilter:
    """The particle filter, as `settings` say: by default the bootstrap filter."""

    def __init__(self, settings: spec.Particles) -> None:
        self.settings = settings
        self._draw, self._refine = proposal_of(settings)

    def start(self, box: Floats, motion: MotionModel, stream: Stream) -> ParticleSet:
        """Equal hypotheses for a target first seen in the centre box (4,)."""
        size = start_size(self.settings)
        return ParticleSet(motion.start(box, size, stream("start")), motion.fields, LogWeights.uniform(size))

    def predict(
        self, prior: ParticleSet, motion: MotionModel, dt: float, rng: np.random.Generator
    ) -> ParticleSet:
        """The hypotheses after `dt` frame intervals, their weights as they are."""
        return replace(prior, states=motion.propagate(prior.states, dt, rng))

    def step(
        self, prior: ParticleSet, motion: MotionModel, dt: float, evaluate: Evaluate, stream: Stream
    ) -> Step[ParticleSet]:
        """The belief after `dt` frame intervals and the evidence of a frame.

        The prior weights beta are 1/N after resampling, and those of the last posterior otherwise. Evidence
        that leaves no positive, finite weight is not used: the posterior is the predicted prior.
        """
        inputs = Inputs(prior, motion, dt, evaluate, stream)
        frame = self._draw(inputs)
        if self._refine is not None:
            frame = self._refine(inputs, frame)
        step = finish_step(inputs, frame.whole, frame.size_memory, frame.reports)
        if frame.log_evidence is None or step.degenerate is not None:
            return step
        return replace(step, log_evidence=frame.log_evidence)


def finish_step(
    inputs: Inputs,
    whole: WeightedSample,
    size_memory: SizeMemory | None = None,
    reports: tuple[Report, ...] = (),
) -> Step[ParticleSet]:
    """The step that a frame's hypotheses, all passes joined, and their evidence come to."""
    beta, log_likelihood, degenerate = prior_of(whole), whole.evidence.log_likelihood, None
    try:
        with np.errstate(invalid="ignore"):  # -inf + inf is NaN, which `normalise` refuses
            weights, log_evidence = LogWeights.normalise(whole.prior_log + log_likelihood)
    except DegenerateWeights as fault:
        weights, log_evidence, degenerate = beta, -np.inf, str(fault)
        log_likelihood = np.zeros(len(whole))

    posterior = ParticleSet(whole.states, inputs.prior.fields, weights, size_memory)
    return Step(
        posterior=posterior,
        log_evidence=log_evidence,
        support=posterior,
        prior=beta,
        evidence=whole.evidence,
        find_map=FindMap(log_likelihood, whole.states, inputs),
        degenerate=degenerate,
        reports=reports,
    )


@dataclass(frozen=True, eq=False)
class FindMap:
    """() -> (D,) the one of `states` (N, D) with the largest posterior density, prior density included."""

    log_likelihood: Floats
    states: Floats
    inputs: Inputs

    def __call__(self) -> Floats:
        """The state."""
        before = self.inputs.prior
        best = map_index(
            self.log_likelihood,
            self.states,
            before.states,
            before.weights,
            self.inputs.motion,
            self.inputs.dt,
        )
        return np.asarray(self.states[best])


def reweight_step(step: Step[ParticleSet], log_likelihood: Floats) -> Step[ParticleSet]:
    """The step, had `log_likelihood` (N,) been the evidence of its hypotheses; its messages stay.

    Raises:
        DegenerateWeights: no hypothesis is left with a positive, finite weight.
    """
    weights, total = step.prior.times(log_likelihood)
    _, own = step.prior.times(step.evidence.log_likelihood)
    posterior = changed(step.posterior, weights=weights)
    find = step.find_map
    return changed(
        step,
        posterior=posterior,
        support=posterior,
        log_evidence=step.log_evidence + total - own,
        find_map=changed(find, log_likelihood=log_likelihood) if isinstance(find, FindMap) else find,
    )
