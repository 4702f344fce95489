"""The engine: one step of every live net for one frame.

`step` reads as: predict and weigh the belief, measure it, decide what changes, learn the references. It is a
function of the engine (graph and seed), the state and the frame; time is read for the timings only.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.learn import adapt_reference, learn_first, learn_references, learning_rate
from bayesnet_track.adapt.measure import measure
from bayesnet_track.adapt.memory import Memory
from bayesnet_track.adapt.rules import Situation, decide, quiet_level
from bayesnet_track.belief.bounds import Confined
from bayesnet_track.belief.contract import Posterior
from bayesnet_track.belief.estimate import estimate
from bayesnet_track.cue import LocallyAdaptable, Reference
from bayesnet_track.frame_metrics import first_frame_metrics, frame_metrics
from bayesnet_track.graph.net import Decision, LocallyAdapted, Net, Quarantined, TargetStarted, apply
from bayesnet_track.inference.compile import Plan, compile_plan
from bayesnet_track.inference.messages import Observer, evaluate
from bayesnet_track.journal.events import DegenerateBelief, Event, FrameMetrics
from bayesnet_track.machinery import Engine, Machinery, make_engine
from bayesnet_track.planes import Frame, FramePair, PlaneCache

__all__ = ["Engine", "Machinery", "Outcome", "State", "TargetState", "make_engine", "start_target", "step"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TargetState:
    """What is known of one live target.

    Attributes:
        belief: the posterior of the last frame.
        references: agent -> what it remembers.
        memory: what the rules remember.
        plan: the compiled net.
        time: time of the last frame, frame intervals.
    """

    belief: Posterior
    references: Mapping[str, Reference]
    memory: Memory
    plan: Plan
    time: float


@dataclass(frozen=True, eq=False)
class State:
    """The engine's state between frames.

    Attributes:
        net: the live nets.
        targets: target id -> its state.
        previous: the last frame.
    """

    net: Net = field(default_factory=Net)
    targets: Mapping[str, TargetState] = field(default_factory=dict)
    previous: Frame | None = None


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one frame gave.

    Attributes:
        state: the state after it.
        metrics: one entry per live target.
        events: decisions and faults, in order.
        covariances: target id -> covariance (D, D) of its belief.
        seconds: agent (or planes, belief, measure, learn) -> seconds, summed over targets.
    """

    state: State
    metrics: tuple[FrameMetrics, ...]
    events: tuple[Event, ...]
    covariances: Mapping[str, Floats] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)


# ------------------------------------------------------------------------------------ starting


def start_target(
    engine: Engine, state: State, frame: Frame, target: str, template: str, box: Floats
) -> Outcome:
    """Start a net for the target inside the centre box (4,) of `frame`: references learnt, belief placed.

    The belief of the first frame is the box itself; hypotheses spread with the first prediction. An agent
    that cannot learn its reference, or that needs colour where the frame has none, is out from the start.
    """
    machine = engine.machinery[template]
    active = tuple(agent for agent in machine.plate.agents if machine.plate.agent(agent).active)
    stream = partial(engine.streams.of, target, machine.plate.root, frame.index)
    # Another target that started in this frame has made it the state's last one.
    previous = state.previous if state.previous is None or state.previous.index < frame.index else None
    references, faults = learn_first(machine.cues, PlaneCache(FramePair(frame, previous)), box)
    if not frame.has_color:
        faults |= dict.fromkeys(sorted(machine.color_agents), "needs colour, and the source is gray")
    x, y, w, h = (float(v) for v in box)
    decisions: list[Decision] = [
        TargetStarted(frame.index, target, template, (x, y, w, h), active),
        *_quarantined(frame.index, target, faults),
    ]
    working = tuple(agent for agent in active if agent not in faults)
    born = TargetState(
        belief=machine.belief.start(box, Confined(machine.motion, frame.width, frame.height), stream),
        references=references,
        memory=Memory(),
        plan=compile_plan(machine.plate, working, machine.cues),
        time=frame.time,
    )
    metrics = first_frame_metrics(frame, target, len(born.belief), working, box)
    after = State(_applied(state.net, decisions), {**state.targets, target: born}, frame)
    return Outcome(after, (metrics,), tuple(decisions))


# ------------------------------------------------------------------------------------ stepping


def step(engine: Engine, state: State, frame: Frame) -> Outcome:
    """One frame for every live target.

    Raises:
        ValueError: the frame is not later than the last one.
    """
    if state.previous is not None and not frame.time > state.previous.time:
        raise ValueError(f"frame {frame.index} at time {frame.time} is not later than {state.previous.time}")
    cache = PlaneCache(FramePair(frame, state.previous))
    seconds: dict[str, float] = {}
    net, targets = state.net, {}
    metrics: list[FrameMetrics] = []
    events: list[Event] = []
    covariances: dict[str, Floats] = {}
    for target in state.targets:
        one = _step_target(engine, state, frame, cache, target, seconds)
        net = _applied(net, one.decisions)
        targets[target] = _recompiled(engine, net, target, one.state)
        metrics.append(one.metrics)
        covariances[target] = one.covariance
        events += [*one.told, *one.decisions]
    return Outcome(State(net, targets, frame), tuple(metrics), tuple(events), covariances, seconds)


@dataclass(frozen=True, eq=False)
class _TargetOutcome:
    state: TargetState
    metrics: FrameMetrics
    decisions: tuple[Decision, ...]
    told: tuple[Event, ...]
    covariance: Floats


def _step_target(
    engine: Engine, state: State, frame: Frame, cache: PlaneCache, target: str, seconds: dict[str, float]
) -> _TargetOutcome:
    before, live = state.targets[target], state.net.targets[target]
    machine = engine.machinery[live.template]
    root = machine.plate.inference(machine.plate.root)
    stream = partial(engine.streams.of, target, machine.plate.root, frame.index)

    started = engine.clock()
    observer = Observer(cache, machine.cues, before.references, stream, engine.clock, seconds)
    stepped = machine.belief.step(
        before.belief,
        Confined(machine.motion, frame.width, frame.height),
        frame.time - before.time,
        partial(evaluate, before.plan, observer),
        stream,
    )
    box = _inside(estimate(root.estimate, stepped)[:4], frame)
    started = _charge(engine, seconds, "belief", started)

    faults = _quarantined(frame.index, target, observer.faults)
    working = _applied(state.net, faults).targets[target]
    measures = measure(machine.plate, before.plan, stepped, float(box[2] * box[3]))
    now = Situation(
        frame.index, target, machine.plate, working, measures, machine.costs_ms, machine.adaptable
    )
    chosen, memory = decide(now, before.memory)
    started = _charge(engine, seconds, "measure", started)

    quiet = quiet_level(machine.plate, working, memory, machine.plate.root)
    rate = learning_rate(root.learn, measures.ud_px2[machine.plate.root], measures.area_px2, quiet)
    if working.status == "lost" or not working.active or stepped.degenerate is not None:
        rate = 0.0
    rates = {
        agent: rate * most for agent, most in machine.rate_max.items() if agent not in working.quarantined
    }
    references, decisions = _learn(now, machine, before.references, rates, cache, box, chosen)
    _charge(engine, seconds, "learn", started)

    after = TargetState(stepped.posterior, references, memory, before.plan, frame.time)
    told = [report(frame.index, target) for report in stepped.reports]
    if stepped.degenerate is not None:
        told.append(DegenerateBelief(frame.index, target, stepped.degenerate))
    spread = stepped.posterior.covariance
    metrics = frame_metrics(
        frame, target, machine.plate, live.status, stepped, measures, box, spread, quiet, rate, stream
    )
    return _TargetOutcome(after, metrics, (*faults, *decisions), tuple(told), spread)


def _learn(
    now: Situation,
    machine: Machinery,
    references: Mapping[str, Reference],
    rates: Mapping[str, float],
    cache: PlaneCache,
    box: Floats,
    chosen: tuple[Decision, ...],
) -> tuple[dict[str, Reference], tuple[Decision, ...]]:
    """Move all references, then carry out local actions.

    Returns:
        The references, and the decisions that stand: those chosen, without actions that found nothing left to
        try, and the quarantine of agents that failed here.
    """
    moved, faults = learn_references(references, machine.cues, rates, cache, box)
    kept: list[Decision] = []
    for decision in chosen:
        if isinstance(decision, LocallyAdapted):
            cue = machine.cues[decision.node]
            assert isinstance(cue, LocallyAdaptable)
            if decision.node in faults:
                continue
            tuned = adapt_reference(cue, moved[decision.node], decision.attempt)
            if isinstance(tuned, str):
                faults[decision.node] = tuned
            if tuned is None or isinstance(tuned, str):
                continue
            moved[decision.node] = tuned
        kept.append(decision)
    return moved, (*kept, *_quarantined(now.frame, now.target, faults))


def _quarantined(frame: int, target: str, faults: Mapping[str, str]) -> tuple[Quarantined, ...]:
    return tuple(Quarantined(frame, target, agent, reason) for agent, reason in faults.items())


def _applied(net: Net, decisions: Iterable[Decision]) -> Net:
    for decision in decisions:
        net = apply(net, decision)
    return net


def _recompiled(engine: Engine, net: Net, target: str, state: TargetState) -> TargetState:
    """The state with its plan compiled again when its active agents changed."""
    live = net.targets[target]
    if live.active == state.plan.active:
        return state
    machine = engine.machinery[live.template]
    return replace(state, plan=compile_plan(machine.plate, live.active, machine.cues))


def _inside(box: Floats, frame: Frame) -> Floats:
    """The box with its centre on the image, so that tracks and references stay meaningful."""
    return np.array(
        [
            min(max(box[0], 0.0), frame.width - 1.0),
            min(max(box[1], 0.0), frame.height - 1.0),
            min(max(box[2], 1.0), 2.0 * frame.width),
            min(max(box[3], 1.0), 2.0 * frame.height),
        ]
    )


def _charge(engine: Engine, seconds: dict[str, float], name: str, started: float) -> float:
    now = engine.clock()
    seconds[name] = seconds.get(name, 0.0) + now - started
    return now
