"""One pass over hypotheses of a frame, and joining two of them into one weighted set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Evidence, Report
from bayesnet_track.belief.particles.sample_size import SizeMemory
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.cue import Hypotheses

ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class WeightedSample:
    """Hypotheses drawn in one go and what the net said of them.

    Attributes:
        states: (N, D) hypotheses.
        prior_log: (N,) log beta, the weights that make them a sample of the prior: 1/N when they were drawn
            from it, p(x) / (N g(x)) when they were drawn from g. sum beta is 1 on average, not exactly.
        ancestors: (N,) the parent that each moved from.
        evidence: the net's answer.
    """

    states: Floats
    prior_log: Floats
    ancestors: NDArray[np.intp]
    evidence: Evidence

    def __len__(self) -> int:
        return len(self.states)


@dataclass(frozen=True, eq=False)
class FrameSample:
    """The hypotheses of a frame so far.

    Attributes:
        whole: the hypotheses, weighted as a sample of the prior, and their evidence.
        size_memory: what an adaptive size remembers.
        reports: what is to be told.
        log_evidence: the frame's, where it is not to be taken from the weights of `whole`.
    """

    whole: WeightedSample
    size_memory: SizeMemory | None = None
    reports: tuple[Report, ...] = ()
    log_evidence: float | None = None


def concatenate(first: WeightedSample, second: WeightedSample, share: float) -> WeightedSample:
    """Both passes as one: `share` of the prior weight is the first's, the rest the second's.

    The evidence sum beta L stays unbiased as long as `share` was fixed before the first pass was drawn, and
    the second pass happens whatever the first one gave. When other agents failed in the second pass than in
    the first, their evidence is of different nets, so only the first is kept.
    """
    if second.evidence.faults.keys() != first.evidence.faults.keys():
        return first
    return WeightedSample(
        np.concatenate([first.states, second.states]),
        np.concatenate([first.prior_log + np.log(share), second.prior_log + np.log1p(-share)]),
        np.concatenate([first.ancestors, second.ancestors]),
        _concatenate_evidence(first.evidence, second.evidence),
    )


def prior_of(one: WeightedSample) -> LogWeights:
    """beta, normalised: the prior weights that measures use. Unchanged when normalised but for rounding."""
    equal = LogWeights.uniform(len(one))
    if one.prior_log is equal.log:  # as after resampling
        return equal
    beta, log_total = LogWeights.normalise(one.prior_log)
    return LogWeights(one.prior_log) if abs(log_total) < ROUNDING else beta


def _concatenate_evidence(first: Evidence, second: Evidence) -> Evidence:
    """The evidence of both, end to end. Gaussian messages are those of the first: one place was measured."""
    return Evidence(
        np.concatenate([first.log_likelihood, second.log_likelihood]),
        _concatenate_arrays(first.messages, second.messages),
        {node: _concatenate_hypotheses(first.latent[node], second.latent[node]) for node in first.latent},
        first.faults,
        first.gaussians,
        None
        if first.sampled is None or second.sampled is None
        else np.concatenate([first.sampled, second.sampled]),
        first.measured,
        _concatenate_arrays(first.factors, second.factors),
    )


def _concatenate_arrays(first: Mapping[str, Floats], second: Mapping[str, Floats]) -> dict[str, Floats]:
    return {name: np.concatenate([values, second[name]]) for name, values in first.items()}


def _concatenate_hypotheses(first: Hypotheses, second: Hypotheses) -> Hypotheses:
    return Hypotheses(
        np.concatenate([first.boxes, second.boxes]), _concatenate_arrays(first.fields, second.fields)
    )
