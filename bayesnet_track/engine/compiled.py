"""What a graph needs to run, made once: its cues, beliefs, motion models, prices and random streams."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from bayesnet_track.adapt.lifecycle import CameraBudget
from bayesnet_track.belief.contract import LEAST_SIDE_M, LEAST_SIDE_PX, BeliefFilter, MotionModel
from bayesnet_track.belief.gaussian.belief import GaussianFilter
from bayesnet_track.belief.gaussian.modal import ModalFilter
from bayesnet_track.belief.grid.belief import GridFilter
from bayesnet_track.belief.motion.averaged import without_modes
from bayesnet_track.belief.motion.borders import Reflecting
from bayesnet_track.belief.motion.composed import (
    Deviation,
    Lasting,
    Nested,
    deviations_of,
    lasting_of,
    turning,
)
from bayesnet_track.belief.motion.delayed import with_past
from bayesnet_track.belief.motion.formulas import FormulaMotion, make_formula_motion
from bayesnet_track.belief.motion.further_axes import BoxVelocityMotion, SpaceMotion
from bayesnet_track.belief.motion.models import KinematicMotion, make_motion
from bayesnet_track.belief.motion.modes import FIELD, Modal, Modes, modes_of
from bayesnet_track.belief.motion.start_prior import StartPrior, make_start_prior
from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.engine.detectors import detectors_of, make_detectors
from bayesnet_track.engine.lifecycle.measuring import make_sensor
from bayesnet_track.engine.lifecycle.sensing import Sensor
from bayesnet_track.engine.lifecycle.viewing import make_view_sensor
from bayesnet_track.engine.modes import with_labels
from bayesnet_track.engine.scoring.rivals import VerifierAtWork, make_verifiers
from bayesnet_track.graph import spec
from bayesnet_track.graph.checked import CheckedGraph, CheckedTarget
from bayesnet_track.graph.checks.cues import plugin_parameters
from bayesnet_track.graph.checks.plates import names_of_inputs, numbers_of_kinds
from bayesnet_track.graph.checks.queries import input_columns
from bayesnet_track.graph.settings.lifecycle import LifeRules, life_rules
from bayesnet_track.graph.settings.motion import Moving
from bayesnet_track.graph.spec import Guard, Join, Learn, Query, WorldState
from bayesnet_track.inference.asking import is_elsewhere
from bayesnet_track.inference.parts import part_of_agents
from bayesnet_track.inference.queries import CompiledQuery, compile_query
from bayesnet_track.inference.views import Views, views_of
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compile_watch import working_clock
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.observation.cue import AnyCue, AssociationRule, CueDeclaration, make_cue, rule_of
from bayesnet_track.observation.detector import Detector, installed_detectors
from bayesnet_track.observation.planes import Frame
from bayesnet_track.observation.timed_columns import TimedInput


@dataclass(frozen=True, eq=False)
class CompiledPlate:
    """All that one plate needs to run, made once: cues, belief, motion model and prices.

    Attributes:
        plate: the checked plate.
        cues: agent -> implementation.
        belief: the root's belief.
        motion: the root's motion model.
        costs_ms: agent -> declared cost.
        rate_max: agent -> largest learning rate.
        adaptable: agents that can act locally.
        color_agents: agents that are blind on a gray source.
        guard: what keeps references from drifting, or None.
        lifecycle: how its targets are born, recognised and end; None when they live as long as the run.
        detectors: camera, "" of one image -> the detector of its births, if any, in `Engine.detectors`.
        looks: agents that tell one target from another by its looks.
        part_of: agent that looks at a part of the target -> the part.
        moving: what a frame's motion depends on besides its states; None when on nothing.
        searching: agents by which a missing target of a Gaussian belief is looked for elsewhere.
        finder: the detector that looks for a target which may reappear.
        association_rules: agent that measures by the detection that the target is given -> which one that is.
        sensors: the same agent -> how detections measure targets.
        opaque: agents that keep something which cannot be stored.
        declared: agent -> the declaration of its cue.
        modes: the target's hidden discrete states; None when it has none.
        verifiers: what the score asks about the estimate.
        views: the cameras by which targets on the ground are seen; None of a state in pixels.
    """

    plate: CheckedTarget
    cues: Mapping[str, AnyCue]
    belief: BeliefFilter[Any]
    motion: MotionModel
    costs_ms: Mapping[str, float]
    rate_max: Mapping[str, float]
    adaptable: frozenset[str]
    color_agents: frozenset[str] = frozenset()
    lifecycle: LifeRules | None = None
    detectors: Mapping[str, str] = field(default_factory=dict)
    looks: frozenset[str] = frozenset()
    guard: Guard | None = None
    part_of: Mapping[str, str] = field(default_factory=dict)
    moving: Moving | None = None
    searching: frozenset[str] = frozenset()
    finder: Detector | None = None
    association_rules: Mapping[str, AssociationRule] = field(default_factory=dict)
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    opaque: frozenset[str] = frozenset()
    declared: Mapping[str, CueDeclaration] = field(default_factory=dict)
    modes: Modes | None = None
    verifiers: Mapping[str, VerifierAtWork] = field(default_factory=dict)
    views: Views | None = None

    def boxes(self, states: Floats, frame: Frame) -> Floats:
        """(T, 4) boxes in the image of states (T, D), px; of several cameras in that of the first."""
        return states[:, :4] if self.views is None else self.views.boxes(states, frame)

    @cached_property
    def cameras(self) -> Mapping[str, str]:
        """Agent that measures by a detection -> the camera in which this is; "" where there is one image."""
        only = next(iter(self.detectors), "")
        if len(self.detectors) == 1:
            return dict.fromkeys(self.sensors, only)
        seen_by = {agent: self.plate.seen_by(agent) for agent in self.sensors}
        return {agent: view.name for agent, view in seen_by.items() if view is not None}

    @cached_property
    def elsewhere(self) -> frozenset[str]:
        """Agents that are at work in another process."""
        return frozenset(agent for agent, cue in self.cues.items() if is_elsewhere(cue))

    @cached_property
    def looking(self) -> Mapping[str, str]:
        """Agent that looks at the image of one of several cameras -> which."""
        cameras = {agent: self.plate.camera_of(agent) for agent in self.plate.agents}
        return {agent: camera for agent, camera in cameras.items() if camera and agent not in self.sensors}

    def boxes_of(self, agent: str, states: Floats, frame: Frame) -> Floats:
        """(T, 4) boxes of states (T, D) in the image that an agent looks at, px."""
        if agent not in self.looking:
            return self.boxes(states, frame)
        assert self.views is not None
        views = self.views.views
        node = next(name for name, view in views.items() if view.seen_by == self.looking[agent])
        return self.views.boxes(states, frame, node)

    @property
    def has_one_image(self) -> bool:
        """True unless several cameras see its targets."""
        return self.views is None or len(self.views.views) == 1

    @cached_property
    def moments(self) -> MotionModel:
        """The motion of what is kept as one Gaussian: what may become a target, or was one."""
        return without_modes(self.motion)

    @property
    def first_existence(self) -> float | None:
        """Probability that a target which somebody starts exists; None without such a rule."""
        return None if self.lifecycle is None or self.lifecycle.existence is None else 1.0


@dataclass(frozen=True)
class Stage:
    """A step that a frame of a graph goes through.

    Attributes:
        name: what it is.
        run: batch -> batch (`engine.step.Batch`).
        calls: the functions that do its work.
    """

    name: str
    run: Callable[[Any], Any]
    calls: tuple[Callable[..., Any], ...]


@dataclass(frozen=True, eq=False)
class Engine:
    """A graph ready to run.

    Attributes:
        plates: plate name -> what it needs.
        streams: all randomness.
        detectors: what finds targets, by name and parameters; plates that want the same share it.
        clock: seconds, for timings only.
        joins: how targets depend on each other.
        constants: numbers that their factors use by name.
        stages: what a frame goes through, in order.
        queries: what the beliefs are asked after every frame.
        inputs: what is known of every frame beside its image: input -> its column.
        values: kinds that joins are between -> names of their modes and values, with their numbers.
        budget: what cameras may cost; None where all are on.
    """

    plates: Mapping[str, CompiledPlate]
    streams: Streams
    clock: Callable[[], float] = working_clock
    detectors: Mapping[str, Detector] = field(default_factory=dict)
    joins: tuple[Join, ...] = ()
    constants: Mapping[str, float] = field(default_factory=dict)
    stages: tuple[Stage, ...] = ()
    queries: tuple[CompiledQuery, ...] = ()
    inputs: Mapping[str, TimedInput] = field(default_factory=dict)
    values: Mapping[frozenset[str], Mapping[str, float]] = field(default_factory=dict)
    budget: CameraBudget | None = None

    def numbers_of(self, kinds: tuple[str, ...]) -> Mapping[str, float]:
        """Names of numbers in factors of joins between some kinds: constants, modes, values."""
        return self.values.get(frozenset(kinds), self.constants)

    def with_inputs(self, frame: Frame) -> Frame:
        """The frame with what is known of it beside its image.

        Raises:
            ColumnsError: an input goes by time, and the frame has none.
        """
        if not self.inputs:
            return frame
        values = {name: source.value(frame.index, frame.time_s) for name, source in self.inputs.items()}
        return replace(frame, inputs=values)

    def on_clock(self, frame: Frame) -> Frame:
        """The frame with the time of the graph: seconds where states are in metres.

        Raises:
            ValueError: frames come without a clock, and the graph needs one.
        """
        if not any(compiled.views for compiled in self.plates.values()):
            return frame
        if math.isnan(frame.time_s):
            raise ValueError(
                f"frame {frame.index} has no time, and velocities are in metres per second; give fps"
            )
        timed = copy(frame)
        timed.__dict__["time"] = frame.time_s
        return timed


def compile_graph(
    graph: CheckedGraph,
    seed: int = 0,
    cues: Mapping[str, CueDeclaration] | None = None,
    motion: Mapping[str, MotionModel] | None = None,
    detectors: Mapping[str, Detector] | None = None,
) -> Engine:
    """The engine of a graph without its stages (`engine.step.make_engine`); without `detectors` it has none.

    Raises:
        ValueError: `motion` names a plate that the graph does not have.
        CueError: a cue cannot be made, or is not what its declaration says.
        DetectorError: a detector cannot be made, or those that are given are not those that are asked for.
    """
    declarations = graph.declarations if cues is None else cues
    custom = {} if motion is None else motion
    unknown = [name for name in custom if name not in graph.targets]
    if unknown:
        raise ValueError(f"motion for {unknown[0]!r}; the graph has {', '.join(graph.targets)}")
    several_cameras = len(graph.spec.cameras) > 1
    plates = {
        name: _compile_plate(plate, declarations, custom.get(name), graph.spec.constants, several_cameras)
        for name, plate in graph.targets.items()
    }
    asking = [(plate.plate, plate.detectors) for plate in plates.values() if plate.detectors]
    by_name = {} if detectors is None else make_detectors(asking, detectors)
    return Engine(
        plates,
        Streams(seed),
        detectors=by_name,
        joins=graph.spec.joins,
        constants=graph.spec.constants,
        inputs=input_columns(graph.spec),
        budget=CameraBudget.from_graph(graph.spec),
        values={
            frozenset(join.between): numbers_of_kinds(graph.spec, join.between)
            for join in graph.spec.joins
            if join.between is not None and join.factor is not None
        },
        queries=tuple(
            compile_query(
                name,
                _in_units(graph, query),
                numbers_of_kinds(graph.spec, query.kinds),
                names_of_inputs(graph.spec.inputs),
            )
            for name, query in graph.spec.queries.items()
        ),
    )


def _in_units(graph: CheckedGraph, query: Query) -> Query:
    """A query in the unit of the states that it is about."""
    return query.on_ground() if graph.spec.targets[query.kinds[0]].is_ground else query


def _compile_plate(
    plate: CheckedTarget,
    declarations: Mapping[str, CueDeclaration],
    custom: MotionModel | None,
    constants: Mapping[str, float],
    several_cameras: bool,
) -> CompiledPlate:
    root = plate.inference(plate.root)
    declared = {agent: declarations[plate.agent(agent).agent.cue] for agent in plate.agents}
    made_cues = {agent: make_cue(declared[agent], plate.parameters[agent]) for agent in plate.agents}
    assert root.motion is not None
    settings = root.motion.settings
    moving = None if custom is not None or settings.is_plain else settings
    kind = plate.spec
    is_point, views = kind.state == "point", views_of(plate)
    # A place alone identifies nobody, and boxes of one camera are compared in no other.
    reidentify = "never" if is_point or views else kind.reidentify
    merge = "never" if views else kind.merge_duplicates
    life = life_rules(kind.birth, merge, kind.death, reidentify, kind.existence)
    motion = _motion_of(plate, custom, constants)
    modes = None if custom is not None else modes_of(root)
    rules = {agent: rule_of(cue) for agent, cue in made_cues.items() if declared[agent].reads_detection}
    rules = {agent: with_labels(rule, plate.parameters[agent], modes) for agent, rule in rules.items()}
    if views:
        rules = {agent: replace(rule, continue_box=0.0) for agent, rule in rules.items()}
    return CompiledPlate(
        plate=plate,
        cues=made_cues,
        belief=make_belief(root.belief, modes),
        motion=motion,
        costs_ms={agent: declared[agent].cost_ms for agent in plate.agents},
        rate_max={agent: _rate_max(plate, agent, declared[agent], root.learn) for agent in plate.agents},
        adaptable=frozenset(agent for agent in plate.agents if declared[agent].adapts),
        color_agents=frozenset(agent for agent in plate.agents if declared[agent].needs_color),
        guard=None if root.learn is None else root.learn.guard,
        lifecycle=life,
        detectors=detectors_of(life, views if several_cameras else None),
        looks=frozenset(
            agent for agent in plate.agents if declared[agent].is_appearance and not declared[agent].measures
        ),
        part_of=part_of_agents(plate),
        moving=moving,
        searching=_searching(plate, declared, moving),
        finder=None if moving is None else _finder(moving),
        association_rules=rules,
        sensors={
            agent: make_sensor(plate, agent, rule, motion.fields)
            if views is None
            else make_view_sensor(plate, agent, rule, motion.fields, views, several_cameras)
            for agent, rule in rules.items()
        },
        opaque=frozenset(agent for agent in plate.agents if declared[agent].opaque),
        declared=declared,
        modes=modes,
        verifiers={} if root.score is None else make_verifiers(root.score.settings.verifiers, declarations),
        views=views,
    )


def _motion_of(
    plate: CheckedTarget, custom: MotionModel | None, constants: Mapping[str, float]
) -> MotionModel:
    """The motion of a plate, with what cameras keep of it and the past that late sensors measure."""
    lasting = lasting_of(plate.lasting)
    if custom is not None:
        return Nested(custom, lasting) if plate.lasting else custom
    kind = plate.spec
    extra_parts: tuple[Deviation | Lasting, ...] = (*deviations_of(kind.nodes), *lasting)
    motion = make_plate_motion(plate.inference(plate.root), constants, extra_parts, kind.state)
    return with_past(motion, plate.measures.values())


def make_plate_motion(
    root: spec.InferenceNode,
    constants: Mapping[str, float],
    deviations: tuple[Deviation | Lasting, ...] = (),
    state: str | WorldState = "box",
) -> MotionModel:
    """The motion that a graph with these constants asks for, before anything of a frame influences it.

    `deviations` are those of latent nodes with a motion of their own, and errors that last. Targets that are
    no boxes go on beyond the frame.
    """
    assert root.motion is not None
    settings = root.motion.settings

    def composed(declared: spec.Motion, prior: StartPrior | None = None) -> MotionModel:
        motion: MotionModel = replace(_moves(declared, constants), prior=prior)
        if state != "box" and isinstance(motion, KinematicMotion | FormulaMotion):
            side = LEAST_SIDE_PX if state == "point" else LEAST_SIDE_M
            motion = replace(motion, leaves_image=True, least_side=side)
            if isinstance(motion, KinematicMotion) and isinstance(state, WorldState) and state.space:
                motion = SpaceMotion(motion, getattr(motion.noise.sd_px, "z", 0.0))
        if settings.sd_angle_deg > 0:
            motion = turning(motion, settings.sd_angle_deg)
        motion = Nested(motion, deviations) if deviations else motion
        return Reflecting(motion) if settings.borders == "reflect" else motion

    prior = make_start_prior(root, constants)
    if (modes := modes_of(root)) is None:
        return composed(root.motion, prior)
    default_motion = composed(root.motion)
    ways = root.modes or {"": spec.Mode()}
    mode_motions = [
        default_motion if mode.motion is None else composed(mode.motion) for mode in ways.values()
    ]
    return Modal(modes, tuple(mode_motions[way] for way in modes.index[FIELD].tolist()), prior=prior)


def _moves(
    motion: spec.Motion, constants: Mapping[str, float]
) -> KinematicMotion | FormulaMotion | BoxVelocityMotion:
    if motion.expressions is not None:
        return make_formula_motion(motion.expressions, constants)
    return make_motion(motion) if motion.box_velocity is None else BoxVelocityMotion(motion.box_velocity)


def _searching(
    plate: CheckedTarget, declared: Mapping[str, CueDeclaration], moving: Moving | None
) -> frozenset[str]:
    belief = plate.inference(plate.root).belief
    if moving is None or moving.relocalize is None or belief is None or belief.gaussian is None:
        return frozenset()
    return frozenset(name for name in plate.agents if declared[name].can_search(plate.parameters[name]))


def _finder(moving: Moving) -> Detector | None:
    plugin = None if moving.relocalize is None else moving.relocalize.by.detector
    if plugin is None:
        return None
    declaration = installed_detectors([plugin.detector])[plugin.detector]
    return declaration.make(plugin_parameters(plugin, declaration.parameters))


def make_belief(declared: spec.Belief | None, modes: Modes | None = None) -> BeliefFilter[Any]:
    """The belief that a graph asks for; particles when it does not say."""
    settings = spec.Particles() if declared is None else declared.settings
    match settings:
        case spec.Particles():
            return ParticleFilter(settings)
        case spec.Gaussian():
            return GaussianFilter(settings) if modes is None else ModalFilter(settings, modes)
        case spec.Grid():
            return GridFilter(settings)
    raise TypeError(f"no belief for {type(settings).__name__}")


def _rate_max(plate: CheckedTarget, agent: str, declaration: CueDeclaration, learn: Learn | None) -> float:
    """The agent's own rate, else its cue's, else the graph's."""
    agent_rate = plate.agent(agent).learn_rate_max
    for rate in (agent_rate, declaration.rate_max):
        if rate is not None:
            return rate
    return learn.rate_max if learn is not None else 0.0
