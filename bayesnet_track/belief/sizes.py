"""The first pass of a frame: how many hypotheses are drawn from the motion model, and from which parents."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Report
from bayesnet_track.belief.particle_set import Inputs, ParticleSet, hypotheses_of
from bayesnet_track.belief.passes import Pass
from bayesnet_track.graph import spec
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.numerics.resampling import resample

Floats = NDArray[np.float64]
Ancestors = NDArray[np.intp]


def start_size(settings: spec.Particles) -> int:
    """How many hypotheses a target starts with."""
    return settings.size


def first_pass(settings: spec.Particles, inputs: Inputs) -> tuple[Pass, tuple[Report, ...]]:
    """Hypotheses drawn from the motion model with their evidence, and what is to be told of their number."""
    return _fixed(settings, inputs, settings.size), ()


def _fixed(settings: spec.Particles, inputs: Inputs, size: int) -> Pass:
    prior = inputs.prior
    if must_resample(settings, prior):
        ancestors, beta = parents(settings, inputs, size, "resample"), LogWeights.uniform(size)
    else:
        ancestors, beta = np.arange(len(prior)), prior.weights
    return evaluated(inputs, moved(inputs, ancestors, "propagate"), beta.log, ancestors)


def must_resample(settings: spec.Particles, prior: ParticleSet) -> bool:
    """True when the settings ask for new parents, given the weights of the last posterior."""
    when = settings.when
    return not isinstance(when, spec.EssBelow) or prior.weights.ess < when.ess_below * len(prior)


def parents(settings: spec.Particles, inputs: Inputs, size: int, purpose: str) -> Ancestors:
    """(size,) indices of hypotheses of the prior, each drawn `size` times its weight on average."""
    rng = inputs.stream(purpose)
    return resample(settings.resample, inputs.prior.weights.weights, size, rng).astype(np.intp, copy=False)


def moved(inputs: Inputs, ancestors: Ancestors, purpose: str) -> Floats:
    """(N, D) states of the frame: the parents', moved by the motion model."""
    return inputs.motion.propagate(inputs.prior.states[ancestors], inputs.dt, inputs.stream(purpose))


def evaluated(inputs: Inputs, states: Floats, prior_log: Floats, ancestors: Ancestors) -> Pass:
    """One pass: what the net says of `states` (N, D) of normalised prior log-weights (N,)."""
    evidence = inputs.evaluate(hypotheses_of(states, inputs.prior.fields), prior_log)
    return Pass(states, prior_log, ancestors, evidence)
