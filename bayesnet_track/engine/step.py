"""The engine: one step of every live net for one frame.

It is a function of the engine (graph and seed), the state, the frame and what came from outside; time is read
for the timings only.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from bayesnet_track.engine.attachment import Rides
from bayesnet_track.engine.compiled import CompiledPlate, Engine, make_engine
from bayesnet_track.engine.external_inputs import ExternalInputs, route_inputs
from bayesnet_track.engine.filtering import Filtered, filter_target
from bayesnet_track.engine.finishing import finish_targets
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.joining import join_targets
from bayesnet_track.engine.lifecycle.association import Associated, associate_first
from bayesnet_track.engine.lifecycle.track_management import manage_tracks
from bayesnet_track.engine.outcome import (
    Outcome,
    State,
    carry_out,
    with_external_inputs,
    with_joins,
    with_load,
)
from bayesnet_track.engine.rows.advancing import advance_rows
from bayesnet_track.engine.rows.filtered_rows import Together
from bayesnet_track.engine.rows.finding import find_rows
from bayesnet_track.engine.rows.particle_rows import filter_rows
from bayesnet_track.engine.scoring.scene_cuts import find_cuts
from bayesnet_track.engine.starting import start
from bayesnet_track.engine.state import TargetState
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.inputs import Input
from bayesnet_track.journal.events.statuses import SceneCut
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net.net import apply_decisions
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import changed
from bayesnet_track.numerics.streams import birth_key
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache

__all__ = [
    "CompiledPlate",
    "Engine",
    "Outcome",
    "State",
    "TargetState",
    "finish_first",
    "first_look",
    "make_engine",
    "start_all",
    "start_target",
    "step",
]


def step(engine: Engine, state: State, frame: Frame, external_inputs: Iterable[Input] = ()) -> Outcome:
    """One frame for every live target, given what came from outside, in `external_inputs`.

    Raises:
        ValueError: the frame is not later than the last one.
    """
    if state.previous is not None and not frame.time > state.previous.time:
        raise ValueError(f"frame {frame.index} at time {frame.time} is not later than {state.previous.time}")
    state, cuts = find_cuts(engine, state, frame)
    given = route_inputs(engine, state.net, frame.index, external_inputs)
    cache = PlaneCache(FramePair(frame, state.previous))
    work = FrameWork(engine, state.net, cache, state.history.births, given.availability, given.by_hand)

    rows = find_rows(work, state)
    if rows is not None:
        return _manage(work, *advance_rows(work, state, rows), given, cuts)

    # Which detections are whose, where agents measure by them
    associated = associate_first(work, state.targets, state.history)
    before = state.targets if associated is None else associated.targets

    # Predict and update: by each target's own agents, then together where targets are joined
    rides = Rides.of(work, state.joins)
    carriers = rides.carriers.keys()
    near = {name: one for name, one in before.items() if name not in carriers} if carriers else before
    alone: dict[str, Filtered] = {}
    filtered = Together(filter_rows(work, near), alone, [*before])
    for target in rides.carriers_first(filtered.missing()):
        if target not in filtered:
            ride = rides.ride(target, before[target], filtered)
            alone[target] = filter_target(work, target, before[target], ride)
    joint = join_targets(work, state.joins, filtered)

    # Measure, decide, learn, describe
    results = finish_targets(work, joint.filtered)
    outcome = carry_out(work, state, results, joint)
    return _manage(work, outcome, associated, given, cuts)


def _manage(
    work: FrameWork,
    outcome: Outcome,
    associated: Associated | None,
    given: ExternalInputs,
    cuts: tuple[SceneCut, ...],
) -> Outcome:
    """The outcome after targets start and end, join and part, and load is shed; cuts come first."""
    outcome = changed(outcome, events=(*cuts, *outcome.events))
    outcome = manage_tracks(work, outcome, associated)
    outcome = with_joins(work, outcome)
    outcome = with_load(work, outcome, given.timing)
    return with_external_inputs(outcome, given)


def start_target(
    engine: Engine, state: State, frame: Frame, target: str, template: str, box: Floats
) -> Outcome:
    """Start a net for the target inside the centre box (4,) of `frame`; see `engine.starting.start`."""
    # Another target that started in this frame has made it the state's last one.
    previous = state.previous if state.previous is None or state.previous.index < frame.index else None
    work = FrameWork(engine, state.net, PlaneCache(FramePair(frame, previous)), state.history.births)
    return start_all(work, state, {target: (template, box)})


def start_all(work: FrameWork, state: State, starts: Mapping[str, tuple[str, Floats]]) -> Outcome:
    """Start nets: target -> its plate and the centre box (4,) that it fills in the frame."""
    net, targets, births = state.net, dict(state.targets), dict(state.history.births)
    metrics: list[FrameMetrics] = []
    events: list[Event] = []
    for target, (template, box) in starts.items():
        births[target] = birth_key(work.frame.time, template, f"-{target}")
        born = start(work, target, template, box, births[target])
        net, targets[target] = apply_decisions(net, born.decisions), born.state
        metrics.append(born.metrics)
        events += born.decisions
    history = changed(state.history, births=births)
    after = changed(state, net=net, targets=targets, previous=work.frame, history=history)
    return Outcome(after, tuple(metrics), tuple(events))


def first_look(engine: Engine, started: Outcome, frame: Frame) -> Outcome:
    """The first frame's outcome: what the detectors find in it besides the targets that started there."""
    state = started.state
    work = FrameWork(engine, state.net, PlaneCache(FramePair(frame, None)), state.history.births)
    return finish_first(work, started)


def finish_first(work: FrameWork, started: Outcome) -> Outcome:
    """As `first_look`, with who gives no answer in the frame."""
    return with_joins(work, manage_tracks(work, started))
