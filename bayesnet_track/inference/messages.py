"""Message passing over hypotheses: priors go down, log-likelihoods come up."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import BOX_FIELDS, Evidence, Stream
from bayesnet_track.belief.noise import box_coordinates, log_noise_density, noisy, sample_noise
from bayesnet_track.cue import (
    AnyCue,
    Hypotheses,
    Measurement,
    Reference,
    floored,
)
from bayesnet_track.graph.spec import Noise
from bayesnet_track.inference.compile import Observe, Plan
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
        passes: counts the evaluations of the frame, so that no two draw the same latent states.
    """

    cache: PlaneCache
    cues: Mapping[str, AnyCue]
    references: Mapping[str, Reference]
    stream: Stream
    clock: Clock = lambda: 0.0
    seconds: MutableMapping[str, float] = field(default_factory=dict)
    passes: Iterator[int] = field(default_factory=count)


def evaluate(plan: Plan, observer: Observer, hypotheses: Hypotheses, prior_log: Floats) -> Evidence:
    """The evidence of the whole net for (N,) hypotheses with normalised prior log-weights.

    An agent that fails is left out as if it were switched off, and named in `faults`: its planes or it raise,
    or it returns anything but N log-likelihoods of at most 0, one of them above -inf (for an agent that
    measures: anything but a Gaussian over fields of the hypotheses). One that measures nothing sends zeros.
    """
    latent = _draw_latent(plan, observer, hypotheses)
    at = {plan.root: hypotheses, **latent}
    messages: dict[str, Floats] = {}
    measured: dict[str, Measurement] = {}
    faults: dict[str, str] = {}
    region = _region(at)
    for step in plan.observations:
        outcome = _observe(step, at[step.at], prior_log, region, observer)
        if isinstance(outcome, str):
            faults[step.agent] = outcome
        elif isinstance(outcome, Measurement):
            measured[step.agent] = outcome
            messages[step.agent] = measurement_message(outcome, at[step.at])
        elif outcome is None:
            messages[step.agent] = np.zeros(len(hypotheses))
        else:
            messages[step.agent] = outcome
    join_messages(plan, messages, latent, hypotheses, prior_log)
    total = messages.pop(plan.root, np.zeros(len(hypotheses)))
    gaussians, sampled = _apart(plan, messages, measured, total)
    return Evidence(total, messages, latent, faults, gaussians, sampled)


def measurement_message(measured: Measurement, hypotheses: Hypotheses) -> Floats:
    """(N,) log-likelihood -d^2 / 2 of a Gaussian message, mixed with its floor."""
    values = np.stack([_field(hypotheses, name) for name in measured.fields], axis=1)
    away = values - measured.mean
    distance2 = np.einsum("nk,nk->n", away @ np.linalg.inv(measured.covariance), away)
    log = -0.5 * np.maximum(distance2, 0.0)
    return floored(log, measured.floor) if measured.floor > 0 else log


def _field(hypotheses: Hypotheses, name: str) -> Floats:
    """(N,) a field of hypotheses: of their boxes, or a further one."""
    if name in BOX_FIELDS:
        return hypotheses.boxes[:, BOX_FIELDS.index(name)]
    return hypotheses.fields[name]


def _apart(
    plan: Plan, messages: Mapping[str, Floats], measured: Mapping[str, Measurement], total: Floats
) -> tuple[dict[str, Measurement], Floats | None]:
    """The measurements as they reach the root, and the net's log-likelihood without them.

    A message to the power a is a Gaussian whose covariance is divided by a.
    """
    gaussians: dict[str, Measurement] = {}
    rest = total
    for agent, own in measured.items():
        power = _power_at_root(plan, agent, messages)
        if power is None:
            continue
        gaussians[agent] = replace(own, covariance=own.covariance / power)
        rest = rest - power * messages[agent]
    return gaussians, rest if gaussians else None


def _power_at_root(plan: Plan, agent: str, messages: Mapping[str, Floats]) -> float | None:
    """The exponent of an agent's likelihood in the root's; None where a node on the way has its own state."""
    power, node = 1.0, agent
    present = {*messages, plan.root}
    for join in plan.joins:  # children first
        if node in join.children:
            if join.kind == "latent":
                return None
            power *= join.weights(present)[node]
            node = join.node
    return power


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
    number = next(observer.passes)
    again = "" if number == 0 else f" {number}"
    for step in plan.draws:
        above = at[step.given_from]
        boxes = sample_noise(step.given, above.boxes, observer.stream(f"latent {step.node}{again}"))
        at[step.node] = Hypotheses(boxes, above.fields)
    return {step.node: at[step.node] for step in plan.draws}


def _region(at: Mapping[str, Hypotheses]) -> Region:
    """The smallest region that holds every hypothesis of every node."""
    region = Region(0, 0, 0, 0)
    for hypotheses in at.values():
        region = region.union(region_of_boxes(hypotheses.boxes))
    return region


def _observe(
    step: Observe, hypotheses: Hypotheses, prior_log: Floats, region: Region, observer: Observer
) -> Floats | Measurement | str | None:
    """The agent's (N,) log-likelihood or measurement (None: nothing seen), or what is wrong with it."""
    agent, part = step.agent, "planes"
    cue: Any = observer.cues[agent]
    # A copy of its own: what it writes there reaches no other agent.
    own = Hypotheses(hypotheses.boxes.copy(), {name: v.copy() for name, v in hypotheses.fields.items()})
    started = observer.clock()
    try:
        planes = observer.cache.planes(cue.needs, region)
        started, part = _charge(observer, part, started), agent
        reference = observer.references[agent]
        if step.measures:
            return _checked_measurement(cue.measure(planes, own, np.exp(prior_log), reference), own)
        result = cue.log_likelihood(planes, own, reference)
        return _checked(np.array(result, dtype=np.float64), len(own))
    except Exception as error:  # a cue is a guest's code: whatever it raises must not end the run
        return f"raised {type(error).__name__}: {error}"
    finally:
        _charge(observer, part, started)


def _charge(observer: Observer, part: str, started: float) -> float:
    now = observer.clock()
    observer.seconds[part] = observer.seconds.get(part, 0.0) + now - started
    return now


def _checked_measurement(measured: Measurement | None, hypotheses: Hypotheses) -> Measurement | str | None:
    if measured is None:
        return None
    if not isinstance(measured, Measurement):
        return f"returned a {type(measured).__name__}, not a Measurement or None"
    known = (*BOX_FIELDS, *hypotheses.fields)
    unknown = [name for name in measured.fields if name not in known]
    if unknown or not measured.fields:
        return f"measured {', '.join(unknown) or 'nothing'}; the hypotheses have {', '.join(known)}"
    size = len(measured.fields)
    mean, covariance = np.asarray(measured.mean, float), np.asarray(measured.covariance, float)
    if mean.shape != (size,) or covariance.shape != (size, size):
        return f"measured {size} fields by arrays of shape {mean.shape} and {covariance.shape}"
    if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
        return "measured a place that is not finite"
    if not np.allclose(covariance, covariance.T) or np.linalg.eigvalsh(covariance).min() <= 0:
        return "measured a covariance that is not symmetric and positive definite"
    if not 0.0 <= measured.floor < 1.0:
        return f"measured with a floor of {measured.floor:.6g}, not in 0..1"
    return Measurement(measured.fields, mean, covariance, measured.floor)


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
