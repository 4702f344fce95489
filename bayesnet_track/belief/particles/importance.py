"""Importance functions of thesis 5.5.1, and the second pass over hypotheses of a frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from bayesnet_track.belief.contract import Ancestors, Evidence, Report, hypotheses_of
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.belief.particles.adaptive_size import (
    WillRepeat,
    adaptive_size,
    evaluate_sample,
    fixed_size,
    move,
    resize_by,
    start_size,
)
from bayesnet_track.belief.particles.particle_set import Inputs
from bayesnet_track.belief.particles.proposals import (
    CombinedSample,
    Draws,
    Kernels,
    confine_to_image,
    draw_by_parents,
    draw_fitted,
    flatten_to_ess,
    log_prior,
    log_sum,
    mix_defensive,
    reweight_sample,
)
from bayesnet_track.belief.particles.sample_size import FrameSample, WeightedSample, concatenate, prior_of
from bayesnet_track.graph import spec
from bayesnet_track.graph.settings.beliefs import (
    Auxiliary,
    IteratedProposal,
    LikelihoodMixture,
    PriorEditing,
    SecondPassProposal,
)
from bayesnet_track.journal.events.beliefs import SecondPass
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import weighted_moments
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights, kl
from bayesnet_track.numerics.resampling import systematic
from bayesnet_track.observation.cue import Hypotheses

LATTICE = np.array([0.7548776662466927, 0.5698402909980532])
"""Steps of Roberts' R2 sequence: as even as a grid, for any number of places."""

LEAST_EFFECTIVE = 10
"""Effective hypotheses that kernels stand around; a sharper likelihood is flattened until there are."""


def auxiliary_pass(inputs: Inputs, size: int, settings: Auxiliary) -> WeightedSample:
    """Parents drawn by beta_k L(drift of k), their hypotheses weighted by what that favoured (eq. 5.20).

    The evidence is unbiased: parents are drawn before, and independently of, where their hypotheses move.
    """
    beta, states = inputs.prior.weights, inputs.prior.states
    predicted = hypotheses_of(inputs.motion.drift(states, inputs.dt), inputs.prior.fields)
    try:
        looked, _ = beta.times(inputs.evaluate(predicted, beta.log).log_likelihood)
    except DegenerateWeights:  # nothing fits ahead: the look favours none
        looked = beta
    with np.errstate(invalid="ignore"):
        ratio = np.where(beta.log > -np.inf, looked.log - beta.log, -np.inf)
    ratio = np.asarray(mix_defensive(ratio, settings.defensive))
    log_parents, _ = LogWeights.normalise(beta.log + ratio)
    rng = inputs.stream("resample")
    ancestors = systematic(log_parents.weights, size, rng).astype(np.intp, copy=False)
    prior_log = (beta.log - log_parents.log)[ancestors] - np.log(size)
    return reweight_sample(
        evaluate_sample(
            inputs, move(inputs, ancestors, "propagate"), LogWeights.normalise(prior_log)[0].log, ancestors
        ),
        prior_log,
    )


# ------------------------------------------------------------------------------------ prior editing


def edit(inputs: Inputs, first: WeightedSample, settings: PriorEditing) -> WeightedSample:
    """Prior editing: hypotheses kept with probability min(1, L / c), their weight divided by it.

    All rounds are drawn, so that their number depends on nothing, and c_i is a share of the largest
    likelihood of the *other* hypotheses: so those kept are a sample of the prior exactly, and the evidence is
    unbiased (rejection control; a fixed number of kept hypotheses, or a c that knows of i, would bias it).
    """
    sample = first
    if settings.rounds > 1:
        extra_size = (settings.rounds - 1) * len(first)
        indices = systematic(inputs.prior.weights.weights, extra_size, inputs.stream("resample rounds"))
        ancestors = indices.astype(np.intp, copy=False)
        states = move(inputs, ancestors, "propagate rounds")
        extra = evaluate_sample(inputs, states, LogWeights.uniform(extra_size).log, ancestors)
        sample = concatenate(first, extra, 1.0 / settings.rounds)
    likelihood = sample.evidence.log_likelihood
    if not np.isfinite(np.max(likelihood)):  # all -inf, or one a NaN or inf
        return sample
    best_index = int(np.argmax(likelihood))
    second = float(np.max(np.delete(likelihood, best_index)))
    level = np.full(len(sample), likelihood[best_index] + np.log(settings.accept_above))
    level[best_index] = second + np.log(settings.accept_above)
    log_kept = np.minimum(0.0, likelihood - level)
    log_kept[best_index] = 0.0  # at least its level, which may be -inf
    with np.errstate(divide="ignore"):
        accepted = np.flatnonzero(np.log(inputs.stream("reject").random(len(sample))) < log_kept)
    survivors = select_hypotheses(sample, accepted)
    return reweight_sample(survivors, survivors.prior_log - log_kept[accepted])


def select_hypotheses(sample: WeightedSample, index: Ancestors) -> WeightedSample:
    """Some of a pass' hypotheses, by index, with their evidence."""
    evidence = sample.evidence
    part: Evidence = replace(
        evidence,
        log_likelihood=evidence.log_likelihood[index],
        messages={name: values[index] for name, values in evidence.messages.items()},
        latent={
            name: Hypotheses(
                hypotheses.boxes[index], {key: values[index] for key, values in hypotheses.fields.items()}
            )
            for name, hypotheses in evidence.latent.items()
        },
        sampled=None if evidence.sampled is None else evidence.sampled[index],
        factors={name: values[index] for name, values in evidence.factors.items()},
    )
    return WeightedSample(sample.states[index], sample.prior_log[index], sample.ancestors[index], part)


# ------------------------------------------------------------------------------------ by kernels


def refine(inputs: Inputs, first: WeightedSample, settings: IteratedProposal) -> CombinedSample | None:
    """West's adaptive mixture: each refinement draws from kernels around all hypotheses so far.

    All are weighted by the mixture of what they could have been drawn from, 1 / (n + sum m_r r_r(x)), where
    r_r = g_r / p by (5.18): O(R^2 M N). The evidence of `CombinedSample` is that of the refinements alone,
    each unbiased given those before. None where passes cannot be joined or drawn.

    Raises:
        DegenerateWeights: no hypothesis of the first pass has a positive, finite likelihood.
    """
    beta = inputs.prior.weights
    transition = inputs.motion.transition(inputs.prior.states, inputs.dt)
    if transition.states is None or transition.means.shape[1] == 0:
        return None
    n = len(first)
    as_first = round(settings.defensive * n)
    rng = inputs.stream("second pass")
    sample, mixtures, evidences = first, list[Kernels](), []
    for _ in range(settings.refinements):
        points = transition.coordinates(sample.states)[0]
        kernels = _fit_kernels(points, sample, settings.bandwidth)
        mixtures.append(kernels)
        component, draws = kernels.draw(n - as_first, rng)
        parents = sample.ancestors[component]
        still = inputs.motion.drift(inputs.prior.states[parents], inputs.dt)
        from_prior = systematic(beta.weights, as_first, rng).astype(np.intp, copy=False)
        fresh = inputs.motion.propagate(inputs.prior.states[from_prior], inputs.dt, rng)
        states = np.concatenate([transition.states(draws, still), fresh])
        ancestors = np.concatenate([parents, from_prior])

        points = transition.coordinates(np.concatenate([sample.states, states]))[0]
        log_p = log_prior(transition, beta, points)
        ratios = [
            mix_defensive(each.log_density(points, len(each.centres)) - log_p, as_first / n)
            for each in mixtures
        ]
        log_alone = -np.log(n) - ratios[-1][len(sample) :]
        states = confine_to_image(inputs.motion, states)
        refinement = evaluate_sample(inputs, states, LogWeights.normalise(log_alone)[0].log, ancestors)
        if refinement.evidence.faults.keys() != first.evidence.faults.keys():
            return None
        evidences.append(log_sum(log_alone + refinement.evidence.log_likelihood))
        counts = np.log(n) + np.logaddexp.reduce([np.zeros(len(points)), *ratios], axis=0)
        sample = reweight_sample(concatenate(sample, refinement, 0.5), -counts)
    return CombinedSample(sample, log_sum(np.array(evidences)) - np.log(len(evidences)))


def _fit_kernels(points: Floats, sample: WeightedSample, bandwidth: float) -> Kernels:
    """Kernels around weighted hypotheses, by the normal reference rule for their effective size."""
    size = points.shape[1]
    _, weights = flatten_to_ess(prior_of(sample), sample.evidence.log_likelihood, LEAST_EFFECTIVE)
    spread = weighted_moments(points, weights.weights)[1]
    width = bandwidth * (4.0 / ((size + 2) * weights.ess)) ** (1.0 / (size + 4))
    scale = np.diag(np.maximum(np.diagonal(spread), 1e-12))
    return Kernels(weights, points, width * np.linalg.cholesky(spread + 1e-6 * scale))


def mixture_pass(inputs: Inputs, size: int, settings: LikelihoodMixture) -> WeightedSample:
    """Hypotheses from the motion model, and from where probes find the likelihood high (Thrun et al.).

    Probes are spread evenly over the prior's surroundings, their boxes and further fields as a draw from the
    prior has them. Positions come from kernels of the probes' spacing, weighted by their likelihood; the
    other coordinates from the prior's Gaussian given the position. Each hypothesis is weighted by the prior's
    density over that of the mixture (5.18), at most 1 / (1 - share). The probes are no hypotheses, so nothing
    is used twice and the evidence is unbiased.
    """
    beta, rng = inputs.prior.weights, inputs.stream("candidates")
    ancestors = systematic(beta.weights, size, inputs.stream("resample")).astype(np.intp, copy=False)
    from_motion = move(inputs, ancestors, "propagate")
    transition = inputs.motion.transition(inputs.prior.states, inputs.dt)
    part = round(settings.share * size)
    kernels = _probe(inputs, from_motion, transition, settings.reach_sd, rng) if part else None
    if kernels is None or transition.states is None:
        return evaluate_sample(inputs, from_motion, LogWeights.uniform(size).log, ancestors)
    # Which of the draws give way must not depend on where they went.
    stay = np.sort(rng.permutation(size)[: size - part])
    _, draws = kernels.draw(part, rng)
    parents = systematic(beta.weights, part, rng).astype(np.intp, copy=False)
    still = inputs.motion.drift(inputs.prior.states[parents], inputs.dt)
    states = np.concatenate([from_motion[stay], transition.states(draws, still)])
    points = transition.coordinates(states)[0]
    log_ratio = kernels.log_density(points) - log_prior(transition, beta, points)
    prior_log = -np.logaddexp(np.log(size - part), np.log(part) + log_ratio)
    sources, states = np.concatenate([ancestors[stay], parents]), confine_to_image(inputs.motion, states)
    return reweight_sample(
        evaluate_sample(inputs, states, LogWeights.normalise(prior_log)[0].log, sources), prior_log
    )


def _probe(
    inputs: Inputs, from_motion: Floats, transition: Transition, reach_sd: float, rng: np.random.Generator
) -> Kernels | None:
    """Kernels in the motion's coordinates where probes are likely; None when none is, or nothing can move."""
    size = len(from_motion)
    points = transition.coordinates(from_motion)[0]
    place = from_motion[:, :2]
    middle, sd = place.mean(axis=0), place.std(axis=0)
    if points.shape[1] == 0 or not (sd > 0).all():
        return None
    lattice = (np.arange(size)[:, None] * LATTICE + rng.random(2)) % 1
    probes = from_motion.copy()
    probes[:, :2] = middle + reach_sd * sd * (2.0 * lattice - 1.0)
    evidence = inputs.evaluate(hypotheses_of(probes, inputs.prior.fields), LogWeights.uniform(size).log)
    try:
        weights, _ = LogWeights.normalise(evidence.log_likelihood)
    except DegenerateWeights:
        return None
    spacing = 2.0 * reach_sd * sd / np.sqrt(size)
    centre = points.mean(axis=0)
    cross_covariance = (points - centre).T @ (place - middle) / size
    place_covariance = np.cov(place.T, bias=True)
    gain = cross_covariance @ np.linalg.inv(place_covariance)
    spread = (
        np.cov(points.T, bias=True).reshape(len(centre), -1)
        - gain @ (place_covariance - np.diag(spacing**2)) @ gain.T
    )
    root = np.linalg.cholesky(spread + 1e-9 * np.diag(np.diagonal(np.atleast_2d(np.cov(points.T)))))
    return Kernels(weights, centre + (probes[:, :2] - middle) @ gain.T, root)


Draw = Callable[[Inputs], FrameSample]
"""Draws the hypotheses of a frame."""

Refine = Callable[[Inputs, FrameSample], FrameSample]
"""Edits them, or adds others."""


def proposal_of(settings: spec.Particles) -> tuple[Draw, Refine | None]:
    """Proposal of the settings, which draws the hypotheses of a frame; None for draws from the motion."""
    proposal, size = settings.proposal.settings, start_size(settings)
    match proposal:
        case Auxiliary():
            return partial(_draw_alone, partial(auxiliary_pass, size=size, settings=proposal)), None
        case LikelihoodMixture():
            return partial(_draw_alone, partial(mixture_pass, size=size, settings=proposal)), None
        case PriorEditing():
            return _first_pass(settings, _never), partial(_edit, proposal)
        case IteratedProposal():
            draw_again: Again = partial(refine, settings=proposal)
        case SecondPassProposal():
            draw_again = partial(_second_pass, settings=proposal)
        case _:
            return _first_pass(settings, _never), None
    first = _first_pass(settings, partial(_is_surprise, proposal.above_kl))
    return first, partial(_draw_twice, settings, proposal, draw_again)


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
    proposal: SecondPassProposal | IteratedProposal,
    draw_again: Again,
    inputs: Inputs,
    first: FrameSample,
) -> FrameSample:
    """The first pass, and a second one where the first is a surprise.

    The frame's evidence is unbiased although the first pass decides on the second: each half of the first
    keeps or shares its weight by what the *other* half says, as halves know nothing of each other beyond the
    drawing of their parents.
    """
    halves = tuple(_half(first.whole, start) for start in (0, 1))
    surprises = tuple(surprise(half.prior_log, half.evidence.log_likelihood) for half in halves)
    if max(surprises) <= proposal.above_kl and proposal.above_kl > 0:
        return first
    try:
        combined = draw_again(inputs, first.whole)
    except DegenerateWeights:  # the first pass says nothing of where to look
        return first
    if combined is None:
        return first
    share = len(first.whole) / len(combined.whole) if len(combined.whole) > len(first.whole) else 0.0
    parts = []
    for half, other_kl in zip(halves, reversed(surprises), strict=True):
        log_half = log_sum(half.prior_log + half.evidence.log_likelihood)
        both_count = other_kl > proposal.above_kl or proposal.above_kl == 0
        parts.append(_mix_evidence(log_half, combined.log_second, share) if both_count else log_half)
    log_evidence = float(np.logaddexp(parts[0], parts[1]) - np.log(2.0))
    reports = first.reports
    if proposal.above_kl > 0:
        reports = (*reports, _report(first.whole, combined, proposal, max(surprises)))
    size_memory = first.size_memory
    if len(combined.whole) != len(first.whole):
        size_memory = resize_by(settings, inputs, combined.whole, size_memory)
    return FrameSample(combined.whole, size_memory, reports, log_evidence)


def _second_pass(
    inputs: Inputs, first: WeightedSample, settings: SecondPassProposal
) -> CombinedSample | None:
    draws = draw_fitted(inputs, first, settings) if settings.by == "fitted" else None
    draws = draw_by_parents(inputs, first, settings) if draws is None else draws
    second = evaluate_sample(
        inputs, draws.states, LogWeights.normalise(draws.log_alone)[0].log, draws.ancestors
    )
    return combine(first, second, draws, settings.weights)


def _half(sample: WeightedSample, start: int) -> WeightedSample:
    """Every other hypothesis, as a sample of the prior of its own; its messages are left out."""
    evidence = Evidence(sample.evidence.log_likelihood[start::2])
    prior_log = LogWeights.normalise(sample.prior_log[start::2])[0].log
    return WeightedSample(sample.states[start::2], prior_log, sample.ancestors[start::2], evidence)


def _mix_evidence(log_first: float, log_second: float, share: float) -> float:
    with np.errstate(divide="ignore"):
        return float(np.logaddexp(np.log(share) + log_first, np.log1p(-share) + log_second))


def _report(
    first: WeightedSample,
    combined: CombinedSample,
    settings: SecondPassProposal | IteratedProposal,
    kl_nats: float,
) -> Report:
    ess_first, ess = _ess(first), _ess(combined.whole)
    particles = len(combined.whole) - len(first) or len(first)
    method = "iterated" if isinstance(settings, IteratedProposal) else "second_pass"
    return lambda frame, target: SecondPass(
        frame=frame,
        target=target,
        method=method,
        kl=kl_nats,
        above_kl=settings.above_kl,
        first=len(first),
        particles=particles,
        ess_first=ess_first,
        ess=ess,
    )


def _ess(sample: WeightedSample) -> float:
    return LogWeights.normalise(sample.prior_log + sample.evidence.log_likelihood)[0].ess


def combine(
    first: WeightedSample, second: WeightedSample, draws: Draws, weights: str
) -> CombinedSample | None:
    """Both passes as one; None when they cannot be joined.

    Args:
        first: draws from the prior, which may be weighted.
        second: the draws of a second pass with their evidence.
        draws: how they were drawn.
        weights: `balance`, each hypothesis by what both passes could have drawn it with (at most twice its
            weight in the first alone, for equal sizes); `separate`, each pass by itself; or `second_only`.
            Balanced weights depend on the first pass's likelihoods, and so their evidence falls short by a
            share of the order of one over its effective size; the others' does not.
    """
    n, m, log_alone = len(first), len(draws.states), draws.log_alone
    if second.evidence.faults.keys() != first.evidence.faults.keys():
        return None
    log_second = log_sum(log_alone + second.evidence.log_likelihood)
    if weights == "second_only":
        return CombinedSample(reweight_sample(second, log_alone), log_second)
    share = n / (n + m)
    if weights == "separate":
        return CombinedSample(concatenate(first, reweight_sample(second, log_alone), share), log_second)
    log_n, log_m = np.log(n), np.log(m)
    of_first = first.prior_log + log_n - np.logaddexp(log_n, log_m + draws.log_ratio_first)
    of_second = -np.logaddexp(log_n, log_m + draws.log_ratio)
    sample = concatenate(first, second, share)
    return CombinedSample(reweight_sample(sample, np.concatenate([of_first, of_second])), log_second)
