"""The engine: one step of every live net for one frame.

`step` reads as: predict and weigh the belief, measure it, decide what changes, learn the references. It is a
function of the engine (graph and seed), the state and the frame; time is read for the timings only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.learn import learn_first, learn_references, learning_rate
from bayesnet_track.adapt.measure import measure
from bayesnet_track.adapt.memory import Memory, Quiet
from bayesnet_track.adapt.rules import Situation, decide
from bayesnet_track.belief.bounds import Confined
from bayesnet_track.belief.contract import Motion
from bayesnet_track.belief.estimate import covariance, estimate
from bayesnet_track.belief.motion import make_motion
from bayesnet_track.belief.particles import ParticleFilter, ParticleSet
from bayesnet_track.cue import Cue, CueDeclaration, LocallyAdaptable, Reference, installed_cues
from bayesnet_track.frame_metrics import first_frame_metrics, frame_metrics
from bayesnet_track.graph.checked import CheckedGraph, CheckedTarget
from bayesnet_track.graph.net import Decision, LocallyAdapted, Net, Quarantined, TargetStarted, apply
from bayesnet_track.graph.spec import Learn, Particles
from bayesnet_track.inference.compile import Plan, compile_plan
from bayesnet_track.inference.messages import Observer, evaluate
from bayesnet_track.journal.events import DegenerateBelief, Event, FrameMetrics
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.planes import Frame, FramePair, PlaneCache

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Machinery:
    """What one plate needs to run, made once: cues, belief, motion model and prices.

    Attributes:
        plate: the checked plate.
        cues: agent -> implementation.
        belief: the root's belief.
        motion: the root's motion model.
        costs_ms: agent -> declared cost.
        rate_max: agent -> largest learning rate.
        adaptable: agents that can act locally.
    """

    plate: CheckedTarget
    cues: Mapping[str, Cue]
    belief: ParticleFilter
    motion: Motion
    costs_ms: Mapping[str, float]
    rate_max: Mapping[str, float]
    adaptable: frozenset[str]


@dataclass(frozen=True, eq=False)
class Engine:
    """A graph ready to run.

    Attributes:
        machinery: plate name -> what it needs.
        streams: all randomness.
        clock: seconds, for timings only.
    """

    machinery: Mapping[str, Machinery]
    streams: Streams
    clock: Callable[[], float] = time.perf_counter


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

    belief: ParticleSet
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


def make_engine(
    graph: CheckedGraph, seed: int = 0, cues: Mapping[str, CueDeclaration] | None = None
) -> Engine:
    """Load the cues of `graph` and make it ready to run."""
    declarations = installed_cues() if cues is None else cues
    machinery = {name: _make_machinery(plate, declarations) for name, plate in graph.targets.items()}
    return Engine(machinery, Streams(seed))


def _make_machinery(plate: CheckedTarget, declarations: Mapping[str, CueDeclaration]) -> Machinery:
    root = plate.inference(plate.root)
    particles = root.belief.particles if root.belief is not None else None
    of = {agent: declarations[plate.agent(agent).agent.cue] for agent in plate.agents}
    made = {agent: of[agent].make(plate.parameters[agent]) for agent in plate.agents}
    assert root.motion is not None
    return Machinery(
        plate=plate,
        cues=made,
        belief=ParticleFilter(particles or Particles()),
        motion=make_motion(root.motion),
        costs_ms={agent: of[agent].cost_ms for agent in plate.agents},
        rate_max={agent: _rate_max(plate, agent, of[agent], root.learn) for agent in plate.agents},
        adaptable=frozenset(agent for agent, cue in made.items() if isinstance(cue, LocallyAdaptable)),
    )


def _rate_max(plate: CheckedTarget, agent: str, declaration: CueDeclaration, learn: Learn | None) -> float:
    """The agent's own rate, else its cue's, else the graph's."""
    own = plate.agent(agent).learn_rate_max
    for rate in (own, declaration.rate_max):
        if rate is not None:
            return rate
    return learn.rate_max if learn is not None else 0.0


# ------------------------------------------------------------------------------------ starting


def start_target(
    engine: Engine, state: State, frame: Frame, target: str, template: str, box: Floats
) -> Outcome:
    """Start a net for the target inside the centre box (4,) of `frame`: references learnt, belief placed.

    The belief of the first frame is the box itself; hypotheses spread with the first prediction.
    """
    machine = engine.machinery[template]
    active = tuple(agent for agent in machine.plate.agents if machine.plate.agent(agent).active)
    decision = TargetStarted(frame.index, target, template, tuple(float(v) for v in box), active)
    stream = partial(engine.streams.of, target, machine.plate.root, frame.index)
    cache = PlaneCache(FramePair(frame, state.previous))
    born = TargetState(
        belief=machine.belief.start(box, machine.motion, stream),
        references=learn_first(machine.cues, cache, box),
        memory=Memory(),
        plan=compile_plan(machine.plate, active, machine.cues),
        time=frame.time,
    )
    metrics = first_frame_metrics(frame, target, born.belief, active, box)
    return Outcome(
        State(apply(state.net, decision), {**state.targets, target: born}, frame), (metrics,), (decision,)
    )


# ------------------------------------------------------------------------------------ stepping


def step(engine: Engine, state: State, frame: Frame) -> Outcome:
    """One frame for every live target."""
    cache = PlaneCache(FramePair(frame, state.previous))
    seconds: dict[str, float] = {}
    net, targets = state.net, {}
    metrics: list[FrameMetrics] = []
    events: list[Event] = []
    covariances: dict[str, Floats] = {}
    for target in state.targets:
        one = _step_target(engine, state, frame, cache, target, seconds)
        for decision in one.decisions:
            net = apply(net, decision)
        targets[target] = _recompiled(engine, net, target, one.state)
        metrics.append(one.metrics)
        covariances[target] = one.covariance
        events += [*one.faults, *one.decisions]
    return Outcome(State(net, targets, frame), tuple(metrics), tuple(events), covariances, seconds)


@dataclass(frozen=True, eq=False)
class _TargetOutcome:
    state: TargetState
    metrics: FrameMetrics
    decisions: tuple[Decision, ...]
    faults: tuple[Event, ...]
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
        max(frame.time - before.time, 0.0),
        partial(evaluate, before.plan, observer),
        stream,
    )
    box = _inside(estimate(root.estimate, stepped.posterior, stepped)[:4], frame)
    started = _charge(engine, seconds, "belief", started)

    faults: list[Decision] = [
        Quarantined(frame.index, target, agent, reason) for agent, reason in stepped.evidence.faults.items()
    ]
    measures = measure(machine.plate, before.plan, stepped, float(box[2] * box[3]))
    net = state.net
    for fault in faults:
        net = apply(net, fault)
    now = Situation(
        frame.index, target, machine.plate, net.targets[target], measures, machine.costs_ms, machine.adaptable
    )
    chosen, memory = decide(now, before.memory)
    started = _charge(engine, seconds, "measure", started)

    quiet = memory.quiet.get(machine.plate.root, Quiet()).level_px2
    rate = learning_rate(root.learn, measures.ud_px2[machine.plate.root], measures.area_px2, quiet)
    if live.status == "lost" or not before.plan.active:
        rate = 0.0
    rates = {
        agent: rate * most
        for agent, most in machine.rate_max.items()
        if agent not in net.targets[target].quarantined
    }
    references, adapted, broken = _learn(
        machine, before.references, rates, cache, box, chosen, frame.index, target
    )
    _charge(engine, seconds, "learn", started)

    after = TargetState(stepped.posterior, references, memory, before.plan, frame.time)
    degenerate = (
        () if stepped.degenerate is None else (DegenerateBelief(frame.index, target, stepped.degenerate),)
    )
    metrics = frame_metrics(
        frame, target, machine.plate, live.status, stepped, measures, box, quiet, rate, stream
    )
    return _TargetOutcome(
        after, metrics, (*faults, *adapted, *broken), degenerate, covariance(stepped.posterior)
    )


def _learn(
    machine: Machinery,
    references: Mapping[str, Reference],
    rates: Mapping[str, float],
    cache: PlaneCache,
    box: Floats,
    chosen: tuple[Decision, ...],
    frame: int,
    target: str,
) -> tuple[dict[str, Reference], tuple[Decision, ...], tuple[Decision, ...]]:
    """Move all references, then carry out local actions; an action with nothing left to try is not logged."""
    moved, broken = dict(references), []
    for agent, rate in rates.items():
        try:
            moved |= learn_references(
                {agent: references[agent]}, {agent: machine.cues[agent]}, {agent: rate}, cache, box
            )
        except Exception as error:  # as in evaluation: a cue's fault must not end the run
            reason = f"raised {type(error).__name__} while learning: {error}"
            broken.append(Quarantined(frame, target, agent, reason))
    kept: list[Decision] = []
    for decision in chosen:
        if isinstance(decision, LocallyAdapted):
            cue = machine.cues[decision.node]
            assert isinstance(cue, LocallyAdaptable)
            tuned = cue.adapt(moved[decision.node], decision.attempt)
            if tuned is None:
                continue
            moved[decision.node] = tuned
        kept.append(decision)
    return moved, tuple(kept), tuple(broken)


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
