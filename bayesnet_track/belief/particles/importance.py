"""From where the hypotheses of a frame are drawn, and when a second pass is paid for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from bayesnet_track.belief.contract import Evidence, Report
from bayesnet_track.belief.particles.adaptive_size import (
    WillRepeat,
    adaptive_size,
    evaluate_sample,
    fixed_size,
    resize_by,
    start_size,
)
from bayesnet_track.belief.particles.alternatives import auxiliary_pass, edit, mixture_pass, refine
from bayesnet_track.belief.particles.particle_set import Inputs
from bayesnet_track.belief.particles.proposals import (
    CombinedSample,
    combine,
    draw_by_parents,
    draw_fitted,
    log_sum,
)
from bayesnet_track.belief.particles.weighted_sample import FrameSample, WeightedSample
from bayesnet_track.graph import spec
from bayesnet_track.graph.settings.proposals import (
    Auxiliary,
    IteratedProposal,
    LikelihoodMixture,
    PriorEditing,
    SecondPassProposal,
)
from bayesnet_track.journal.events.sample_sizes import SecondPass
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights, kl

Draw = Callable[[Inputs], FrameSample]
"""Draws the hypotheses of a frame."""

Refine = Callable[[Inputs, FrameSample], FrameSample]
"""Edits them, or adds others."""


def proposal_of(settings: spec.Particles) -> tuple[Draw, Refine | None]:
    """How the settings draw the hypotheses of a frame, and what they do with them then; None for nothing."""
    chosen, size = settings.proposal.settings, start_size(settings)
    match chosen:
        case Auxiliary():
            return partial(_draw_alone, partial(auxiliary_pass, size=size, settings=chosen)), None
        case LikelihoodMixture():
            return partial(_draw_alone, partial(mixture_pass, size=size, settings=chosen)), None
        case PriorEditing():
            return _first_pass(settings, _never), partial(_edit, chosen)
        case IteratedProposal():
            again: Again = partial(refine, settings=chosen)
        case SecondPassProposal():
            again = partial(_second_pass, settings=chosen)
        case _:
            return _first_pass(settings, _never), None
    first = _first_pass(settings, partial(_is_surprise, chosen.above_kl))
    return first, partial(_draw_twice, settings, chosen, again)


def _first_pass(settings: spec.Particles, will_repeat: WillRepeat) -> Draw:
    """Draws from the motion model."""
    if isinstance(settings.size, int):
        return partial(fixed_size, settings, settings.size)
    return partial(adaptive_size, settings, settings.size, will_repeat)


def _draw_alone(draw: Callable[[Inputs], WeightedSample], inputs: Inputs) -> FrameSample:
    return FrameSample(draw(inputs))


def _edit(settings: PriorEditing, inputs: Inputs, first: FrameSample) -> FrameSample:
    return replace(first, whole=edit(inputs, first.whole, settings))


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


def _never(prior_log: Floats, log_likelihood: Floats) -> bool:
    return False


Again = Callable[[Inputs, WeightedSample], CombinedSample | None]
"""A second pass after the first; None when the two cannot be joined."""


def _draw_twice(
    settings: spec.Particles,
    chosen: SecondPassProposal | IteratedProposal,
    again: Again,
    inputs: Inputs,
    first: FrameSample,
) -> FrameSample:
    """The first pass, and a second one where the first is a surprise.

    The frame's evidence is unbiased although the first pass decides on the second: each half of the first
    keeps or shares its weight by what the *other* half says, as halves know nothing of each other beyond the
    drawing of their parents.
    """
    halves = tuple(_half(first.whole, start) for start in (0, 1))
    found = tuple(surprise(half.prior_log, half.evidence.log_likelihood) for half in halves)
    if max(found) <= chosen.above_kl and chosen.above_kl > 0:
        return first
    try:
        both = again(inputs, first.whole)
    except DegenerateWeights:  # the first pass says nothing of where to look
        return first
    if both is None:
        return first
    share = len(first.whole) / len(both.whole) if len(both.whole) > len(first.whole) else 0.0
    parts = []
    for half, other in zip(halves, reversed(found), strict=True):
        own = log_sum(half.prior_log + half.evidence.log_likelihood)
        both_count = other > chosen.above_kl or chosen.above_kl == 0
        parts.append(_mix_evidence(own, both.log_second, share) if both_count else own)
    log_evidence = float(np.logaddexp(parts[0], parts[1]) - np.log(2.0))
    reports = first.reports
    if chosen.above_kl > 0:
        reports = (*reports, _report(first.whole, both, chosen, max(found)))
    size_memory = first.size_memory
    if len(both.whole) != len(first.whole):
        size_memory = resize_by(settings, inputs, both.whole, size_memory)
    return FrameSample(both.whole, size_memory, reports, log_evidence)


def _second_pass(
    inputs: Inputs, first: WeightedSample, settings: SecondPassProposal
) -> CombinedSample | None:
    draws = draw_fitted(inputs, first, settings) if settings.by == "fitted" else None
    draws = draw_by_parents(inputs, first, settings) if draws is None else draws
    second = evaluate_sample(
        inputs, draws.states, LogWeights.normalise(draws.log_alone)[0].log, draws.ancestors
    )
    return combine(first, second, draws, settings.weights)


def _half(one: WeightedSample, start: int) -> WeightedSample:
    """Every other hypothesis, as a sample of the prior of its own; its messages are left out."""
    evidence = Evidence(one.evidence.log_likelihood[start::2])
    prior_log = LogWeights.normalise(one.prior_log[start::2])[0].log
    return WeightedSample(one.states[start::2], prior_log, one.ancestors[start::2], evidence)


def _mix_evidence(log_first: float, log_second: float, share: float) -> float:
    with np.errstate(divide="ignore"):
        return float(np.logaddexp(np.log(share) + log_first, np.log1p(-share) + log_second))


def _report(
    first: WeightedSample, both: CombinedSample, settings: SecondPassProposal | IteratedProposal, found: float
) -> Report:
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


def _ess(one: WeightedSample) -> float:
    return LogWeights.normalise(one.prior_log + one.evidence.log_likelihood)[0].ess
