"""State of the engine between frames, the outcome of one frame, and the work that a late run sheds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from bayesnet_track.adapt.identities import PlateIdentities
from bayesnet_track.adapt.joins import JoinMemory, decide_joins
from bayesnet_track.adapt.lifecycle import TrackHistory
from bayesnet_track.adapt.shedding import Load, Running, balance
from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.engine.compiled import Engine
from bayesnet_track.engine.finishing import Results
from bayesnet_track.engine.frame_context import ExternalInputs, FrameContext
from bayesnet_track.engine.groups import AgentMessages
from bayesnet_track.engine.joining import JointBelief, reaches_of
from bayesnet_track.engine.lines import Lines
from bayesnet_track.engine.state import TargetState, with_agents
from bayesnet_track.engine.targets import Records, Targets
from bayesnet_track.graph.spec import Particles
from bayesnet_track.inference.queries import QueryMemory
from bayesnet_track.journal.events.event import Event, Input
from bayesnet_track.journal.events.load import LateFrame, SpareTime
from bayesnet_track.journal.metrics import Answers
from bayesnet_track.journal.net import Decision, Net, apply_decisions
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.planes import Frame
from bayesnet_track.vision.planes import Scene


@dataclass(frozen=True, eq=False)
class State:
    """The engine's state between frames.

    Attributes:
        net: the live nets.
        targets: target id -> its state.
        previous: the last frame.
        history: what is remembered of births and deaths.
        joins: what is remembered of targets that depend on each other.
        load: what is remembered of late frames.
        scene: what the last frame showed that showed anything; None where no graph asks for cuts.
        queries: memory of the queries of the graph.
        identities: plate with `identity` -> who may be whom.
    """

    net: Net = field(default_factory=Net)
    targets: Mapping[str, TargetState] = field(default_factory=dict)
    previous: Frame | None = None
    history: TrackHistory = field(default_factory=TrackHistory)
    joins: JoinMemory = field(default_factory=JoinMemory)
    load: Load = field(default_factory=Load)
    scene: Scene | None = None
    queries: QueryMemory = field(default_factory=QueryMemory)
    identities: Mapping[str, PlateIdentities] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of one frame.

    Attributes:
        state: the state after it.
        metrics: one entry per live target, made when they are asked for.
        events: decisions and faults, in order.
        covariances: target id -> covariance (D, D) of its belief.
        seconds: agent (or planes, belief, measure, learn) -> seconds, summed over targets.
        external_inputs: what came from outside: given again with this frame, it repeats.
        heard: target id -> what its agents said.
        answers: answers to the queries of the graph, in its order.
        cameras: camera -> how far its detections were from where targets were expected.
    """

    state: State
    metrics: Lines
    events: tuple[Event, ...]
    covariances: Mapping[str, Floats] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    external_inputs: tuple[Input, ...] = ()
    heard: Mapping[str, AgentMessages] = field(default_factory=dict)
    answers: tuple[Answers, ...] = ()
    cameras: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def carry_out(work: FrameContext, state: State, results: Results, joint: JointBelief) -> Outcome:
    """The outcome of the targets' frames: decisions are carried out, of tables first."""
    net, singles = work.net, dict[str, TargetState]()
    events: list[Event] = [*joint.events]
    for rows_result in results.gaussians:
        net = apply_decisions(net, rows_result.decided)
        events += rows_result.table_events
    for target, (group, row) in results.singles.items():
        decisions = group.decisions(row)
        net = apply_decisions(net, decisions)
        singles[target] = _recompile(work.engine, net, target, group.state(row))
        events += [*group.events(row), *decisions]
    gaussians = [
        rows for rows_result in results.gaussians if (rows := rows_result.table(net.targets)) is not None
    ]
    particles = [
        table for group_result in results.groups if (table := group_result.table(net.targets)) is not None
    ]
    targets: Mapping[str, TargetState] = singles
    if gaussians or particles:
        targets = Targets(gaussians, particles, singles, results.others)
    history = state.history
    if gaussians:
        single_records = {
            target: history.records[target] for target in results.others if target in history.records
        }
        history = evolve(history, records=Records(gaussians, single_records))
    return Outcome(
        evolve(state, net=net, targets=targets, previous=work.frame, joins=joint.memory, history=history),
        results.lines,
        tuple(events),
        results.covariances,
        work.seconds,
        heard=results.heard,
    )


def with_joins(work: FrameContext, outcome: Outcome) -> Outcome:
    """The outcome after the frame's joins and partings; as it is where the graph has no joins."""
    joins = work.engine.joins
    if not joins:
        return outcome
    state, start = outcome.state, work.engine.clock()
    reaches = reaches_of(*_moments_of(state.targets, outcome.covariances))
    decisions, memory = decide_joins(work.frame.index, joins, state.net, reaches, state.joins)
    work.charge("joins", start)
    joined = evolve(state, net=apply_decisions(state.net, decisions), joins=memory)
    return evolve(outcome, state=joined, events=(*outcome.events, *decisions), seconds=work.seconds)


def _moments_of(
    targets: Mapping[str, TargetState], covariances: Mapping[str, Floats]
) -> tuple[list[str], Floats, Floats]:
    """The targets, and of their beliefs the means (T, 4) and variances (T, 4) of the boxes.

    `covariances` has covariances (D, D) that were found before.
    """
    names = list(targets)
    boxes, variances = np.empty((len(names), 4)), np.empty((len(names), 4))
    index = dict(zip(names, range(len(names)), strict=True))
    split = Targets.of(targets)
    for table in split.particles:
        rows = [index[target] for target in table.ids]
        boxes[rows], variances[rows] = table.clouds.box_moments
    for target, state in split.others.items():
        spread = covariances.get(target)
        boxes[index[target]] = state.belief.mean[:4]
        variances[index[target]] = (state.belief.covariance if spread is None else spread).diagonal()[:4]
    return names, boxes, variances


def with_load(work: FrameContext, outcome: Outcome, timing: Iterable[LateFrame | SpareTime]) -> Outcome:
    """The outcome after what is shed or taken back, where a frame was late or early."""
    timing, state, engine = tuple(timing), outcome.state, work.engine
    if not timing:
        if not state.load.late and state.load.back is None:  # nothing is remembered whose age matters
            return outcome
        _, load = balance(work.frame.index, (), {}, state.load)
        return evolve(outcome, state=evolve(state, load=load))
    decisions, load = _balance_load(engine, state.net, state.targets, timing, state.load, work.frame.index)
    net = apply_decisions(state.net, decisions)
    targets = {
        target: _recompile(engine, net, target, target_state)
        for target, target_state in state.targets.items()
    }
    balanced = evolve(state, net=net, targets=targets, load=load)
    return evolve(outcome, state=balanced, events=(*outcome.events, *decisions))


def with_external_inputs(outcome: Outcome, inputs: ExternalInputs) -> Outcome:
    """The outcome with what came from outside, its notices first."""
    if not (inputs.inputs or inputs.availability.reported):
        return outcome
    notices: tuple[Event, ...] = (*inputs.availability.events, *inputs.refused)
    return evolve(outcome, events=(*notices, *outcome.events), external_inputs=inputs.to_repeat)


def _recompile(engine: Engine, net: Net, target: str, state: TargetState) -> TargetState:
    """The state with its plan compiled again when its active agents changed."""
    live = net.targets[target]
    return with_agents(engine.plates[live.template], state, live.active)


LEAST_SHARE, LEAST = 8, 100
"""A fixed number of hypotheses is cut to an eighth at most, and never below this."""


def _balance_load(
    engine: Engine,
    net: Net,
    targets: Mapping[str, TargetState],
    timing: Iterable[LateFrame | SpareTime],
    load: Load,
    frame: int,
) -> tuple[tuple[Decision, ...], Load]:
    """Decisions to shed or take back in this frame, and the memory after it."""
    running = {target: _running(engine, net, target, state) for target, state in targets.items()}
    return balance(frame, timing, running, load)


def _running(engine: Engine, net: Net, target: str, state: TargetState) -> Running:
    live = net.targets[target]
    compiled = engine.plates[live.template]
    parts = (compiled.plate, live, state.memory, compiled.costs_ms)
    if not isinstance(compiled.belief, ParticleFilter):
        return Running(*parts)
    low, high = _bounds(compiled.belief.settings)
    return Running(*parts, len(state.belief), low, high)


def _bounds(settings: Particles) -> tuple[int, int]:
    if isinstance(settings.size, int):
        return max(settings.size // LEAST_SHARE, min(LEAST, settings.size)), settings.size
    return settings.least, settings.most
