"""The engine: one step of every live net for one frame.

It is a function of the engine (graph and seed), the state, the frame and what came from outside; time is read
for the timings only. A step is a loop over the stages of the graph, which are chosen when it is compiled: a
feature that it does not use is not entered.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from bayesnet_track.adapt.memory import STATUS_STREAKS
from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.engine.attachment import Rides
from bayesnet_track.engine.cameras import adopt_errors, first_errors, learn_errors
from bayesnet_track.engine.choosing import choose_cameras
from bayesnet_track.engine.compiled import CompiledPlate, Engine, Stage, compile_graph
from bayesnet_track.engine.filtering import Filtered, filter_ready, filter_target, ready_each
from bayesnet_track.engine.finishing import Results, finish_targets
from bayesnet_track.engine.frame_context import ExternalInputs, FrameContext, route_inputs
from bayesnet_track.engine.joining import JointBelief, join_targets
from bayesnet_track.engine.lifecycle.association import Associated, associate_first
from bayesnet_track.engine.lifecycle.identities import track_identities
from bayesnet_track.engine.lifecycle.track_management import manage_tracks
from bayesnet_track.engine.lines import Lines
from bayesnet_track.engine.outcome import (
    Outcome,
    State,
    carry_out,
    with_external_inputs,
    with_joins,
    with_load,
)
from bayesnet_track.engine.queries import answer_queries
from bayesnet_track.engine.rows.advancing import FilteredGaussians, filter_gaussians
from bayesnet_track.engine.rows.filtered_rows import FilteredTargets
from bayesnet_track.engine.rows.finding import arrange
from bayesnet_track.engine.rows.fitting import row_rule
from bayesnet_track.engine.rows.particle_rows import filter_rows
from bayesnet_track.engine.scoring.rivals import without_motion
from bayesnet_track.engine.scoring.score import LEAST_FRAMES
from bayesnet_track.engine.starting import CameraPoints, start
from bayesnet_track.engine.state import TargetState
from bayesnet_track.engine.targets import Targets
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.spec import Lost
from bayesnet_track.journal.events.cameras import CamerasSwitched
from bayesnet_track.journal.events.event import Event, Input
from bayesnet_track.journal.events.statuses import SceneCut
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net import apply_decisions
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve
from bayesnet_track.numerics.streams import birth_key
from bayesnet_track.observation.cue import CueDeclaration
from bayesnet_track.observation.detector import Detector
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache
from bayesnet_track.vision.planes import Scene, compare_scenes, describe_scene

__all__ = [
    "Batch",
    "CompiledPlate",
    "Engine",
    "Outcome",
    "State",
    "TargetState",
    "compile_stages",
    "finish_first",
    "first_look",
    "make_engine",
    "start_all",
    "start_target",
    "step",
]


@dataclass(frozen=True, eq=False)
class Batch:
    """The targets of a frame on their way through its stages.

    Attributes:
        work: the frame's.
        state: the state before it.
        inputs: the external inputs, by whom they concern.
        targets: target -> its state before the frame, with the detections that it is given.
        early: scene cuts before the frame, and which cameras are on in it.
        associated: the detections, and whose they are.
        gaussians: the first half of the frame of tables of Gaussian beliefs.
        joint: target -> the first half of its frame, with the weights of its joint belief if it has one.
        outcome: what the frame gave so far.
    """

    work: FrameContext
    state: State
    inputs: ExternalInputs
    targets: Targets
    joint: JointBelief
    outcome: Outcome
    early: tuple[SceneCut | CamerasSwitched, ...] = ()
    associated: Associated | None = None
    gaussians: tuple[FilteredGaussians, ...] = ()


def step(engine: Engine, state: State, frame: Frame, external_inputs: Iterable[Input] = ()) -> Outcome:
    """One frame for every live target, given what came from outside, in `external_inputs`.

    Raises:
        ValueError: the frame is not later than the last one.
    """
    frame = engine.on_clock(frame)
    if state.previous is not None and not frame.time > state.previous.time:
        raise ValueError(f"frame {frame.index} at time {frame.time} is not later than {state.previous.time}")
    batch = _open_frame(engine, state, frame, external_inputs)
    for stage in engine.stages:
        batch = stage.run(batch)
    outcome = evolve(batch.outcome, cameras=batch.work.cameras) if batch.work.cameras else batch.outcome
    return with_external_inputs(outcome, batch.inputs)


def make_engine(
    graph: CheckedGraph,
    seed: int = 0,
    cues: Mapping[str, CueDeclaration] | None = None,
    motion: Mapping[str, MotionModel] | None = None,
    detectors: Mapping[str, Detector] | None = None,
) -> Engine:
    """Load the cues and detectors of `graph` and make it ready to run.

    `motion` maps plates to motion models of one's own, such as `belief.motion.formulas.FunctionMotion`, in
    place of the graph's: what the language cannot say. The log does not hold them. `detectors` are those that
    are given from outside, by the names that the graph has for them: `detections`.

    Raises:
        ValueError: `motion` names a plate that the graph does not have.
        CueError: a cue cannot be made, or is not what its declaration says.
        DetectorError: a detector cannot be made, the graph asks for `detections` and none are given, or no
            plate asks for one that is given.
    """
    engine = compile_graph(graph, seed, cues, motion, detectors or {})
    return replace(engine, stages=compile_stages(engine))


def compile_stages(engine: Engine) -> tuple[Stage, ...]:
    """The stages of a graph: only what it asks for."""
    plates = engine.plates.values()
    has_tables = any(row_rule(engine, plate) is not None for plate in engine.plates)
    stages = [Stage("filter", filter_targets, (filter_rows, ready_each, filter_ready))]
    if any(join.attachment is not None for join in engine.joins):
        stages = [Stage("carry and filter", filter_carried, (Rides.of, filter_rows, filter_target))]
    if has_tables:
        stages.insert(0, Stage("filter tables", filter_tables, (filter_gaussians,)))
    if any(compiled.association_rules for compiled in plates):
        stages.insert(0, Stage("associate", associate_targets, (associate_first,)))
    if has_tables:
        stages.insert(0, Stage("arrange", arrange_targets, (arrange,)))
    if engine.joins:
        stages.append(Stage("join", join, (join_targets,)))
    if first_errors(engine) is not None:
        stages.append(Stage("errors of cameras", set_errors, (learn_errors,)))
    stages.append(Stage("measure, decide, learn", finish, (finish_targets, carry_out)))
    if any(_cut_level(compiled) is not None for compiled in plates):
        stages.insert(0, Stage("scene cuts", cut_scenes, (_find_cuts,)))
    if engine.budget is not None:
        stages.insert(0, Stage("choose cameras", switch_cameras, (choose_cameras,)))
    if any(compiled.lifecycle is not None for compiled in plates):
        stages.append(Stage("tracks", start_and_end, (manage_tracks,)))
    if any(compiled.plate.spec.identity is not None for compiled in plates):
        stages.append(Stage("identities", identify, (track_identities,)))
    if engine.joins:
        stages.append(Stage("joins", change_joins, (with_joins,)))
    if engine.queries:
        stages.append(Stage("queries", ask, (answer_queries,)))
    return (*stages, Stage("load", shed_load, (with_load,)))


def _open_frame(engine: Engine, state: State, frame: Frame, external_inputs: Iterable[Input]) -> Batch:
    """The batch that the first stage is given."""
    inputs = route_inputs(engine, state.net, frame.index, external_inputs)
    previous = state.previous
    if engine.inputs:
        frame, previous = engine.with_inputs(frame), previous and engine.with_inputs(previous)
    cache = PlaneCache(FramePair(frame, previous))
    births = state.history.births
    work = FrameContext(engine, state.net, cache, births, inputs.availability, inputs.by_hand)
    nothing = JointBelief(FilteredTargets([], {}, []), state.joins)
    return Batch(work, state, inputs, Targets.of(state.targets), nothing, Outcome(state, Lines(), ()))


def cut_scenes(batch: Batch) -> Batch:
    """Targets that a scene cut may have moved are lost from the frame on."""
    state, cuts = _find_cuts(batch.work.engine, batch.state, batch.work.frame)
    work = evolve(batch.work, net=state.net)
    early = (*batch.early, *cuts)
    return evolve(batch, work=work, state=state, targets=Targets.of(state.targets), early=early)


def switch_cameras(batch: Batch) -> Batch:
    """Frames of cameras that are on are looked at; those of others are as if there were none."""
    work, state, budget = batch.work, batch.state, batch.work.engine.budget
    assert budget is not None
    memory, names, events = choose_cameras(work, batch.targets, state.history, budget)
    frame, frames = work.frame, work.frame.cameras or {}
    earlier = frame.last_frames
    if any(compiled.looking for compiled in work.engine.plates.values()):
        earlier = {name: image for name, image in earlier.items() if name in names and image.is_readable}
    cameras = {name: image for name, image in frames.items() if name in names and image.is_readable}
    switched = replace(frame, cameras=cameras, last_frames=earlier)
    cache = PlaneCache(FramePair(switched, work.cache.frames.previous))
    state = evolve(state, history=evolve(state.history, cameras=memory))
    return evolve(batch, work=evolve(work, cache=cache), state=state, early=events)


def arrange_targets(batch: Batch) -> Batch:
    """Targets with Gaussian beliefs become rows where they fit."""
    targets, records = arrange(batch.work, batch.state)
    if targets is batch.targets:
        return batch
    state = evolve(batch.state, history=evolve(batch.state.history, records=records))
    return evolve(batch, targets=targets, state=state)


def associate_targets(batch: Batch) -> Batch:
    """Detections are divided among targets whose agents measure by them."""
    associated = associate_first(batch.work, batch.targets, batch.state.history)
    return evolve(batch, associated=associated, targets=associated.targets)


def filter_tables(batch: Batch) -> Batch:
    """The rows of Gaussian beliefs are predicted and weighed by what they were given."""
    assert batch.associated is not None
    detections, tables = batch.associated.given, batch.targets.gaussians
    filtered = tuple(filter_gaussians(batch.work, rows, detections[rows.rule.plate]) for rows in tables)
    return evolve(batch, gaussians=filtered)


def filter_targets(batch: Batch) -> Batch:
    """Every target is predicted and weighed by its own agents."""
    if not batch.targets.order:
        return batch
    work, targets, singles = batch.work, batch.targets, dict[str, Filtered]()
    filtered = FilteredTargets(filter_rows(work, targets), singles, targets.order)
    if missing := filtered.missing():
        for ready, stepped in ready_each(work, {target: targets[target] for target in missing}):
            singles[ready.target] = filter_ready(work, ready, stepped)
    return evolve(batch, joint=JointBelief(filtered, batch.state.joins))


def filter_carried(batch: Batch) -> Batch:
    """Every target is predicted, after the target that may carry it, and weighed by its own agents."""
    work, targets = batch.work, batch.targets
    rides = Rides.of(work, batch.state.joins)
    riderless = {name: state for name, state in targets.items() if name not in rides.carriers}
    singles: dict[str, Filtered] = {}
    filtered = FilteredTargets(filter_rows(work, riderless), singles, [*targets])
    for target in rides.carriers_first(filtered.missing()):
        if target not in filtered:
            ride = rides.ride(target, targets[target], filtered)
            singles[target] = filter_target(work, target, targets[target], ride)
    return evolve(batch, joint=JointBelief(filtered, batch.state.joins))


def join(batch: Batch) -> Batch:
    """Joined targets are weighed together, so that the evidence of a pixel counts once."""
    return evolve(batch, joint=join_targets(batch.work, batch.state.joins, batch.joint.filtered))


def set_errors(batch: Batch) -> Batch:
    """The errors of cameras are learnt from all targets, which are given them."""
    work, joint, associated = batch.work, batch.joint, batch.associated
    history = batch.state.history if associated is None else associated.history
    errors, singles, events = learn_errors(work, history, joint.filtered)
    together = FilteredTargets(joint.filtered.groups, singles, joint.filtered.order)
    state = evolve(batch.state, history=evolve(batch.state.history, errors=errors))
    if associated is not None:
        history = adopt_errors(work, evolve(associated.history, errors=errors), errors)
        associated = evolve(associated, history=history)
    joint = evolve(joint, filtered=together, events=(*joint.events, *events))
    return evolve(batch, state=state, associated=associated, joint=joint)


def finish(batch: Batch) -> Batch:
    """Every target is measured, judged by the rules, learnt from and described."""
    filtered, gaussians = batch.joint.filtered, batch.gaussians
    results = finish_targets(batch.work, filtered, gaussians) if gaussians or filtered else Results()
    outcome = carry_out(batch.work, batch.state, results, batch.joint)
    if batch.early:
        outcome = evolve(outcome, events=(*batch.early, *outcome.events))
    return evolve(batch, outcome=outcome)


def start_and_end(batch: Batch) -> Batch:
    """Detections become targets, lost targets are found, and nets end."""
    return evolve(batch, outcome=manage_tracks(batch.work, batch.outcome, batch.associated))


def identify(batch: Batch) -> Batch:
    """Identities of targets that came close."""
    if batch.associated is None:
        return batch
    return evolve(batch, outcome=track_identities(batch.work, batch.targets, batch.associated, batch.outcome))


def change_joins(batch: Batch) -> Batch:
    """Targets join and part for the next frame."""
    return evolve(batch, outcome=with_joins(batch.work, batch.outcome))


def ask(batch: Batch) -> Batch:
    """The queries of the graph are answered from the beliefs after the frame."""
    return evolve(batch, outcome=answer_queries(batch.work, batch.outcome, batch.joint.filtered))


def shed_load(batch: Batch) -> Batch:
    """Work is shed or taken back, where a run has a time budget."""
    return evolve(batch, outcome=with_load(batch.work, batch.outcome, batch.inputs.timing))


def start_target(
    engine: Engine, state: State, frame: Frame, target: str, template: str, box: Floats
) -> Outcome:
    """Start a net for the target inside the centre box (4,) of `frame`; see `engine.starting.start`."""
    frame = engine.on_clock(frame)
    # Another target that started in this frame has made it the state's last one.
    previous = state.previous if state.previous is None or state.previous.index < frame.index else None
    work = FrameContext(engine, state.net, PlaneCache(FramePair(frame, previous)), state.history.births)
    return start_all(work, state, {target: (template, box)})


def start_all(
    work: FrameContext, state: State, starts: Mapping[str, tuple[str, Floats | CameraPoints]]
) -> Outcome:
    """Start nets: target -> its plate, and the centre box (4,) that it fills or what cameras show of it."""
    net, targets, births = state.net, dict(state.targets), dict(state.history.births)
    metrics: list[FrameMetrics] = []
    events: list[Event] = []
    for target, (template, box) in starts.items():
        births[target] = birth_key(work.frame.time, template, f"-{target}")
        born = start(work, target, template, box, births[target])
        net, targets[target] = apply_decisions(net, born.decisions), born.state
        metrics.append(born.metrics)
        events += born.decisions
    history = evolve(state.history, births=births)
    begun = evolve(state, net=net, targets=targets, previous=work.frame, history=history)
    return Outcome(begun, Lines(born=metrics), tuple(events))


def first_look(engine: Engine, outcome: Outcome, frame: Frame) -> Outcome:
    """The first frame's outcome: what the detectors find in it besides the targets that started there."""
    state, frame = outcome.state, engine.on_clock(frame)
    work = FrameContext(engine, state.net, PlaneCache(FramePair(frame, None)), state.history.births)
    return finish_first(work, outcome)


def finish_first(work: FrameContext, first: Outcome) -> Outcome:
    """The outcome as of `first_look`, with who gives no answer in the frame."""
    outcome = with_joins(work, manage_tracks(work, first))
    return answer_queries(work, outcome) if work.engine.queries else outcome


def _find_cuts(engine: Engine, state: State, frame: Frame) -> tuple[State, tuple[SceneCut, ...]]:
    """The state that `frame` begins with, and whose scene was cut before it.

    A frame that shows no scene, such as a black one, is skipped: the next is compared with the one before it.
    """
    last_scene, scene = _last_scene(state), describe_scene(frame.image)
    if last_scene is None or scene is None:
        return replace(state, scene=scene or last_scene), ()
    state = replace(state, scene=scene)
    change = compare_scenes(last_scene, scene)
    cuts: dict[str, SceneCut] = {}
    for target in state.targets:
        level = _cut_level(engine.plates[state.net.targets[target].template])
        if level is not None and change.distance > level:
            cuts[target] = SceneCut(
                frame.index, target, change.distance, level, change.colors, change.structure
            )
    if not cuts:
        return state, ()
    targets = {
        name: _without_place(engine, state, name, frame.index) if name in cuts else target_state
        for name, target_state in state.targets.items()
    }
    decisions = tuple(cuts.values())
    return replace(state, net=apply_decisions(state.net, decisions), targets=targets), decisions


def _rule_of(compiled: CompiledPlate) -> Lost | None:
    return compiled.plate.inference(compiled.plate.root).lost


def _cut_level(compiled: CompiledPlate) -> float | None:
    """Distance of two scenes from which a cut lies between them; None where a plate asks for no cuts."""
    rule = _rule_of(compiled)
    return None if rule is None else rule.scene_cut


def _last_scene(state: State) -> Scene | None:
    """The last scene that was seen; that of the last frame where none was looked at before."""
    if state.scene is not None or state.previous is None:
        return state.scene
    return describe_scene(state.previous.image)


def _without_place(engine: Engine, state: State, target: str, frame: int) -> TargetState:
    """State of a target that may now be anywhere: it has to be recognised, best where it was last."""
    target_state = state.targets[target]
    rule = _rule_of(engine.plates[state.net.targets[target].template])
    scored, context = target_state.scored, target_state.motion_context
    if rule is not None and rule.found_fit is not None and scored.missing is None:
        is_known = len(scored.fits) >= LEAST_FRAMES
        scored = replace(scored, low=0, again=(), missing=frame if is_known else None)
    return replace(
        target_state,
        memory=target_state.memory.without([kind for kind, _ in STATUS_STREAKS]),
        motion_context=None if context is None else replace(context, held=None),
        scored=without_motion(scored),
    )
