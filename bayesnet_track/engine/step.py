"""The engine: one step of every live net for one frame.

`step` reads as: sort out what came from outside, weigh every target's belief by its own agents, weigh those
of joined targets together, then measure, decide and learn for each. It is a function of the engine (graph and
seed), the state, the frame and what came from outside; time is read for the timings only.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.joins import JoinMemory, decide_joins
from bayesnet_track.adapt.lifecycle import Life
from bayesnet_track.adapt.shedding import Load
from bayesnet_track.engine.compiled import Engine, Machinery, make_engine
from bayesnet_track.engine.crew import advance, send_off
from bayesnet_track.engine.joining import Together, join_all, reach_of, weigh_all
from bayesnet_track.engine.lifecycle.claiming import Looked, look_first
from bayesnet_track.engine.lifecycle.people import Population
from bayesnet_track.engine.lifecycle.population import live
from bayesnet_track.engine.outside import Outside, sorted_out
from bayesnet_track.engine.shedding import balanced
from bayesnet_track.engine.starting import start
from bayesnet_track.engine.state import TargetState, applied, recompiled
from bayesnet_track.engine.target import Weighed, conclude
from bayesnet_track.journal.events.basic import Event, FrameMetrics
from bayesnet_track.journal.events.inputs import Input
from bayesnet_track.journal.net.net import Net
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache

__all__ = [
    "Engine",
    "Machinery",
    "Outcome",
    "State",
    "TargetState",
    "first_look",
    "make_engine",
    "start_target",
    "step",
]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class State:
    """The engine's state between frames.

    Attributes:
        net: the live nets.
        targets: target id -> its state.
        previous: the last frame.
        life: what is remembered of births and deaths.
        joins: what is remembered of targets that depend on each other.
        load: what is remembered of late frames.
    """

    net: Net = field(default_factory=Net)
    targets: Mapping[str, TargetState] = field(default_factory=dict)
    previous: Frame | None = None
    life: Life = field(default_factory=Life)
    joins: JoinMemory = field(default_factory=JoinMemory)
    load: Load = field(default_factory=Load)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one frame gave.

    Attributes:
        state: the state after it.
        metrics: one entry per live target.
        events: decisions and faults, in order.
        covariances: target id -> covariance (D, D) of its belief.
        seconds: agent (or planes, belief, measure, learn) -> seconds, summed over targets.
        outside: what came from outside: given again with this frame, it repeats.
    """

    state: State
    metrics: tuple[FrameMetrics, ...]
    events: tuple[Event, ...]
    covariances: Mapping[str, Floats] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    outside: tuple[Input, ...] = ()


def start_target(
    engine: Engine, state: State, frame: Frame, target: str, template: str, box: Floats
) -> Outcome:
    """Start a net for the target inside the centre box (4,) of `frame`; see `engine.starting.start`."""
    # Another target that started in this frame has made it the state's last one.
    previous = state.previous if state.previous is None or state.previous.index < frame.index else None
    born = start(engine, frame, previous, target, template, box)
    net, targets = applied(state.net, born.decisions), {**state.targets, target: born.state}
    after = replace(state, net=net, targets=targets, previous=frame)
    return Outcome(after, (born.metrics,), born.decisions)


def first_look(engine: Engine, started: Outcome, frame: Frame) -> Outcome:
    """The first frame's outcome: what the detectors find in it besides the targets that started there."""
    return _joined(engine, _lived(engine, started, frame, None, PlaneCache(FramePair(frame, None))), frame)


def step(engine: Engine, state: State, frame: Frame, outside: Iterable[Input] = ()) -> Outcome:
    """One frame for every live target, given what came from `outside`.

    Raises:
        ValueError: the frame is not later than the last one.
    """
    if state.previous is not None and not frame.time > state.previous.time:
        raise ValueError(f"frame {frame.index} at time {frame.time} is not later than {state.previous.time}")
    given = sorted_out(engine, state.net, frame.index, outside)
    engine = replace(engine, absent=given.absent)
    cache = PlaneCache(FramePair(frame, state.previous))
    seconds: dict[str, float] = {}
    started = engine.clock()
    looked = look_first(engine, state.net, state.targets, state.life, frame, state.previous, cache)
    known, life = (state.targets, state.life) if looked is None else (looked.targets, looked.life)
    if looked is not None:
        seconds["life"] = engine.clock() - started
    elsewhere = send_off(engine, state.net, known, cache.frames, given)
    here = {target: one for target, one in known.items() if target not in elsewhere.targets}
    weighed = weigh_all(engine, state.net, here, state.joins, frame, cache, seconds)
    together = _together(engine, state, weighed, frame, cache, seconds)
    concluded = {
        one.target: conclude(
            engine,
            state.net,
            one,
            frame,
            cache,
            seconds,
            together.metrics.get(one.target),
            given.by_hand.get(one.target, ()),
        )
        for one in together.weighed
    }
    advanced = elsewhere.awaited()
    for target in sorted(elsewhere.targets):
        one = advanced.get(target) or advance(engine, state.net, target, known[target], cache)
        concluded[target] = one.done
        for part, spent in one.seconds.items():
            seconds[part] = seconds.get(part, 0.0) + spent
    net, targets = state.net, {}
    metrics: list[FrameMetrics] = []
    events: list[Event] = [*together.told]
    covariances: dict[str, Floats] = {}
    for target in known:
        done = concluded[target]
        net = applied(net, done.decisions)
        targets[target] = recompiled(engine, net, target, done.state)
        metrics.append(done.metrics)
        covariances[target] = done.covariance
        events += [*done.told, *done.decisions]
    after = State(net, targets, frame, life, together.memory, state.load)
    outcome = Outcome(after, tuple(metrics), tuple(events), covariances, seconds)
    outcome = _joined(engine, _lived(engine, outcome, frame, state.previous, cache, looked), frame)
    return with_outside(_in_time(engine, outcome, given, frame), given)


def with_outside(outcome: Outcome, given: Outside) -> Outcome:
    """The outcome with what came from outside, its notices first."""
    told: tuple[Event, ...] = (*given.absent.events, *given.refused)
    return replace(outcome, events=(*told, *outcome.events), outside=given.taken)


def _in_time(engine: Engine, outcome: Outcome, given: Outside, frame: Frame) -> Outcome:
    """The outcome after what is shed or taken back, where a frame was late or early."""
    if not given.timing:
        return outcome
    state = outcome.state
    decisions, load = balanced(engine, state.net, state.targets, given.timing, state.load, frame.index)
    net = applied(state.net, decisions)
    targets = {target: recompiled(engine, net, target, one) for target, one in state.targets.items()}
    after = replace(state, net=net, targets=targets, load=load)
    return replace(outcome, state=after, events=(*outcome.events, *decisions))


def _lived(
    engine: Engine,
    outcome: Outcome,
    frame: Frame,
    previous: Frame | None,
    cache: PlaneCache,
    looked: Looked | None = None,
) -> Outcome:
    """The outcome after the frame's births, returns and deaths; as it is where no plate has any."""
    if all(machine.life is None for machine in engine.machinery.values()):
        return outcome
    state, seconds, started = outcome.state, dict(outcome.seconds), engine.clock()
    people = Population(state.net, dict(state.targets), list(outcome.metrics), state.life)
    live(engine, people, frame, previous, cache, looked)
    seconds["life"] = seconds.get("life", 0.0) + engine.clock() - started
    return Outcome(
        replace(state, net=people.net, targets=people.targets, previous=frame, life=people.life),
        tuple(people.metrics),
        (*outcome.events, *people.events),
        outcome.covariances,
        seconds,
    )


def _together(
    engine: Engine,
    state: State,
    weighed: tuple[Weighed, ...],
    frame: Frame,
    cache: PlaneCache,
    seconds: dict[str, float],
) -> Together:
    """The joint beliefs of the frame; every target as it was weighed where the graph has no joins."""
    if not engine.joins:
        return Together(weighed, {}, (), state.joins)
    started = engine.clock()
    together = join_all(engine, state.net, state.joins, weighed, frame, cache)
    seconds["joins"] = engine.clock() - started
    return together


def _joined(engine: Engine, outcome: Outcome, frame: Frame) -> Outcome:
    """The outcome after the frame's joins and partings; as it is where the graph has no joins."""
    if not engine.joins:
        return outcome
    state, seconds, started = outcome.state, dict(outcome.seconds), engine.clock()
    reaches = {
        target: reach_of(one.belief, outcome.covariances.get(target)) for target, one in state.targets.items()
    }
    decisions, memory = decide_joins(frame.index, engine.joins, state.net, reaches, state.joins)
    seconds["joins"] = seconds.get("joins", 0.0) + engine.clock() - started
    return replace(
        outcome,
        state=replace(state, net=applied(state.net, decisions), joins=memory),
        events=(*outcome.events, *decisions),
        seconds=seconds,
    )
