"""Message passing over hypotheses: priors go down, log-likelihoods and Gaussian messages come up."""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping
from dataclasses import dataclass, replace
from functools import reduce
from types import MappingProxyType

import numpy as np

from bayesnet_track.belief.contract import BOX_FIELDS, Evidence
from bayesnet_track.belief.motion.composed import field_of
from bayesnet_track.belief.motion.formulas import Undefined
from bayesnet_track.belief.motion.noise import sample_noise
from bayesnet_track.graph.spec import Noise
from bayesnet_track.inference.asking import Missing
from bayesnet_track.inference.compile import Observe, Plan
from bayesnet_track.inference.factors import (
    at_prediction,
    draw_given,
    linear_factors,
    log_given,
    read_as,
    weigh_factor,
)
from bayesnet_track.inference.gaussian_messages import (
    grid_message,
    kernel_message,
    latent_gaussian,
    measurement_message,
    sum_kernel,
    to_power,
)
from bayesnet_track.inference.observe import Answer, Observer, Question, ask_each, known_answers, remember
from bayesnet_track.inference.parts import part_boxes
from bayesnet_track.inference.views import through
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Hypotheses, Measurement
from bayesnet_track.observation.planes import Region, region_of_boxes
from bayesnet_track.observation.protocols import BOX

__all__ = ["JoinedMessages", "Observer", "evaluate", "join_messages", "join_plain", "without"]


Integral = Callable[[Noise, Hypotheses, Hypotheses, Floats, Floats], Floats]
INTEGRALS: Mapping[str, Integral] = {
    "one": lambda given, above, own, prior_log, total: total,
    "kernel": kernel_message,
    "grid": grid_message,
}
"""How a latent node held by its draws makes a message of their log-likelihoods."""


def evaluate(
    plan: Plan,
    observer: Observer,
    hypotheses: Hypotheses,
    prior_log: Floats,
    prepared: Mapping[Observe, Answer] = MappingProxyType({}),
    views: Mapping[str, Hypotheses] | None = None,
) -> Evidence:
    """The evidence of the whole net for (N,) hypotheses with normalised prior log-weights.

    Agents whose answers are `prepared` are not asked; `views` has the hypotheses as cameras see them, if
    they were projected before.

    An agent that fails is left out as if it were switched off, and named by the observer: its planes or it
    raise, or it returns anything but N log-likelihoods of at most 0, one of them above -inf (for an agent
    that measures: anything but a Gaussian over fields of the hypotheses). So is one that gives no answer for
    a reason outside of it. `faults` of the evidence names those of them that had answered earlier in the
    frame. One that measures nothing is left out of every product and pool, too; its own message is zeros.
    """
    latent = _draw_latent(plan, observer, hypotheses, views)
    hypotheses_of = {plan.root: hypotheses, **latent}
    messages: dict[str, Floats] = {}
    measured: dict[str, Measurement | None] = {}
    constants: dict[str, float] = {}
    faults: dict[str, str] = {}
    question = Question(hypotheses_of, prior_log, *_regions(plan, hypotheses_of, latent))
    answers = {**prepared, **known_answers(plan.observations, observer)}
    answers.update(ask_each(question, observer, [step for step in plan.observations if step not in answers]))
    for step in plan.observations:
        answer = answers[step]
        remember(step, answer, observer)
        if isinstance(answer, str | Missing):
            if step.agent in observer.broke_off:
                faults[step.agent] = answer if isinstance(answer, str) else answer.reason
        elif isinstance(answer, Measurement):
            if step.functions is not None:
                answer = read_as(answer, step.functions, observer.cache.frames)
                if answer.errors is not None:
                    answer = _at_prediction(answer, step, observer, hypotheses_of[step.at], prior_log)
                _note_undefined(step.agent, answer, hypotheses_of[step.at], observer.factors.undefined)
            if not answer.choices and step.rule is None:
                constants[step.agent] = answer.log_constant / step.temperature
            answer = to_power(answer, 1.0 / step.temperature)
            messages[step.agent] = measurement_message(answer, hypotheses_of[step.at])
            if (view := plan.view(step.at)) is not None:
                answer = through(view, answer, step.agent, step.errors)
            measured[step.agent] = answer
        elif answer is None:
            measured[step.agent] = None
            messages[step.agent] = np.zeros(len(hypotheses))
        else:
            messages[step.agent] = answer if step.temperature == 1.0 else answer / step.temperature
    factors = _weigh_factors(plan, observer, hypotheses, hypotheses_of)
    linear = linear_factors(plan.factors, factors, hypotheses, observer.cache.frames.names)
    sampled_factors = {name: log for name, log in factors.items() if name not in linear}
    joined = join_messages(plan, messages | sampled_factors, measured, latent, hypotheses, prior_log)
    total, sampled = joined.messages.pop(plan.root, np.zeros(len(hypotheses))), joined.sampled
    if linear:
        sampled, total = total if sampled is None else sampled, total + sum(factors[name] for name in linear)
    node_messages = {node: message for node, message in joined.messages.items() if node not in factors}
    present = {name for name in (*messages, *factors) if measured.get(name, ()) is not None}
    at_root = _log_constants(plan, constants, present)
    details = (joined.gaussians, sampled, measured, factors, at_root, linear)
    return Evidence(total, node_messages, latent, faults, *details)


def _weigh_factors(
    plan: Plan, observer: Observer, hypotheses: Hypotheses, clouds: Mapping[str, Hypotheses]
) -> dict[str, Floats]:
    """Factor -> its (N,) log-likelihoods, of those that have a value; `clouds` are hypotheses by node."""
    logs: dict[str, Floats] = {}
    for factor in plan.factors:
        parents = hypotheses if factor.given_from == factor.at else clouds[factor.given_from]
        log = weigh_factor(factor, clouds[factor.at], parents, observer.cache.frames, observer.factors)
        if log is not None:
            logs[factor.factor] = log
    return logs


def _note_undefined(
    agent: str, measured: Measurement, hypotheses: Hypotheses, notes: MutableMapping[str, Undefined]
) -> None:
    """Write down of which quantities hypotheses have no value."""
    if measured.seen is None:
        return
    states = {**{name: hypotheses.boxes[:, k] for k, name in enumerate(BOX)}, **hypotheses.fields}
    values = measured.seen.function(states)
    unknown = (~np.isfinite(values)).sum(axis=0)
    for name, count in zip(measured.fields, unknown.tolist(), strict=True):
        if count:
            notes.setdefault(f"measures {agent}.{name}", Undefined(count, len(hypotheses)))
    if measured.errors is None:
        return
    without = (~np.isfinite(measured.errors.log_density(states, np.zeros_like(values)))).sum(axis=0)
    for name, count in zip(measured.fields, without.tolist(), strict=True):
        if count:
            notes.setdefault(f"sd {agent}.{name}", Undefined(count, len(hypotheses)))


def _log_constants(plan: Plan, constants: Mapping[str, float], present: set[str]) -> dict[str, float]:
    """Agent -> its constant as products and pools bring it to the root."""
    at_root = {}
    for agent, constant in constants.items():
        powers = dict.fromkeys(present, 0.0) | {agent: 1.0}
        for fusion in plan.fusions:
            weights = fusion.weights(powers)
            if weights:
                powers[fusion.node] = sum(weight * powers[child] for child, weight in weights.items())
        at_root[agent] = powers.get(plan.root, 0.0) * constant
    return at_root


def _at_prediction(
    measured: Measurement, step: Observe, observer: Observer, hypotheses: Hypotheses, prior_log: Floats
) -> Measurement:
    """The measurement with its errors' covariance and peak at the first prediction of the frame."""
    key = (step.agent, step.at)
    if key not in observer.peaks:
        assert step.functions is not None
        weights = np.exp(prior_log)
        fields = {**dict(zip(BOX, hypotheses.boxes.T, strict=True)), **hypotheses.fields}
        mean = {name: float(weights @ values) for name, values in fields.items()}
        observer.peaks[key] = at_prediction(measured, step.functions, mean, observer.cache.frames)
    covariance, log_peak = observer.peaks[key]
    return replace(measured, covariance=covariance, log_peak=log_peak)


@dataclass(frozen=True, eq=False)
class JoinedMessages:
    """Messages of all nodes.

    Attributes:
        messages: node -> (N,) its message, the agents' and the root's own included.
        gaussians: agent or latent node -> its Gaussian message as it reaches the root.
        sampled: (N,) the root's message without `gaussians`; None when there are none.
    """

    messages: dict[str, Floats]
    gaussians: dict[str, Measurement]
    sampled: Floats | None


def join_messages(
    plan: Plan,
    sent: Mapping[str, Floats],
    measured: Mapping[str, Measurement | None],
    latent: Mapping[str, Hypotheses],
    hypotheses: Hypotheses,
    prior_log: Floats,
) -> JoinedMessages:
    """Every inference node's message from what agents and factors `sent` and agents measured, children first.

    Missing children, and agents that measured nothing, are left out, a pool's weights scaled to sum to 1 over
    those present.
    """
    if not measured and not latent:
        return JoinedMessages(join_plain(plan, sent, (len(hypotheses),)), {}, None)
    messages = dict(sent)
    gaussians = {agent: measurement for agent, measurement in measured.items() if measurement is not None}
    # What of a source's message is not in its Gaussian: all, nothing, or what a latent node's is scaled by.
    rests: dict[str, Floats | float] = {
        agent: 0.0 if agent in gaussians else message for agent, message in sent.items()
    }
    # node -> the exponents, in its message, of agents and latent nodes below: products and pools are linear.
    powers = {agent: {agent: 1.0} for agent in sent if agent not in measured or agent in gaussians}
    for fusion in plan.fusions:
        weights = fusion.weights(powers)
        if not weights:
            continue
        total, terms = _fused(weights, messages, powers, len(hypotheses))
        if fusion.kind == "latent":
            assert fusion.given is not None
            parents, draws = _above(plan, fusion.node, latent, hypotheses), latent[fusion.node]
            if fusion.own == "gaussian":
                exact = {
                    source: (gaussians[source], terms[source]) for source in terms if source in gaussians
                }
                sampled = None if len(exact) == len(terms) else _rest(terms, rests, len(draws))
                matched = latent_gaussian(
                    fusion.written or fusion.given, parents, draws, prior_log, exact, sampled
                )
                total, scale = _scale(matched, parents, prior_log, total)
                rests[fusion.node] = scale
                if matched is not None:
                    view = plan.view(_source(plan, fusion.node))
                    gaussians[fusion.node] = matched if view is None else through(view, matched)
            elif fusion.written is not None:
                if fusion.own == "kernel":
                    log_kernel = log_given(fusion.written, parents, draws.boxes)
                    total = sum_kernel(log_kernel, prior_log, total)
                rests[fusion.node] = total
            else:
                means = Hypotheses(part_boxes(fusion.given, parents.boxes), parents.fields)
                total = INTEGRALS[fusion.own](fusion.given, means, draws, prior_log, total)
                rests[fusion.node] = total
            terms = {fusion.node: 1.0}
        messages[fusion.node], powers[fusion.node] = total, terms
    at_root = powers.get(plan.root, {})
    reaching = {
        source: to_power(measurement, at_root[source])
        for source, measurement in gaussians.items()
        if source in at_root
    }
    return JoinedMessages(messages, reaching, _rest(at_root, rests, len(hypotheses)) if reaching else None)


def _fused(
    weights: Mapping[str, float],
    messages: Mapping[str, Floats],
    powers: Mapping[str, Mapping[str, float]],
    size: int,
) -> tuple[Floats, dict[str, float]]:
    """The weighted sum (N,) of the children's messages, and the exponents of the sources in it."""
    total, terms = np.zeros(size), dict[str, float]()
    for child, weight in weights.items():
        total = total + weight * messages[child]
        for source, power in powers[child].items():
            terms[source] = terms.get(source, 0.0) + weight * power
    return total, terms


def join_plain(plan: Plan, sent: Mapping[str, Floats], shape: tuple[int, ...]) -> dict[str, Floats]:
    """The same as `join_messages` where nothing was measured and no node is latent: products and pools only.

    Messages of T targets with one plan may come in one array (T, N), which is their `shape` then.
    """
    messages = dict(sent)
    for fusion in plan.fusions:
        weights = fusion.weights(messages)
        if weights:
            total = np.zeros(shape)
            for child, weight in weights.items():
                total = total + (messages[child] if weight == 1.0 else weight * messages[child])
            messages[fusion.node] = total
    return messages


def without(
    plan: Plan, evidence: Evidence, agent: str, hypotheses: Hypotheses, prior_log: Floats
) -> Mapping[str, Floats]:
    """The messages of all nodes had `agent` been switched off; the root's own included (if any is left)."""
    agents = {step.agent for step in plan.observations} - {agent}
    sent = {name: message for name, message in evidence.messages.items() if name in agents}
    sent |= evidence.factors
    if not plan.draws:
        silent = {name for name, measurement in evidence.measured.items() if measurement is None}
        seeing = {name: message for name, message in sent.items() if name not in silent}
        return join_plain(plan, seeing, (len(prior_log),))
    measured = {name: measurement for name, measurement in evidence.measured.items() if name in agents}
    return join_messages(plan, sent, measured, evidence.latent, hypotheses, prior_log).messages


def _scale(
    matched: Measurement | None, parents: Hypotheses, prior_log: Floats, total: Floats
) -> tuple[Floats, float]:
    """(N,) a latent node's Gaussian message, and what scales it so that its evidence is that of the draws."""
    shape = np.zeros(len(total)) if matched is None else measurement_message(matched, parents)
    scale = _log_sum(prior_log + total) - _log_sum(prior_log + shape)
    return shape + scale, scale


def _rest(terms: Mapping[str, float], rests: Mapping[str, Floats | float], size: int) -> Floats:
    """(size,) the product of `terms` without their Gaussians."""
    product = np.zeros(size)
    for source, power in terms.items():
        product = product + power * rests[source]
    return product


def _log_sum(log: Floats) -> float:
    top = float(np.max(log))
    return top if not np.isfinite(top) else top + float(np.log(np.sum(np.exp(log - top))))


def _above(plan: Plan, node: str, latent: Mapping[str, Hypotheses], hypotheses: Hypotheses) -> Hypotheses:
    """The hypotheses around which those of a latent node were drawn."""
    source = _source(plan, node)
    return hypotheses if source == node else latent.get(source, hypotheses)


def _source(plan: Plan, node: str) -> str:
    """The node around whose hypotheses those of a latent node were drawn."""
    return next(step.given_from for step in plan.draws if step.node == node)


def _draw_latent(
    plan: Plan, observer: Observer, hypotheses: Hypotheses, views: Mapping[str, Hypotheses] | None
) -> dict[str, Hypotheses]:
    """Hypotheses of views and of latent nodes."""
    if views is None:
        frame = observer.cache.frames.current
        views = {view.node: view.project(hypotheses, frame) for view in plan.views}
    hypotheses_of = {plan.root: hypotheses, **views}
    number = next(observer.passes)
    suffix = "" if number == 0 else f" {number}"
    for step in plan.draws:
        parents = hypotheses_of[step.given_from]
        rng = observer.stream(f"latent {step.node}{suffix}")
        if step.written is not None:
            flawed: dict[str, Undefined] = {}
            drawn_boxes = draw_given(step.written, parents, rng, flawed)
            hypotheses_of[step.node] = Hypotheses(drawn_boxes, parents.fields)
            for name, flaw in flawed.items():
                observer.factors.undefined.setdefault(f"given {step.node}.{name}", flaw)
            continue
        means = part_boxes(step.given, parents.boxes)
        if step.moves:
            boxes = _deviating_boxes(step.node, means, hypotheses.fields)
        else:
            boxes = sample_noise(step.given, means, rng)
        hypotheses_of[step.node] = Hypotheses(boxes, parents.fields)
    return {**views, **{step.node: hypotheses_of[step.node] for step in plan.draws}}


def _deviating_boxes(node: str, places: Floats, fields: Mapping[str, Floats]) -> Floats:
    """(N, 4) boxes of a node that moves, from its places (N, 4) and the deviations in fields of the state."""
    boxes = places.copy()
    for column, axis in enumerate(BOX_FIELDS):
        deviations = fields.get(field_of(node, axis))
        if deviations is not None:
            boxes[:, column] += deviations
    np.maximum(boxes[:, 2:], 1.0, out=boxes[:, 2:])
    return boxes


def _regions(
    plan: Plan, hypotheses_of: Mapping[str, Hypotheses], latent: Mapping[str, Hypotheses]
) -> tuple[Region, dict[str, Region]]:
    """The region that holds all hypotheses in the image, and that of each camera."""
    cameras = dict.fromkeys(step.camera for step in plan.observations if step.camera)
    regions = {
        camera: _region(
            {step.at: hypotheses_of[step.at] for step in plan.observations if step.camera == camera}
        )
        for camera in cameras
    }
    return _region(latent if plan.views else hypotheses_of), regions


def _region(hypotheses_of: Mapping[str, Hypotheses]) -> Region:
    """The smallest region that holds every hypothesis of every node."""
    return reduce(Region.union, (region_of_boxes(hypotheses.boxes) for hypotheses in hypotheses_of.values()))
