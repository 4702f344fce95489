"""How a target starts, and starts again where it is found."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.rule_inputs import RuleInputs
from bayesnet_track.adapt.status import next_try, quarantine
from bayesnet_track.belief.contract import BOX_FIELDS, LEAST_SIDE_M, Posterior
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.motion.start_prior import make_start_prior
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_context import FrameContext, inside_frame
from bayesnet_track.engine.metrics import state_numbers
from bayesnet_track.engine.modes import ModeState, combination_probabilities, with_kinds, with_modes
from bayesnet_track.engine.predicting import start_motion_context
from bayesnet_track.engine.scoring.rivals import first_references, without_motion
from bayesnet_track.engine.scoring.score import ScoreState
from bayesnet_track.engine.state import TargetState, plan_for
from bayesnet_track.inference.learn import LearningInputs, learn_first, watch
from bayesnet_track.inference.parts import nominal_boxes
from bayesnet_track.inference.views import GIVEN_SD, Placed, Views, place
from bayesnet_track.journal.events.faults import Quarantined, Readmitted
from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.metrics import FrameMetrics, PartMetrics
from bayesnet_track.journal.net import Decision
from bayesnet_track.journal.target_net import TargetNet
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.numerics.gaussian import root
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import Hypotheses, Reference
from bayesnet_track.observation.planes import Frame, PlaneCache
from bayesnet_track.sources.entrances.notices import notice


@dataclass(frozen=True, eq=False)
class Born:
    """A target that starts in a frame: its state, the decisions, and what is written down of it."""

    state: TargetState
    decisions: tuple[Decision, ...]
    metrics: FrameMetrics


def start(
    work: FrameContext,
    target: str,
    template: str,
    start_place: Floats | CameraPoints,
    birth: str,
    remembered: Mapping[str, Reference] = MappingProxyType({}),
) -> Born:
    """A net for the target inside the centre box (4,) of the frame: references learnt, belief placed.

    Of a target at which somebody points in images of cameras (`CameraPoints`) their agents learn, each how
    its own camera sees the place on which they agree. The belief of the first frame is the box itself;
    hypotheses spread with the first prediction. An agent that cannot learn its reference, or that needs
    colour where the frame has none, is out for the whole run; one that gives no answer for a reason outside
    of it is out for a while, and learns it then. `remembered` are references that agents have already and
    need not learn. Its draws are keyed by `birth`.
    """
    compiled, frame = work.engine.plates[template], work.frame
    active = tuple(agent for agent in compiled.plate.agents if compiled.plate.agent(agent).active)
    belief, box, in_cameras = _start_belief(work, compiled, birth, start_place)
    parts = _parts(compiled, box, frame)
    lesson = _first_lesson(work, compiled, target, box, {**parts, **in_cameras})
    availability = work.availability_of(target, "starting")
    # Others that look through one of several cameras meet the target when that sees it: `start_late`.
    later = {*remembered, *(compiled.looking.keys() - in_cameras.keys())}
    learnt, faults = learn_first(lesson, [agent for agent in compiled.cues if agent not in later])
    references = {**learnt, **remembered}
    gray = [
        agent
        for agent in sorted(compiled.color_agents)
        if not (frame.of(compiled.looking.get(agent, "")) or frame).has_color
    ]
    faults |= dict.fromkeys(gray, "needs colour, and the source is gray")
    x, y, w, h = (float(v) for v in box)
    decisions: list[Decision] = [
        TargetStarted(frame.index, target, template, (x, y, w, h), active),
        # Those that cannot learn a reference have nothing to try again with.
        *(Quarantined(frame.index, target, agent, reason) for agent, reason in faults.items()),
        *(
            _later(frame.index, target, agent, why)
            for agent, why in availability.missed.items()
            if agent not in faults
        ),
    ]
    working = tuple(agent for agent in active if agent not in faults and agent not in availability.missed)
    born = TargetState(
        belief=belief,
        references=references,
        memory=RuleMemory.empty(compiled.plate),
        plan=plan_for(compiled, frozenset(working)),
        time=frame.time,
        watched=watch(references, compiled.looks, compiled.guard),
        motion_context=start_motion_context(compiled, box, work.cache.frames),
        scored=ScoreState(references=first_references(compiled.verifiers, lesson.cache, box)),
        existence=compiled.first_existence,
        started=frame.index,
    )
    metrics = _first_frame_metrics(frame, target, belief, working, box, parts)
    return Born(born, tuple(decisions), _complete(metrics, compiled, belief, box))


def _complete(metrics: FrameMetrics, compiled: CompiledPlate, belief: Posterior, box: Floats) -> FrameMetrics:
    """The first frame's record with what only some nets have: a start prior, a ground plane, modes."""
    if compiled.plate.inference(compiled.plate.root).start_texts:
        metrics = _with_start_prior(metrics, compiled, belief, box)
        _say_undefined(compiled, metrics.target, box)
    if compiled.views is not None:
        metrics = evolve(metrics, state=state_numbers(belief, on_ground=True))
    if compiled.modes is not None:
        states = ModeState.of(compiled.modes, belief, belief, 1.0)
        metrics = with_modes(metrics, states, calibrated=True)
    return metrics


def _with_start_prior(
    metrics: FrameMetrics, compiled: CompiledPlate, belief: Posterior, box: Floats
) -> FrameMetrics:
    """The first frame's record, where and as wide as the belief starts."""
    mean_box = tuple(compiled.motion.start_moments(box)[0][:4].tolist())
    variances = np.diagonal(belief.covariance)[:4]
    counted = [BOX_FIELDS.index(name) for name in compiled.plate.inference(compiled.plate.root).ud_fields]
    region50, region90 = belief.regions((0.5, 0.9))
    return replace(
        metrics,
        centre_box=mean_box,
        map=mean_box,
        sd=tuple(np.sqrt(variances).tolist()),
        ud_px2=float(variances[counted].sum()),
        region50=tuple(map(float, region50)),
        region90=tuple(map(float, region90)),
    )


def _say_undefined(compiled: CompiledPlate, target: str, box: Floats) -> None:
    """Say so where a start prior has no distribution for a target's first box."""
    prior = make_start_prior(compiled.plate.inference(compiled.plate.root), compiled.plate.constants)
    for field in () if prior is None else prior.undefined(box):
        x, y, w, h = box.tolist()
        notice(
            f"target {target}: start of {field} has no value in the start box x {x:g}, y {y:g}, w {w:g}, "
            f"h {h:g}; it starts as without it"
        )


def start_late(
    lesson: LearningInputs,
    inputs: RuleInputs,
    references: Mapping[str, Reference],
    decisions: Iterable[Decision],
) -> tuple[dict[str, Reference], tuple[Quarantined, ...]]:
    """First references of the agents that are admitted now and gave none when the target started.

    They learn at the estimate, those that look at a part in its box, and only while the target is tracked by
    others. Those that still have none are out again. So do those whose camera, one of several, sees the
    target for the first time.
    """
    net, frame, target = inputs.net, inputs.frame, inputs.target
    back = [
        decision.node
        for decision in decisions
        if isinstance(decision, Readmitted) and decision.node not in references
    ]
    if net.status == "tracking":
        back += unmet(lesson, net, {*references, *back})
    if not back:
        return {}, ()
    if net.status != "tracking" or not net.active:
        why = "gave no first reference, and the target is not tracked, which it could learn from"
        return {}, tuple(quarantine(net, frame, target, agent, why) for agent in back)
    upright = replace(lesson, at=Hypotheses(lesson.at.boxes))
    learnt, faults = learn_first(upright, back)
    missed = lesson.availability_for("starting").missed
    return learnt, (
        *(Quarantined(frame, target, agent, reason) for agent, reason in faults.items()),
        *(_later(frame, target, agent, why, net) for agent, why in missed.items() if agent in back),
    )


def unmet(lesson: LearningInputs, net: TargetNet, met: Container[str]) -> list[str]:
    """The agents whose camera sees the target for the first time; `met` are those that know it."""
    agents = [agent for agent in lesson.cameras if agent not in met and agent not in net.quarantined]
    return [agent for agent in agents if lesson.sees(agent)]


def _later(frame: int, target: str, agent: str, why: str, net: TargetNet | None = None) -> Quarantined:
    """The agent gave no first reference: it is out for a while."""
    end, times = next_try(frame, None if net is None else net.faults.get(agent))
    return Quarantined(frame, target, agent, f"gave no first reference: {why}", end, times)


def restart(work: FrameContext, target: str, template: str, box: Floats, state: TargetState) -> TargetState:
    """The target as it was, its belief in the centre box (4,): agents that know its looks remember them."""
    compiled = work.engine.plates[template]
    lesson = _first_lesson(work, compiled, target, box, _parts(compiled, box, work.frame))
    kept_references = compiled.looks | compiled.looking.keys()
    learnt, _ = learn_first(lesson, [agent for agent in compiled.cues if agent not in kept_references])
    return replace(
        state,
        belief=with_kinds(
            _start_belief(work, compiled, work.births[target], box)[0],
            compiled.modes,
            combination_probabilities(state.belief, compiled.modes),
        ),
        references={**state.references, **learnt},
        memory=state.memory.without(("activate", "deactivate", "lost", "found", "seen", "unsure")),
        scored=replace(without_motion(state.scored), smooth={}),
        time=work.frame.time,
    )


def _parts(compiled: CompiledPlate, box: Floats, frame: Frame) -> dict[str, Floats]:
    """Part -> its centre box (4,) in a target that fills `box`, its other fields as they start on average."""
    if not compiled.part_of:
        return {}
    # The mode, of which there is no mean, is the last field.
    fields = dict(zip(compiled.motion.fields, compiled.motion.start_moments(box)[0].tolist(), strict=False))
    parts = nominal_boxes(compiled.plate, box, fields)
    return {part: inside_frame(part_box, frame) for part, part_box in parts.items()}


def _first_lesson(
    work: FrameContext, compiled: CompiledPlate, target: str, box: Floats, parts: Mapping[str, Floats]
) -> LearningInputs:
    """Inputs of the agents' first references: planes of its own, on this target's region.

    `parts` are the boxes of parts, and of agents in the images of several cameras.
    """
    names = {agent: compiled.part_of.get(agent, agent) for agent in compiled.cues}
    boxes = {agent: parts[name] for agent, name in names.items() if name in parts}
    cache, estimate = PlaneCache(work.cache.frames), Hypotheses(box[None])
    return LearningInputs(
        compiled.cues, cache, estimate, boxes, work.availability, target, cameras=compiled.looking
    )


CameraPoints = Mapping[str, Sequence[float]]
"""Camera -> where its image shows a target: a point x, y or a corner box x, y, w, h, px."""

GIVEN_SD_PX = 2.0
"""Error of a point that somebody gives as a start, px."""


def place_points(views: Views, points: CameraPoints) -> tuple[Placed, dict[str, float]] | None:
    """Place of a target that images of several cameras show.

    And by how much each camera shows it elsewhere than that place is, px. None where it is nowhere: a
    point in one camera alone, without a size, has any depth.
    """
    showing = [view for view in views.views.values() if view.seen_by in points]
    numbers = [np.asarray(points[view.seen_by], dtype=np.float64) for view in showing]
    boxes = [np.append(x, (1.0, 1.0)) if len(x) == 2 else centre_from_corner(x) for x in numbers]
    of_point = np.array([GIVEN_SD_PX, GIVEN_SD_PX, np.inf, np.inf])
    sds = [
        of_point if len(x) == 2 else GIVEN_SD * box[[2, 3, 2, 3]]
        for x, box in zip(numbers, boxes, strict=True)
    ]
    placed = place(showing, np.concatenate(boxes)[None], np.concatenate(sds)[None] ** 2, views.start)
    if not len(placed.which):
        return None
    expected = [view.camera.boxes(placed.states)[0, :2] for view in showing]
    errors = {
        view.seen_by: float(np.linalg.norm(box[:2] - point))
        for view, box, point in zip(showing, boxes, expected, strict=True)
    }
    return placed, errors


def _start_belief(
    work: FrameContext, compiled: CompiledPlate, birth: str, start_place: Floats | CameraPoints
) -> tuple[Posterior, Floats, dict[str, Floats]]:
    """The belief of a target that starts, and the centre box (4,) that it fills in the image of results.

    And the boxes at which agents look in other images where it is pointed at.
    """
    motion = work.confined(compiled.motion)
    stream, views = work.stream_of(birth, compiled.plate.root), compiled.views
    if isinstance(start_place, Mapping):
        pointed = None if views is None else place_points(views, start_place)
        if views is None or pointed is None:
            raise ValueError(f"a target that is nowhere, as cameras show it: {dict(start_place)}")
        placed_belief = compiled.belief.start(pointed[0].states[0], motion, stream)
        belief = with_spread(placed_belief, pointed[0], views, stream("placed"))
        in_cameras = {
            agent: compiled.boxes_of(agent, belief.mean[None], work.frame)[0]
            for agent, camera in compiled.looking.items()
            if camera in start_place and work.frame.of(camera) is not None
        }
        return belief, compiled.boxes(belief.mean[None], work.frame)[0], in_cameras
    placed = None if views is None else views.place(start_place)
    if views is None:
        belief = compiled.belief.start(start_place, motion, stream)
    elif placed is not None:
        placed_belief = compiled.belief.start(placed.states[0], motion, stream)
        belief = with_spread(placed_belief, placed, views, stream("placed"))
    elif compiled.has_one_image:
        raise ValueError(f"the box {start_place.tolist()} of a target on the ground stands nowhere")
    else:  # the first camera does not see it: it starts as what it was before it was confirmed
        belief = compiled.belief.start(np.array([0.0, 0.0, 1.0, 1.0]), motion, stream)
    return belief, start_place, {}


def with_spread(belief: Posterior, placed: Placed, views: Views, rng: np.random.Generator) -> Posterior:
    """A belief that starts, as uncertain besides as the first box that was `placed`.

    Its last fields are the errors that last, with which the place is off.
    """
    lasting = views.lasting
    covariance, cross, size = placed.covariances[0], placed.cross[0], len(belief.fields) - len(lasting)
    places = np.arange(size)[views.main.columns]
    if isinstance(belief, GaussianPosterior):
        spread = belief.covariance.copy()
        spread[np.ix_(places, places)] += covariance
        spread[places, size:] += cross
        spread[size:, places] += cross.T
        return replace(belief, covariance=spread)
    assert isinstance(belief, ParticleSet)
    states = belief.states.copy()
    by_error = cross / np.array([error.sd**2 for error in lasting])
    lower = root(covariance - by_error @ cross.T)
    states[:, places] += rng.standard_normal((len(states), lower.shape[1])) @ lower.T
    states[:, places] += states[:, size:] @ by_error.T
    np.maximum(states[:, 2:4], LEAST_SIDE_M, out=states[:, 2:4])
    return evolve(belief, states=states)


def drawn(belief: ParticleSet, mean: Floats, covariance: Floats, rng: np.random.Generator) -> ParticleSet:
    """Particles drawn from N(mean, covariance), as many as before."""
    lower = root(covariance)
    states = mean + rng.standard_normal((len(belief), lower.shape[1])) @ lower.T
    np.maximum(states[:, 2:4], LEAST_SIDE_M, out=states[:, 2:4])
    return evolve(belief, states=states)


def _first_frame_metrics(
    frame: Frame,
    target: str,
    belief: Posterior,
    active: tuple[str, ...],
    box: Floats,
    parts: Mapping[str, Floats],
) -> FrameMetrics:
    """The frame in which the target starts: its box is known, and by it those of its parts (4,)."""
    centre_box = tuple(map(float, box))
    point = (centre_box[0], centre_box[0], centre_box[1], centre_box[1])
    return FrameMetrics(
        frame=frame.index,
        time_s=frame.time_s,
        target=target,
        centre_box=centre_box,
        map=centre_box,
        sd=(0.0, 0.0, 0.0, 0.0),
        ud_px2=0.0,
        ud_nodes={},
        quiet_px2=None,
        status="tracking",
        score=1.0,
        log_evidence=0.0,
        surprise=0.0,
        ess=float(len(belief)),
        particles=len(belief),
        active=active,
        kl={},
        contribution={},
        agent_ud_px2={},
        strength={},
        learn_rate=1.0,
        region50=point,
        region90=point,
        cloud=(),
        parts={
            name: PartMetrics(tuple(map(float, part_box)), (0.0,) * 4, 0.0, "seen")
            for name, part_box in parts.items()
        },
    )
