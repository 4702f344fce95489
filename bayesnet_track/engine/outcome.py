"""What the engine knows between frames, and what one frame gave."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from bayesnet_track.adapt.joins import JoinMemory, decide_joins
from bayesnet_track.adapt.lifecycle import TrackHistory
from bayesnet_track.adapt.shedding import Load
from bayesnet_track.engine.external_inputs import ExternalInputs
from bayesnet_track.engine.findings import Heard, TargetResult
from bayesnet_track.engine.frame_metrics import Lines, WhenAsked
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.joining import JointBelief, reaches_of
from bayesnet_track.engine.shedding import balance_load
from bayesnet_track.engine.state import TargetState, apply_decisions, recompile
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.inputs import Input
from bayesnet_track.journal.events.load import LateFrame, SpareTime
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net.net import Net
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.planes import Frame
from bayesnet_track.vision.scenes import Scene


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
    """

    net: Net = field(default_factory=Net)
    targets: Mapping[str, TargetState] = field(default_factory=dict)
    previous: Frame | None = None
    history: TrackHistory = field(default_factory=TrackHistory)
    joins: JoinMemory = field(default_factory=JoinMemory)
    load: Load = field(default_factory=Load)
    scene: Scene | None = None


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one frame gave.

    Attributes:
        state: the state after it.
        metrics: one entry per live target, made when they are asked for.
        events: decisions and faults, in order.
        covariances: target id -> covariance (D, D) of its belief.
        seconds: agent (or planes, belief, measure, learn) -> seconds, summed over targets.
        external_inputs: what came from outside: given again with this frame, it repeats.
        heard: target id -> what its agents said.
    """

    state: State
    metrics: Sequence[FrameMetrics]
    events: tuple[Event, ...]
    covariances: Mapping[str, Floats] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    external_inputs: tuple[Input, ...] = ()
    heard: Mapping[str, Heard] = field(default_factory=dict)


def carry_out(
    work: FrameWork, state: State, results: Mapping[str, TargetResult], joint: JointBelief
) -> Outcome:
    """The outcome of the targets' frames, in the order of `results`: decisions are carried out."""
    net, targets = work.net, {}
    events: list[Event] = [*joint.events]
    for target, result in results.items():
        net = apply_decisions(net, result.decisions)
        targets[target] = recompile(work.engine, net, target, result.state)
        events += [*result.events, *result.decisions]
    boxes = {target: result.box for target, result in results.items()}
    return Outcome(
        replace(state, net=net, targets=targets, previous=work.frame, joins=joint.memory),
        Lines([result.line for result in results.values()], boxes) if results else (),
        tuple(events),
        WhenAsked({target: result.covariance for target, result in results.items()}),
        work.seconds,
        heard=WhenAsked({target: result.heard for target, result in results.items()}),
    )


def with_joins(work: FrameWork, outcome: Outcome) -> Outcome:
    """The outcome after the frame's joins and partings; as it is where the graph has no joins."""
    joins = work.engine.joins
    if not joins:
        return outcome
    state, started = outcome.state, work.engine.clock()
    spreads = [
        one.belief.covariance if (known := outcome.covariances.get(target)) is None else known
        for target, one in state.targets.items()
    ]
    beliefs = {target: one.belief for target, one in state.targets.items()}
    reaches = dict(zip(beliefs, reaches_of(list(beliefs.values()), spreads), strict=True))
    decisions, memory = decide_joins(work.frame.index, joins, state.net, reaches, state.joins)
    work.charge("joins", started)
    after = replace(state, net=apply_decisions(state.net, decisions), joins=memory)
    return replace(outcome, state=after, events=(*outcome.events, *decisions), seconds=work.seconds)


def with_load(work: FrameWork, outcome: Outcome, timing: Iterable[LateFrame | SpareTime]) -> Outcome:
    """The outcome after what is shed or taken back, where a frame was late or early."""
    timing = tuple(timing)
    if not timing:
        return outcome
    state, engine = outcome.state, work.engine
    decisions, load = balance_load(engine, state.net, state.targets, timing, state.load, work.frame.index)
    net = apply_decisions(state.net, decisions)
    targets = {target: recompile(engine, net, target, one) for target, one in state.targets.items()}
    after = replace(state, net=net, targets=targets, load=load)
    return replace(outcome, state=after, events=(*outcome.events, *decisions))


def with_external_inputs(outcome: Outcome, given: ExternalInputs) -> Outcome:
    """The outcome with what came from outside, its notices first."""
    notices: tuple[Event, ...] = (*given.availability.events, *given.refused)
    return replace(outcome, events=(*notices, *outcome.events), external_inputs=given.to_repeat)
