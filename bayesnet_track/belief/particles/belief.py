"""Particle filter: a weighted set of hypotheses, stepped in passes, and its maximum a posteriori."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesnet_track.belief.contract import Evaluate, MotionModel, Report, Step, Stream
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.jumps import modal_of
from bayesnet_track.belief.motion.models import KinematicMotion
from bayesnet_track.belief.motion.modes import FIELD, Modal
from bayesnet_track.belief.particles.adaptive_size import formulas_in, start_size, static_fields
from bayesnet_track.belief.particles.importance import proposal_of
from bayesnet_track.belief.particles.particle_set import Inputs, ParticleSet
from bayesnet_track.belief.particles.sample_size import SizeMemory, WeightedSample, prior_of
from bayesnet_track.graph import spec
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.density import mixture_argmax
from bayesnet_track.numerics.gaussian import root, weighted_moments
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.numerics.records import evolve
from bayesnet_track.numerics.resampling import systematic

LEAST = 0.1
"""Covariances are enlarged tenfold at most, where one hypothesis has nearly all of the weight."""


def shrink_constants(prior: ParticleSet, motion: MotionModel, stream: Stream) -> ParticleSet:
    """The belief resampled, with its unknown constants spread anew; itself where there is no discount.

    Mean and covariance of the constants are kept, and with them what was learnt. They are spread after new
    parents are drawn, so that the frame's evidence compares as many values as there are hypotheses.
    """
    motions = list(formulas_in(motion))
    discounts = [part.static_discount for part in motions if part.static_discount is not None]
    names = static_fields(motion)
    if not discounts or not names:
        return prior
    shrinkage = (3.0 * min(discounts) - 1.0) / (2.0 * min(discounts))
    columns = np.array([prior.fields.index(name) for name in names])
    weights, size = prior.weights.weights, len(prior)
    parents = systematic(weights, size, stream("constants of parents"))
    states, rng = prior.states[parents], stream("constants")
    has_modes = prior.fields[-1] == FIELD
    modes, prior_modes = (sample[:, -1] if has_modes else np.zeros(size) for sample in (states, prior.states))
    for mode in np.unique(modes):
        rows, mode_weights = np.flatnonzero(modes == mode), weights * (prior_modes == mode)
        mode_weights = mode_weights / mode_weights.sum()
        mean, covariance = weighted_moments(prior.states[:, columns], mode_weights)
        unbiased = 1.0 / max(1.0 - float(mode_weights @ mode_weights), LEAST)
        lower = root(covariance * (unbiased - shrinkage**2))
        spread = rng.standard_normal((len(rows), lower.shape[1])) @ lower.T
        block = np.ix_(rows, columns)
        states[block] = shrinkage * states[block] + (1.0 - shrinkage) * mean + spread
    return replace(prior, states=states, weights=LogWeights.uniform(size))


Prior = tuple[Floats, LogWeights]
"""The belief before the motion: (K, D) states and their weights, normalised or not."""


def map_index(
    log_likelihood: Floats,
    states: Floats,
    parents: Floats,
    weights: LogWeights,
    motion: MotionModel,
    dt: float,
) -> int:
    """argmax_i L(x_i) sum_k beta_k p(x_i | x_k): the hypothesis of the largest posterior density.

    The hypothesis of the largest weight is the maximum *likelihood* one when hypotheses come from the prior
    with equal weights (thesis 2.5, corrected).

    Args:
        log_likelihood: (N,) log L, finite or -inf.
        states: (N, D) hypotheses, after the motion.
        parents: (K, D) the belief before the motion.
        weights: beta, its K weights.
        motion: what leads from parents to states.
        dt: the time between, in frame intervals.
    """
    modal = modal_of(motion)
    if modal is not None:
        return _index_of_modes(log_likelihood, states, (parents, weights), modal, dt)
    return _index(log_likelihood, states, (parents, weights), motion, dt)


def _index_of_modes(log_likelihood: Floats, states: Floats, prior: Prior, modal: Modal, dt: float) -> int:
    """The best of the hypotheses of each mode, then the best of these."""
    parents, weights = prior
    modes, parent_states = states[:, -1].astype(np.intp), np.ascontiguousarray(parents[:, :-1])
    with np.errstate(divide="ignore"):
        log_chain = np.log(modal.chain.over(dt))[parents[:, -1].astype(np.intp)]
    indices, values = [], []
    for mode, motion in enumerate(modal.motions):
        rows = np.flatnonzero(modes == mode)
        if not len(rows):
            continue
        mode_states, log_before = np.ascontiguousarray(states[rows, :-1]), weights.log + log_chain[:, mode]
        index = _index(log_likelihood[rows], mode_states, (parent_states, LogWeights(log_before)), motion, dt)
        density = motion.log_density(mode_states[index : index + 1], parent_states, dt)[0] + log_before
        indices.append(int(rows[index]))
        values.append(float(log_likelihood[rows[index]] + np.logaddexp.reduce(density)))
    return indices[int(np.argmax(values))]


def _index(log_likelihood: Floats, states: Floats, prior: Prior, motion: MotionModel, dt: float) -> int:
    parents, weights = prior
    transition = motion.transition(parents, dt)
    points, log_jacobian = transition.coordinates(states)
    components, width = transition.sds.shape[0], points.shape[1]
    log_weights = (transition.log_shares[:, None] + weights.log).ravel()
    means = transition.means if components == 1 else np.concatenate([transition.means] * components)
    sds = transition.sds.reshape(len(means), width)
    return mixture_argmax(log_likelihood + log_jacobian, points, log_weights, means, sds)


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
        inputs = Inputs(shrink_constants(prior, motion, stream), motion, dt, evaluate, stream)
        frame = self._draw(inputs)
        if self._refine is not None:
            frame = self._refine(inputs, frame)
        step = finish_step(inputs, frame.whole, frame.size_memory, frame.reports)
        if frame.log_evidence is None or step.degenerate is not None:
            return step
        return replace(step, log_evidence=frame.log_evidence)


def finish_step(
    inputs: Inputs,
    sample: WeightedSample,
    size_memory: SizeMemory | None = None,
    reports: tuple[Report, ...] = (),
) -> Step[ParticleSet]:
    """The step that a frame's hypotheses, all passes joined, and their evidence come to."""
    beta, log_likelihood, degenerate = prior_of(sample), sample.evidence.log_likelihood, None
    try:
        with np.errstate(invalid="ignore"):  # -inf + inf is NaN, which `normalise` refuses
            weights, log_evidence = LogWeights.normalise(sample.prior_log + log_likelihood)
    except DegenerateWeights as fault:
        weights, log_evidence, degenerate = beta, -np.inf, str(fault)
        log_likelihood = np.zeros(len(sample))

    posterior = ParticleSet(sample.states, inputs.prior.fields, weights, size_memory)
    return Step(
        posterior=posterior,
        log_evidence=log_evidence,
        support=posterior,
        prior=beta,
        evidence=sample.evidence,
        find_map=FindMap(log_likelihood, sample.states, inputs),
        degenerate=degenerate,
        reports=reports,
        ancestors=sample.ancestors,
    )


@dataclass(frozen=True, eq=False)
class FindMap:
    """() -> (D,) the one of `states` (N, D) with the largest posterior density, prior density included."""

    log_likelihood: Floats
    states: Floats
    inputs: Inputs

    def __call__(self) -> Floats:
        """The state."""
        prior = self.inputs.prior
        index = map_index(
            self.log_likelihood,
            self.states,
            prior.states,
            prior.weights,
            self.inputs.motion,
            self.inputs.dt,
        )
        return np.asarray(self.states[index])


def reweight_step(step: Step[ParticleSet], log_likelihood: Floats) -> Step[ParticleSet]:
    """The step, had `log_likelihood` (N,) been the evidence of its hypotheses; its messages stay.

    Raises:
        DegenerateWeights: no hypothesis is left with a positive, finite weight.
    """
    weights, total = step.prior.times(log_likelihood)
    _, step_total = step.prior.times(step.evidence.log_likelihood)
    posterior = evolve(step.posterior, weights=weights)
    find = step.find_map
    return evolve(
        step,
        posterior=posterior,
        support=posterior,
        log_evidence=step.log_evidence + total - step_total,
        find_map=evolve(find, log_likelihood=log_likelihood) if isinstance(find, FindMap) else find,
    )


def find_map_states(steps: Iterable[Step[Any]]) -> None:
    """Find `map_state` of the steps of particle filters that share a motion, before anybody asks for it.

    Other steps find theirs when they are asked. Every row of states moves by itself, so that the states of
    several targets can stand below each other.
    """
    groups: dict[Hashable, list[tuple[Step[Any], FindMap]]] = {}
    for step in steps:
        find = step.find_map
        if not isinstance(find, FindMap) or "map_state" in step.__dict__:
            continue
        motion = find.inputs.motion
        inner = motion.motion if isinstance(motion, Confined) else motion
        if isinstance(inner, KinematicMotion):
            key = (inner, find.inputs.dt, find.states.shape, find.inputs.prior.states.shape)
            groups.setdefault(key, []).append((step, find))
    for group in groups.values():
        _find(group)


def _find(group: list[tuple[Step[Any], FindMap]]) -> None:
    finds = [find for _, find in group]
    inputs = finds[0].inputs
    priors = Before(
        np.array([find.inputs.prior.states for find in finds]),
        np.array([find.inputs.prior.weights.log for find in finds]),
    )
    log_likelihoods = np.array([find.log_likelihood for find in finds])
    states = np.array([find.states for find in finds])
    indices = find_places(inputs.motion, inputs.dt, priors, log_likelihoods, states)
    for (step, find), place in zip(group, indices.tolist(), strict=True):
        if place >= 0:  # else all densities are 0 in floating point, and the step looks further
            step.__dict__["map_state"] = find.states[place]


@dataclass(frozen=True, eq=False)
class Before:
    """The beliefs of T targets before they moved: states (T, K, D) and log-weights (T, K)."""

    states: Floats
    log: Floats


def find_places(
    motion: MotionModel, dt: float, prior: Before, log_likelihoods: Floats, states: Floats
) -> Ints:
    """(T,) index of the MAP of each target among hypotheses (T, N, D) of `log_likelihoods` (T, N).

    -1 where all densities are 0 in floating point. The motion is that of a `KinematicMotion`.
    """
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.density import likeliest_of_each

    (count, size), prior_size = states.shape[:2], prior.states.shape[1]
    transition = motion.transition(prior.states.reshape(count * prior_size, -1), dt)
    points, log_jacobian = transition.coordinates(states.reshape(count * size, -1))
    components, width = transition.sds.shape[0], points.shape[1]
    log_weights = transition.log_shares[:, None] + prior.log[:, None]
    means = np.broadcast_to(
        transition.means.reshape(count, 1, prior_size, width), (count, components, prior_size, width)
    )
    sds = transition.sds.reshape(components, count, prior_size, width).swapaxes(0, 1)
    return likeliest_of_each(
        log_likelihoods + log_jacobian.reshape(count, size),
        np.ascontiguousarray(points).reshape(count, size, width),
        log_weights.reshape(count, -1),
        plain(means).reshape(count, -1, width),
        1.0 / np.ascontiguousarray(sds).reshape(count, -1, width),
    )
