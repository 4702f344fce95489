"""How a target starts, and starts again where it is found."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.rule_inputs import RuleInputs
from bayesnet_track.adapt.status import next_try, quarantine
from bayesnet_track.belief.contract import BOX_FIELDS, LEAST_SIDE_M, Posterior
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.motion.borders import confined
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
from bayesnet_track.inference.views import Placed, Views
from bayesnet_track.journal.events.faults import Quarantined, Readmitted
from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.metrics import FrameMetrics, PartMetrics
from bayesnet_track.journal.net import Decision
from bayesnet_track.journal.target_net import TargetNet
from bayesnet_track.numerics.arrays import Floats
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
    box: Floats,
    birth: str,
    remembered: Mapping[str, Reference] = MappingProxyType({}),
) -> Born:
    """A net for the target inside the centre box (4,) of the frame: references learnt, belief placed.

    The belief of the first frame is the box itself; hypotheses spread with the first prediction. An agent
    that cannot learn its reference, or that needs colour where the frame has none, is out for the whole run;
    one that gives no answer for a reason outside of it is out for a while, and learns it then.
    `remembered` are references that agents have already and need not learn. Its draws are keyed by `birth`.
    """
    compiled, frame = work.engine.plates[template], work.frame
    active = tuple(agent for agent in compiled.plate.agents if compiled.plate.agent(agent).active)
    parts = _parts(compiled, box, frame)
    lesson, availability = (
        _first_lesson(work, compiled, target, box, parts),
        work.availability_of(target, "starting"),
    )
    # Those that look through one of several cameras meet the target when that sees it: `start_late`.
    learning = [agent for agent in compiled.cues if agent not in remembered and agent not in compiled.looking]
    learnt, faults = learn_first(lesson, learning)
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
        belief=_start_belief(work, compiled, birth, box),
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
    metrics = _first_frame_metrics(frame, target, born.belief, working, box, parts)
    if compiled.plate.inference(compiled.plate.root).start_texts:
        metrics = _with_start_prior(metrics, compiled, born.belief, box)
        _say_undefined(compiled, target, box)
    if compiled.views is not None:
        metrics = evolve(metrics, state=state_numbers(born.belief, on_ground=True))
    if compiled.modes is not None:
        states = ModeState.of(compiled.modes, born.belief, born.belief, 1.0)
        metrics = with_modes(metrics, states, calibrated=True)
    return Born(born, tuple(decisions), metrics)


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
            _start_belief(work, compiled, work.births[target], box),
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
    fields = dict(zip(compiled.motion.fields, compiled.motion.start_moments(box)[0].tolist(), strict=True))
    parts = nominal_boxes(compiled.plate, box, fields)
    return {part: inside_frame(part_box, frame) for part, part_box in parts.items()}


def _first_lesson(
    work: FrameContext, compiled: CompiledPlate, target: str, box: Floats, parts: Mapping[str, Floats]
) -> LearningInputs:
    """Inputs of the agents' first references: planes of its own, on this target's region."""
    part_boxes = {agent: parts[part] for agent, part in compiled.part_of.items()}
    cache = PlaneCache(work.cache.frames)
    return LearningInputs(compiled.cues, cache, Hypotheses(box[None]), part_boxes, work.availability, target)


def _start_belief(work: FrameContext, compiled: CompiledPlate, birth: str, box: Floats) -> Posterior:
    """The belief of a target that fills `box`."""
    motion = confined(compiled.motion, work.frame.width, work.frame.height, work.inputs)
    stream = work.stream_of(birth, compiled.plate.root)
    if compiled.views is None:
        belief: Posterior = compiled.belief.start(box, motion, stream)
        return belief
    placed = compiled.views.place(box)
    if placed is None:
        if compiled.has_one_image:
            raise ValueError(f"the box {box.tolist()} of a target on the ground stands nowhere")
        # The first camera does not see it: it starts as what it was before it was confirmed.
        anywhere: Posterior = compiled.belief.start(np.array([0.0, 0.0, 1.0, 1.0]), motion, stream)
        return anywhere
    placed_belief = compiled.belief.start(placed.states[0], motion, stream)
    return with_spread(placed_belief, placed, compiled.views, stream("placed"))


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
