"""From where the hypotheses of a frame are drawn, and when a second pass is paid for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Evidence, Report
from bayesnet_track.belief.particles.adaptive_size import First, first_pass, resized_by, start_size
from bayesnet_track.belief.particles.alternatives import auxiliary_pass, edited, mixture_pass, refined
from bayesnet_track.belief.particles.particle_set import Inputs
from bayesnet_track.belief.particles.passes import Pass
from bayesnet_track.belief.particles.proposals import Both, fitted_draws, log_sum, parent_draws, taken
from bayesnet_track.belief.particles.sample_size import Sized
from bayesnet_track.graph import spec
from bayesnet_track.graph.settings.proposals import (
    Auxiliary,
    IteratedProposal,
    LikelihoodMixture,
    PriorEditing,
    SecondPassProposal,
)
from bayesnet_track.journal.events.belief_events import SecondPass
from bayesnet_track.numerics.divergence import kl
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Drawn:
    """All hypotheses of a frame.

    Attributes:
        whole: the hypotheses, weighted as a sample of the prior, and their evidence.
        sized: what an adaptive size remembers.
        reports: what is to be told.
        log_evidence: the frame's, where it is not to be taken from the weights of `whole`.
    """

    whole: Pass
    sized: Sized | None = None
    reports: tuple[Report, ...] = ()
    log_evidence: float | None = None


def drawn(settings: spec.Particles, inputs: Inputs) -> Drawn:
    """The hypotheses of a frame, by the importance function that the settings choose."""
    chosen = settings.proposal.settings
    match chosen:
        case Auxiliary():
            return Drawn(auxiliary_pass(inputs, start_size(settings), chosen))
        case LikelihoodMixture():
            return Drawn(mixture_pass(inputs, start_size(settings), chosen))
        case SecondPassProposal() | IteratedProposal():
            first = first_pass(settings, inputs, partial(_is_surprise, chosen.above_kl))
            twice = _twice(inputs, first, chosen)
            if len(twice.whole) == len(first.one):
                return twice
            return replace(twice, sized=resized_by(settings, inputs, twice.whole, first.sized))
    first = first_pass(settings, inputs)
    if isinstance(chosen, PriorEditing):
        return Drawn(edited(inputs, first.one, chosen), first.sized, first.reports)
    return Drawn(first.one, first.sized, first.reports)


def surprise(prior_log: Floats, log_likelihood: Floats) -> float:
    """KL(posterior || prior) = sum f ln(f / beta) in nats, of hypotheses drawn from the prior (eq. 5.30).

    log N - H(f) for equal beta. It cannot exceed log N, and that is what it is said to be when no hypothesis
    has a positive, finite likelihood.
    """
    beta = LogWeights.normalise(prior_log)[0]
    try:
        posterior, _ = LogWeights.normalise(beta.log + log_likelihood)
    except DegenerateWeights:
        return float(np.log(len(beta)))
    return kl(posterior.log, beta.log)


def _is_surprise(above_kl: float, prior_log: Floats, log_likelihood: Floats) -> bool:
    return above_kl == 0 or surprise(prior_log, log_likelihood) > above_kl


def _twice(inputs: Inputs, first: First, settings: SecondPassProposal | IteratedProposal) -> Drawn:
    """The first pass, and a second one where the first is a surprise.

    The frame's evidence is unbiased although the first pass decides on the second: each half of the first
    keeps or shares its weight by what the *other* half says, as halves know nothing of each other beyond the
    drawing of their parents.
    """
    once = Drawn(first.one, first.sized, first.reports)
    halves = tuple(_half(first.one, start) for start in (0, 1))
    found = tuple(surprise(half.prior_log, half.evidence.log_likelihood) for half in halves)
    if max(found) <= settings.above_kl and settings.above_kl > 0:
        return once
    try:
        both = _second(inputs, first.one, settings)
    except DegenerateWeights:  # the first pass says nothing of where to look
        return once
    if both is None:
        return once
    share = len(first.one) / len(both.whole) if len(both.whole) > len(first.one) else 0.0
    parts = []
    for half, other in zip(halves, reversed(found), strict=True):
        own = log_sum(half.prior_log + half.evidence.log_likelihood)
        both_count = other > settings.above_kl or settings.above_kl == 0
        parts.append(_weighted(own, both.log_second, share) if both_count else own)
    log_evidence = float(np.logaddexp(parts[0], parts[1]) - np.log(2.0))
    reports = first.reports
    if settings.above_kl > 0:
        reports = (*reports, _report(first.one, both, settings, max(found)))
    return Drawn(both.whole, first.sized, reports, log_evidence)


def _second(inputs: Inputs, first: Pass, settings: SecondPassProposal | IteratedProposal) -> Both | None:
    if isinstance(settings, IteratedProposal):
        return refined(inputs, first, settings)
    draws = fitted_draws(inputs, first, settings) if settings.by == "fitted" else None
    draws = parent_draws(inputs, first, settings) if draws is None else draws
    return taken(inputs, first, draws, settings.weights)


def _half(one: Pass, start: int) -> Pass:
    """Every other hypothesis, as a sample of the prior of its own; its messages are left out."""
    evidence = Evidence(one.evidence.log_likelihood[start::2])
    prior_log = LogWeights.normalise(one.prior_log[start::2])[0].log
    return Pass(one.states[start::2], prior_log, one.ancestors[start::2], evidence)


def _weighted(log_first: float, log_second: float, share: float) -> float:
    with np.errstate(divide="ignore"):
        return float(np.logaddexp(np.log(share) + log_first, np.log1p(-share) + log_second))


def _report(first: Pass, both: Both, settings: SecondPassProposal | IteratedProposal, found: float) -> Report:
    before, after = _ess(first), _ess(both.whole)
    particles = len(both.whole) - len(first) or len(first)
    method = "iterated" if isinstance(settings, IteratedProposal) else "second_pass"
    return lambda frame, target: SecondPass(
        frame=frame,
        target=target,
        method=method,
        kl=found,
        above_kl=settings.above_kl,
        first=len(first),
        particles=particles,
        ess_first=before,
        ess=after,
    )


def _ess(one: Pass) -> float:
    return LogWeights.normalise(one.prior_log + one.evidence.log_likelihood)[0].ess
