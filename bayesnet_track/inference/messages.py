"""Message passing over hypotheses: priors go down, log-likelihoods come up."""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Evidence, Stream
from bayesnet_track.belief.noise import box_coordinates, log_noise_density, noisy, sample_noise
from bayesnet_track.cue import Cue, Hypotheses, Reference
from bayesnet_track.graph.spec import Noise
from bayesnet_track.inference.compile import Plan
from bayesnet_track.planes import PlaneCache, Region, region_of_boxes

Floats = NDArray[np.float64]
Clock = Callable[[], float]

ROUNDING = 1e-6
"""How far above 0, the value of a perfect match, a log-likelihood may end by rounding."""

ZERO_BELOW = -1e100
"""A log-likelihood below this is a likelihood of zero, so that sums of them stay finite."""


@dataclass(frozen=True, eq=False)
class Observer:
    """What evaluation needs of the world: the frame's planes, the agents' cues and references.

    Attributes:
        cache: the planes of this frame.
        cues: agent -> implementation.
        references: agent -> what it remembers of the target.
        stream: purpose -> generator.
        clock: seconds, for `seconds` only; no result depends on it.
        seconds: agent -> seconds spent, added up here ("planes" for the planes).
    """

    cache: PlaneCache
    cues: Mapping[str, Cue]
    references: Mapping[str, Reference]
    stream: Stream
    clock: Clock = lambda: 0.0
    seconds: MutableMapping[str, float] = field(default_factory=dict)


def evaluate(plan: Plan, observer: Observer, hypotheses: Hypotheses, prior_log: Floats) -> Evidence:
    """The evidence of the whole net for (N,) hypotheses with normalised prior log-weights.

    An agent that fails is left out as if it were switched off, and named in `faults`: its planes or it raise,
    or it returns anything but N log-likelihoods of at most 0, one of them above -inf.
    """
    latent = _draw_latent(plan, observer, hypotheses)
    at = {plan.root: hypotheses, **latent}
    messages: dict[str, Floats] = {}
    faults: dict[str, str] = {}
    region = _region(at)
    for step in plan.observations:
        outcome = _observe(step.agent, at[step.at], region, observer)
        if isinstance(outcome, str):
            faults[step.agent] = outcome
        else:
            messages[step.agent] = outcome
    join_messages(plan, messages, latent, hypotheses, prior_log)
    total = messages.pop(plan.root, None)
    return Evidence(np.zeros(len(hypotheses)) if total is None else total, messages, latent, faults)


def join_messages(
    plan: Plan,
    messages: MutableMapping[str, Floats],
    latent: Mapping[str, Hypotheses],
    hypotheses: Hypotheses,
    prior_log: Floats,
) -> None:
    """Add every inference node's message to `messages`, children first; the root's is the net's likelihood.

    Missing children are left out, a pool's weights scaled to sum to 1 over those present.
    """
    for join in plan.joins:
        weights = join.weights(messages)
        if not weights:
            continue
        total = np.zeros(len(hypotheses))
        for child, weight in weights.items():
            total = total + weight * messages[child]
        if join.kernel is not None:
            above = _above(plan, join.node, latent, hypotheses)
            total = kernel_message(join.kernel, above, latent[join.node], prior_log, total)
        messages[join.node] = total


def without(
    plan: Plan, evidence: Evidence, agent: str, hypotheses: Hypotheses, prior_log: Floats
) -> Mapping[str, Floats]:
    """The messages of all nodes had `agent` been switched off; the root's own included (if any is left)."""
    agents = {step.agent for step in plan.observations}
    kept = {n: m for n, m in evidence.messages.items() if n in agents and n != agent}
    join_messages(plan, kept, evidence.latent, hypotheses, prior_log)
    return kept


def kernel_message(
    given: Noise, above: Hypotheses, own: Hypotheses, prior_log: Floats, log_likelihood: Floats
) -> Floats:
    """(N,) log of the integral of p(c | h_i) L(c) over the latent state c, O(N^2).

    Each term is divided by the density of the samples c_j, q(c) = sum_k beta_k p(c | h_k), and every row is
    normalised: without the division the samples' density would act as a second prior. A coordinate without
    noise is the parent's own, so that only samples which agree in it count.
    """
    log_kernel = log_noise_density(given, own.boxes, above.boxes).T
    _keep_agreeing(log_kernel, given, above.boxes, own.boxes)
    log_q = _log_sum(log_kernel + prior_log[:, None], axis=0)
    log_share = np.full(len(prior_log), -np.inf)
    np.subtract(prior_log, log_q, out=log_share, where=prior_log > -np.inf)
    log_kernel += log_share
    log_total = _log_sum(log_kernel, axis=1)
    integral = _log_sum(log_kernel + log_likelihood, axis=1)
    # A hypothesis of prior weight 0 may find no sample to integrate over: its own draw stands for it.
    message = log_likelihood.copy()
    np.subtract(integral, log_total, out=message, where=log_total > -np.inf)
    return message


def _keep_agreeing(log_kernel: Floats, given: Noise, above: Floats, own: Floats) -> None:
    """Set (N, N) to -inf where the parent's box i and the sample j differ in a coordinate without noise."""
    parents, samples = box_coordinates(given, above)[0], box_coordinates(given, own)[0]
    for column, has_noise in enumerate(noisy(given)):
        values = parents[:, column]
        if not has_noise and np.ptp(values) > 0:
            away = np.abs(values[:, None] - samples[:, column])
            log_kernel[away > 1e-9 * (1.0 + np.abs(values[:, None]))] = -np.inf


def _log_sum(log: Floats, axis: int) -> Floats:
    """log of the sum of exp along an axis; -inf where every term is."""
    top = log.max(axis=axis, keepdims=True)
    with np.errstate(divide="ignore"):
        total = np.log(np.sum(np.exp(log - np.where(top > -np.inf, top, 0.0)), axis=axis, keepdims=True))
    return np.asarray(np.squeeze(total + top, axis=axis))


def _above(plan: Plan, node: str, latent: Mapping[str, Hypotheses], hypotheses: Hypotheses) -> Hypotheses:
    """The hypotheses around which those of a latent node were drawn."""
    source = next(step.given_from for step in plan.draws if step.node == node)
    return hypotheses if source == node else latent.get(source, hypotheses)


def _draw_latent(plan: Plan, observer: Observer, hypotheses: Hypotheses) -> dict[str, Hypotheses]:
    at = {plan.root: hypotheses}
    for step in plan.draws:
        above = at[step.given_from]
        boxes = sample_noise(step.given, above.boxes, observer.stream(f"latent {step.node}"))
        at[step.node] = Hypotheses(boxes, above.fields)
    return {step.node: at[step.node] for step in plan.draws}


def _region(at: Mapping[str, Hypotheses]) -> Region:
    """The smallest region that holds every hypothesis of every node."""
    region = Region(0, 0, 0, 0)
    for hypotheses in at.values():
        region = region.union(region_of_boxes(hypotheses.boxes))
    return region


def _observe(agent: str, hypotheses: Hypotheses, region: Region, observer: Observer) -> Floats | str:
    """The agent's (N,) log-likelihood, or what is wrong with it."""
    cue, part = observer.cues[agent], "planes"
    # A copy of its own: what it writes there reaches no other agent.
    own = Hypotheses(hypotheses.boxes.copy(), {name: v.copy() for name, v in hypotheses.fields.items()})
    started = observer.clock()
    try:
        planes = observer.cache.planes(cue.needs, region)
        started, part = _charge(observer, part, started), agent
        result = cue.log_likelihood(planes, own, observer.references[agent])
        return _checked(np.array(result, dtype=np.float64), len(own))
    except Exception as error:  # a cue is a guest's code: whatever it raises must not end the run
        return f"raised {type(error).__name__}: {error}"
    finally:
        _charge(observer, part, started)


def _charge(observer: Observer, part: str, started: float) -> float:
    now = observer.clock()
    observer.seconds[part] = observer.seconds.get(part, 0.0) + now - started
    return now


def _checked(log_likelihood: Floats, size: int) -> Floats | str:
    if log_likelihood.shape != (size,):
        return f"returned an array of shape {log_likelihood.shape} for {size} hypotheses"
    wrong = np.isnan(log_likelihood) | (log_likelihood > ROUNDING)
    if wrong.any():
        what = f"a log-likelihood of {log_likelihood[wrong][0]:.6g}, not at most 0,"
        return f"returned {what} for {int(wrong.sum())} of {size} hypotheses"
    log_likelihood[log_likelihood < ZERO_BELOW] = -np.inf
    if not np.isfinite(log_likelihood).any():
        return f"returned a likelihood of zero for all {size} hypotheses"
    return log_likelihood
