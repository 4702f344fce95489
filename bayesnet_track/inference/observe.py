"""Ask the agents: planes to cues, and what they answer checked, so that a guest's fault ends no run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, count
from threading import Lock
from typing import Any

import numpy as np

from bayesnet_track.belief.contract import BOX_FIELDS, Choices, Evidence, GroupEvidence, Stream
from bayesnet_track.inference.asking import (
    Missing,
    TargetAvailability,
    Wait,
    check_log_likelihood,
    defer_faults,
    each_at_once,
    fault_of,
    is_elsewhere,
    score,
)
from bayesnet_track.inference.compile import Observe, Plan
from bayesnet_track.inference.factors import Factors
from bayesnet_track.inference.gaussian_messages import FAR
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import LEAST_VISIBLE, shares_inside
from bayesnet_track.numerics.outlines import cut_covariance
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import (
    FAULTS,
    OWN_DETECTION,
    AnyCue,
    Hypotheses,
    Measurement,
    Reference,
    foreign_part,
    real_numbers,
)
from bayesnet_track.observation.planes import PlaneCache, Planes, Region, shown

Clock = Callable[[], float]
Answer = Floats | Measurement | str | Missing | None
"""(N,) log-likelihood, a measurement, None for nothing seen, what is wrong with it, or why it is missing."""

CHARGING = Lock()
"""Held while seconds are added up: agents are asked side by side, and several charge the planes."""


@dataclass(frozen=True, eq=False)
class Observer:
    """Inputs of evaluation: the frame's planes, the agents' cues and references.

    Attributes:
        cache: the planes of this frame.
        cues: agent -> implementation.
        references: agent -> what it remembers of the target.
        stream: purpose -> generator.
        clock: seconds, for `seconds` only; no result depends on it.
        seconds: agent -> seconds spent, added up here ("planes" for the planes).
        passes: counts the evaluations of the frame, so that no two draw the same latent states.
        measured: (agent, node) -> what an agent that measures answered at the hypotheses of the node: it is
            asked once a frame, however often the net is evaluated.
        faults: agent -> what was wrong with it in any evaluation of the frame; it is not asked again.
        availability: agents that give no answer for a reason outside of them.
        missed: those of them that were to be asked -> the reason; they are not asked again.
        answered: agents that gave an answer in an evaluation of the frame.
        broke_off: agents that gave an answer and later failed or gave none: what was made of their answers is
            of another net than what follows.
        factors: what was found of the factors in any evaluation of the frame.
        peaks: (agent, node) -> covariance and log density of the errors at the frame's first prediction, of
            an agent whose errors are written as expressions.
    """

    cache: PlaneCache
    cues: Mapping[str, AnyCue]
    references: Mapping[str, Reference]
    stream: Stream
    clock: Clock = lambda: 0.0
    seconds: MutableMapping[str, float] = field(default_factory=dict)
    passes: Iterator[int] = field(default_factory=count)
    measured: MutableMapping[tuple[str, str], Answer] = field(default_factory=dict)
    faults: MutableMapping[str, str] = field(default_factory=dict)
    availability: TargetAvailability = field(default_factory=TargetAvailability)
    missed: MutableMapping[str, str] = field(default_factory=dict)
    answered: set[str] = field(default_factory=set)
    broke_off: set[str] = field(default_factory=set)
    factors: Factors = field(default_factory=Factors)
    peaks: MutableMapping[tuple[str, str], tuple[Floats, float]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Question:
    """The question to all agents in one evaluation.

    Attributes:
        at: the root and every latent node -> its hypotheses.
        prior_log: (N,) normalised prior log-weights.
        region: the smallest region that holds every hypothesis of every node.
        regions: the same of the nodes that each of several cameras sees.
    """

    at: Mapping[str, Hypotheses]
    prior_log: Floats
    region: Region
    regions: Mapping[str, Region] = field(default_factory=dict)

    def planes(self, observer: Observer, step: Observe) -> Planes:
        """The planes that an agent reads."""
        cache = observer.cache.of_camera(step.camera)
        assert cache is not None
        needs = observer.cues[step.agent].needs
        return cache.planes(needs, self.regions[step.camera] if step.camera else self.region)

    def is_seen(self, observer: Observer, step: Observe) -> bool:
        """True if the agent can be asked: its camera has a frame, and probably most of the target is in it.

        One of several cameras says nothing of a target that is elsewhere, or that it has not met so far.
        """
        if not step.camera:
            return True
        cache = observer.cache.of_camera(step.camera)
        if cache is None or step.agent not in observer.references:
            return False
        frame = cache.frames.current
        shares = shares_inside(self.at[step.at].boxes, frame.width, frame.height)
        return float(np.exp(self.prior_log) @ shares) >= LEAST_VISIBLE


def ask_agents(question: Question, observer: Observer, steps: Sequence[Observe]) -> dict[Observe, Answer]:
    """Answers of the agents of `steps`, in their order, remembered; none is asked whose answer is known."""
    answers = known_answers(steps, observer)
    answers.update(ask_each(question, observer, [step for step in steps if step not in answers]))
    for step in steps:
        remember(step, answers[step], observer)
    return {step: answers[step] for step in steps}


def known_answers(steps: Iterable[Observe], observer: Observer) -> dict[Observe, Answer]:
    """The answers of the agents of `steps` that are not asked (again)."""
    return {step: answers[0] for step in steps if (answers := find_known_answer(step, observer))}


def ask_each(
    question: Question, observer: Observer, steps: Sequence[Observe]
) -> Iterator[tuple[Observe, Answer]]:
    """Each of `steps` with its agent's answer, found as the pairs are collected (`each_at_once`)."""
    ask, work = partial(ask_ahead, question, observer), partial(observe, question, observer)
    seen_steps = [step for step in steps if question.is_seen(observer, step)]
    unseen: list[tuple[Observe, Answer]] = [(step, None) for step in steps if step not in seen_steps]
    return chain(unseen, each_at_once(ask, work, seen_steps))


def find_known_answer(step: Observe, observer: Observer) -> tuple[Answer] | None:
    """The answer of an agent that is not asked (again), in a tuple; None when it has to be asked."""
    key = (step.agent, step.at)
    if step.agent in observer.faults:
        return (observer.faults[step.agent],)
    if step.agent in observer.missed:
        return (Missing(observer.missed[step.agent]),)
    if key in observer.measured:
        return (observer.measured[key],)
    missing = observer.availability.misses(step.agent)
    return None if missing is None else (missing,)


def observe(question: Question, observer: Observer, step: Observe) -> Answer:
    """Answer of an agent that is at work here.

    A text instead of an exception: the cue raised, or returned anything but N log-likelihoods of at most 0,
    one of them above -inf, or a Gaussian over fields of the hypotheses. `Missing` when it gives no answer.
    """
    agent, part = step.agent, "planes"
    cue: Any = observer.cues[agent]
    hypotheses = question.at[step.at]
    start = observer.clock()
    try:
        planes = question.planes(observer, step)
        start, part = _charge(observer, part, start), agent
        reference = observer.references[agent]
        if step.measures:
            weights = np.exp(question.prior_log)
            measured = cue.measure(planes, hypotheses.copied(), weights, shown(reference))
            return _check_measurement(measured, _known(step, hypotheses))
        values, faults = score(cue, [planes], hypotheses, np.array([0, len(hypotheses)]), [reference])
        return faults.get(0, values)
    except FAULTS as error:  # a cue is a guest's code: whatever it raises must not end the run
        return fault_of(error)
    finally:
        _charge(observer, part, start)


def ask_ahead(question: Question, observer: Observer, step: Observe) -> Wait[Answer] | None:
    """Ask an agent that is at work elsewhere: what waits for its answer, as `observe` has it; else None."""
    cue: Any = observer.cues[step.agent]
    if not is_elsewhere(cue):
        return None
    start, hypotheses = observer.clock(), question.at[step.at]

    def ask() -> Wait[Any]:
        planes = question.planes(observer, step)
        reference = shown(observer.references[step.agent])
        if step.measures:
            weights = np.exp(question.prior_log)
            wait: Wait[Any] = cue.ask_ahead("measure", planes, hypotheses, weights, reference)
        else:
            wait = cue.ask_ahead("log_likelihood", planes, hypotheses, reference)
        return wait

    return partial(_collect, step, observer, hypotheses, defer_faults(ask, FAULTS), start)


def _collect(
    step: Observe, observer: Observer, hypotheses: Hypotheses, wait: Wait[Any], start: float
) -> Answer:
    try:
        answer = wait()
        if step.measures:
            return _check_measurement(answer, _known(step, hypotheses))
        return check_log_likelihood(real_numbers(answer), len(hypotheses))
    except FAULTS as error:
        return fault_of(error)
    finally:
        _charge(observer, step.agent, start)


def remember(step: Observe, answer: Answer, observer: Observer) -> None:
    """Keep what is asked once a frame only. It is called in the order of the plan, whoever answered first."""
    if isinstance(answer, str | Missing):
        if step.agent in observer.answered:
            observer.broke_off.add(step.agent)
        if isinstance(answer, str):
            observer.faults.setdefault(step.agent, answer)
        elif step.agent not in observer.missed:
            observer.missed[step.agent] = answer.reason
            observer.availability.note(step.agent, answer)
        return
    observer.answered.add(step.agent)
    if step.measures:
        observer.measured.setdefault((step.agent, step.at), answer)


def _charge(observer: Observer, part: str, start: float) -> float:
    end = observer.clock()
    with CHARGING:
        observer.seconds[part] = observer.seconds.get(part, 0.0) + end - start
    return end


def _known(step: Observe, hypotheses: Hypotheses) -> tuple[str, ...]:
    """Fields that an agent may measure."""
    functions = () if step.functions is None else step.functions.terms
    return (*BOX_FIELDS, *hypotheses.fields, *functions)


def _check_measurement(measured: Any, names: tuple[str, ...]) -> Measurement | str | None:
    if measured is None:
        return None
    is_measurement = isinstance(measured, Measurement)
    foreign = foreign_part(measured) if is_measurement else type(measured).__name__
    if foreign:
        return f"returned a {foreign}, not a Measurement of real numbers or None"
    fields = tuple(measured.fields)
    unknown = [str(name) for name in fields if name not in names]
    if unknown or not fields:
        return f"measured {', '.join(unknown) or 'nothing'}; the hypotheses have {', '.join(names)}"
    if len(set(fields)) < len(fields):
        return f"measured a field twice: {', '.join(fields)}"
    size = len(fields)
    mean, covariance = np.array(measured.mean, float), np.array(measured.covariance, float)
    if mean.shape != (size,) or covariance.shape != (size, size):
        return f"measured {size} fields by arrays of shape {mean.shape} and {covariance.shape}"
    if not all(map(math.isfinite, (*mean.tolist(), *covariance.ravel().tolist()))):
        return "measured a place that is not finite"
    if not 0.0 <= measured.floor < 1.0:
        return f"measured with a floor of {measured.floor:.6g}, not in 0..1"
    confidence = None if measured.confidence is None else float(measured.confidence)
    if confidence is not None and not 0.0 <= confidence <= 1.0:
        return f"measured with a confidence of {confidence:.6g}, not in 0..1"
    choices = _check_choices(measured, names)
    if isinstance(choices, str):
        return choices
    label = measured.label
    if label is not None and label.category not in names:
        return f"measured a label of {label.category}; the hypotheses have {', '.join(names)}"
    checked = Measurement(fields, mean, covariance, float(measured.floor), choices, confidence, label=label)
    return _check_covariance(checked) or checked


def _check_covariance(measured: Measurement) -> str | None:
    covariance, variances = measured.covariance, measured.variances
    if variances is not None:  # independent errors need no solver
        smallest = min(variances)
    else:
        asymmetry = abs(covariance - covariance.T)
        is_symmetric = bool((asymmetry <= 1e-8 + 1e-5 * abs(covariance)).all())
        try:
            smallest = float(np.linalg.cholesky(covariance).diagonal().min()) ** 2 if is_symmetric else 0.0
        except np.linalg.LinAlgError:
            smallest = 0.0
    if not smallest > 0.0:
        return "measured a covariance that is not symmetric and positive definite"
    invertible = math.isfinite(1.0 / smallest)
    return None if invertible else "measured a covariance too small to be inverted"


def _check_choices(
    measured: Measurement, names: tuple[str, ...]
) -> tuple[tuple[float, Measurement], ...] | str:
    checked: list[tuple[float, Measurement]] = []
    for weight, choice in measured.choices:
        measurement = _check_measurement(choice, names)
        if isinstance(measurement, str):
            return measurement
        if measurement is None or measurement.choices or measurement.fields != tuple(measured.fields):
            return "measured choices that are no measurements of the same fields"
        checked.append((float(weight), measurement))
    weights = [weight for weight, _ in checked]
    if not all(0.0 <= weight <= 1.0 for weight in weights) or sum(weights) > 1.0 + 1e-9:
        return f"measured choices with probabilities that sum to {sum(weights):.6g}"
    return tuple(checked)


NO_CHOICES = np.empty((0, 6))
"""Of a target that none of the detections may be: box, score and probability of each."""


@dataclass(frozen=True, eq=False)
class Detected:
    """Detections that several targets may have, of a net of products whose agents are given nothing else.

    None of its agents has to be asked: their rules say how each measures a detection's box.

    Attributes:
        plan: the net.
        choices: agent's step -> its detections.
    """

    plan: Plan
    choices: Mapping[Observe, Choices]

    @staticmethod
    def fits(plan: Plan) -> bool:
        """True of a net of products whose agents are all given detections in images of cameras."""
        return (
            len(plan.observations) > 0
            and not (plan.draws or plan.factors)
            and all(fusion.kind == "product" for fusion in plan.fusions)
            and all(step.rule is not None and plan.view(step.at) for step in plan.observations)
        )

    @classmethod
    def read(cls, plan: Plan, observers: Sequence[Observer]) -> Detected | None:
        """The detections of targets, by what their observers remember; None where agents have to be asked.

        They have to where labels count, or a target has anything else than boxes that may be its own.
        """
        choices: dict[Observe, Choices] = {}
        for step in plan.observations:
            rule = step.rule
            if rule is None or rule.floor is None or rule.label is not None:
                return None
            if any(step.agent not in observer.references or observer.faults for observer in observers):
                return None
            arrays = [
                observer.references[step.agent].get(OWN_DETECTION, NO_CHOICES) for observer in observers
            ]
            arrays = [array if len(array) else NO_CHOICES for array in arrays]
            if any(array.shape[1] != NO_CHOICES.shape[1] for array in arrays):
                return None
            counts, detections = [*map(len, arrays)], np.concatenate(arrays)
            boxes, weights = detections[:, :4], detections[:, 5]
            rows = np.repeat(np.arange(len(counts)), counts)
            missed = np.maximum(1.0 - np.bincount(rows, weights, minlength=len(counts)), 0.0)
            covariances = (rule.variances(boxes) * step.temperature)[:, :, None] * np.eye(len(BOX_FIELDS))
            starts = np.cumsum([0, *counts])
            choices[step] = Choices(BOX_FIELDS, starts, boxes, covariances, weights, missed)
        return cls(plan, choices)

    def evaluate(self, views: Sequence[Mapping[str, Hypotheses]], size: int) -> GroupEvidence:
        """Evidence about `size` hypotheses of each target, which `views` has as cameras see them."""
        # Imported here: a graph is validated without compiling anything.
        from bayesnet_track.numerics.compiled import plain
        from bayesnet_track.numerics.kernels.view_kernels import message_choices

        choices, messages, present = dict[str, Choices](), dict[str, Floats](), dict[str, list[bool]]()
        for step, detections in self.choices.items():
            view, rule, agent = self.plan.view(step.at), step.rule, step.agent
            assert view is not None and rule is not None and rule.floor is not None
            variances = detections.covariances.diagonal(axis1=1, axis2=2)
            messages[agent] = message_choices(
                np.array([clouds[step.at].boxes for clouds in views]),
                detections.starts,
                (plain(detections.values), plain(variances)),
                (plain(detections.weights), detections.missed),
                rule.floor ** (1.0 / step.temperature),
                FAR * FAR,
            )
            present[agent] = (detections.counts > 0).tolist()
            cuts = cut_covariance(view.camera, detections.values)
            quantities = view.box_quantities(agent, step.errors)
            choices[agent] = evolve(detections, covariances=cuts, quantities=quantities)
        agents, nothing = (*messages,), np.zeros((len(views), size))
        for fusion in self.plan.fusions:
            messages[fusion.node] = sum((messages[child] for child in fusion.children), nothing)
            pairs = zip(*(present[child] for child in fusion.children), strict=True)
            present[fusion.node] = [*map(any, pairs)]
        total, is_seen = messages.pop(self.plan.root), present.pop(self.plan.root)
        evidence = [
            Evidence(
                total[t],
                {name: log[t] for name, log in messages.items() if name in agents or present[name][t]},
                views[t],
                measured={agent: None for agent in agents if not present[agent][t]},
                sampled=nothing[t] if is_seen[t] else None,
            )
            for t in range(len(views))
        ]
        return GroupEvidence(evidence, choices)
