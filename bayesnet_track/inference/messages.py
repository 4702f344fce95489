"""Message passing over hypotheses: priors go down, log-likelihoods come up."""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Evidence, Stream
from bayesnet_track.belief.motion import log_noise_density, sample_noise
from bayesnet_track.cue import Cue, Hypotheses, Reference
from bayesnet_track.graph.spec import Noise
from bayesnet_track.inference.compile import Plan
from bayesnet_track.planes import PlaneCache, Planes, Region, region_of_boxes

Floats = NDArray[np.float64]
Clock = Callable[[], float]


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

    An agent that raises, or returns anything but N finite numbers or -inf, is left out as if it were
    switched off, and named in `faults`.
    """
    latent = _draw_latent(plan, observer, hypotheses)
    at = {plan.root: hypotheses, **latent}
    messages: dict[str, Floats] = {}
    faults: dict[str, str] = {}
    if plan.observations:
        planes = _planes(plan, observer, at)
        for step in plan.observations:
            outcome = _observe(step.agent, at[step.at], planes, observer)
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
        present = [(c, w) for c, w in zip(join.children, join.weights, strict=True) if c in messages]
        if not present:
            continue
        scale = sum(weight for _, weight in present) if join.kind == "pool" else 1.0
        total = np.zeros(len(hypotheses))
        for child, weight in present:
            total = total + (weight / scale) * messages[child]
        if join.kernel is not None:
            above = latent.get(_given_from(plan, join.node), hypotheses)
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
    normalised: without the division the samples' density would act as a second prior.
    """
    log_kernel = log_noise_density(given, own.boxes, above.boxes).T
    log_q = np.logaddexp.reduce(log_kernel + prior_log[:, None], axis=0)
    log_terms = log_kernel + (prior_log - log_q)[None, :]
    log_terms = log_terms - np.logaddexp.reduce(log_terms, axis=1, keepdims=True)
    return np.asarray(np.logaddexp.reduce(log_terms + log_likelihood[None, :], axis=1), dtype=np.float64)


def _given_from(plan: Plan, node: str) -> str:
    return next(step.given_from for step in plan.draws if step.node == node)


def _draw_latent(plan: Plan, observer: Observer, hypotheses: Hypotheses) -> dict[str, Hypotheses]:
    at = {plan.root: hypotheses}
    for step in plan.draws:
        above = at[step.given_from]
        boxes = sample_noise(step.given, above.boxes, observer.stream(f"latent {step.node}"))
        at[step.node] = Hypotheses(boxes, above.fields)
    return {step.node: at[step.node] for step in plan.draws}


def _planes(plan: Plan, observer: Observer, at: Mapping[str, Hypotheses]) -> Planes:
    started = observer.clock()
    region = Region(0, 0, 0, 0)
    for hypotheses in at.values():
        region = region.union(region_of_boxes(hypotheses.boxes))
    planes = observer.cache.planes(plan.planes, region)
    observer.seconds["planes"] = observer.seconds.get("planes", 0.0) + observer.clock() - started
    return planes


def _observe(agent: str, hypotheses: Hypotheses, planes: Planes, observer: Observer) -> Floats | str:
    """The agent's (N,) log-likelihood, or what is wrong with it."""
    started = observer.clock()
    try:
        result = observer.cues[agent].log_likelihood(planes, hypotheses, observer.references[agent])
        return _checked(np.asarray(result, dtype=np.float64), len(hypotheses))
    except Exception as error:  # a cue is a guest's code: whatever it raises must not end the run
        return f"raised {type(error).__name__}: {error}"
    finally:
        observer.seconds[agent] = observer.seconds.get(agent, 0.0) + observer.clock() - started


def _checked(log_likelihood: Floats, size: int) -> Floats | str:
    if log_likelihood.shape != (size,):
        return f"returned an array of shape {log_likelihood.shape} for {size} hypotheses"
    wrong = np.isnan(log_likelihood) | (log_likelihood == np.inf)
    if wrong.any():
        return f"returned {log_likelihood[wrong][0]} for {int(wrong.sum())} of {size} hypotheses"
    if not np.isfinite(log_likelihood).any():
        return f"returned a likelihood of zero for all {size} hypotheses"
    return log_likelihood
