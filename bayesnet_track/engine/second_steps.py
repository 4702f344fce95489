"""Further steps of a frame, where the first is not enough: agents on call, and searches for a target.

Agents on call run after the others, in the frames in which they are due or needed. The others' answers are
remembered, so that only the belief is weighed a second time.

A fast move: where suddenly nothing fits, the frame is filtered again, with a wider prior. Whether it is
depends on the frame, so its evidence then counts twice. That is the price of not searching a large square in
every frame: the result is a belief about the place, and no probability of the move.

A missing target of a Gaussian belief is looked for at another place in each frame: a Gaussian has no
hypotheses to spare for a search. Agents that measure and say how sure they are look instead. The odds of
their confidence stand for the likelihood of the target against none, and the belief moves to where it more
probably is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.rule_inputs import OnCallOutcome, Reading, baseline_level, read_level
from bayesnet_track.adapt.status import on_call_rule
from bayesnet_track.belief.contract import BOX_FIELDS, MotionModel, Posterior, Step, estimate, hypotheses_of
from bayesnet_track.belief.motion.jumps import TELL_ABOVE, Jumping, Search, Within
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_context import FrameContext, inside_frame
from bayesnet_track.engine.predicting import MotionContext, PredictedMotion
from bayesnet_track.engine.scoring.score import log_odds, usual_fit
from bayesnet_track.engine.state import TargetState, plan_for
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.settings.motion import Relocalize, Sudden
from bayesnet_track.inference.compile import Plan
from bayesnet_track.inference.measure import fit_of, state_columns
from bayesnet_track.inference.observe import Observer, Question, ask_agents
from bayesnet_track.journal.events.beliefs import Reappeared
from bayesnet_track.journal.target_net import TargetNet
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import Hypotheses, Measurement
from bayesnet_track.observation.planes import Region, region_of_boxes

APART_BOX = 4.0
"""Side of the square of a place, in sqrt(w h); the side of a Siamese network's wide crop is 6."""
CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
"""Corners of such a square from its middle, in halves of its side."""
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
"""The golden ratio, less one."""

Restart = Callable[[Floats, Observer], Step[Posterior]]
"""(centre box (4,), observer) -> the step of the frame by a belief that starts in the box."""


@dataclass(frozen=True, eq=False)
class Find:
    """Evidence of agents on a place.

    Attributes:
        box: (4,) centre box where the surest of them sees the target, px.
        log_odds: of their confidence, summed.
    """

    box: Floats
    log_odds: float


def look_elsewhere(
    work: FrameContext,
    target: str,
    previous: TargetState,
    moves: PredictedMotion,
    steps: tuple[Plan, Step[Posterior], Observer, Restart],
) -> tuple[PredictedMotion, Step[Posterior]]:
    """The motion and the step of the frame: those from another place, if it is more probable.

    One of M places in reach is as probable as another: the odds of a jump are share / (1 - share) / M, times
    the odds of the agents' confidence there, over those where the belief is. In any case they have to be
    surer there than here, and more sure than not. `steps` are the agents that took part in the first step,
    that step, its observer, and what makes a step from elsewhere.
    """
    plan, first, observer, restart = steps
    compiled, context = work.plate_of(target), moves.motion_context
    agents = _that_look(compiled.searching, plan, first)
    if not agents or context is None or not _is_missing(work, target, context):
        return moves, first
    assert compiled.moving is not None and compiled.moving.relocalize is not None
    assert context.influences is not None
    rule, current_box = compiled.moving.relocalize, first.posterior.mean[:4]
    box = previous.belief.mean[:4] if context.held is None else context.held
    reach = _reached(rule, context, box, work)
    places = _lay_places(reach, APART_BOX * math.sqrt(box[2] * box[3]))
    place = np.concatenate([places[pick_place(work.frame.index, len(places))], box[2:]])
    find = _look_at(work, previous, (plan, observer, agents), place)
    stays = _see(first.evidence.measured, agents, current_box).log_odds
    if find.log_odds <= max(stays, 0.0) or overlap_of_two(find.box, current_box) > 0.0:
        return moves, first
    gain = find.log_odds - stays - math.log(len(places))
    probability = 1.0 / (1.0 + math.exp(-gain) * (1.0 - rule.share) / rule.share)
    if probability <= TELL_ABOVE:
        return moves, first
    jumped = restart(find.box, replace(observer, measured={}))
    x, y = find.box[:2].tolist()
    event = Reappeared(
        frame=work.frame.index,
        target=target,
        by=" and ".join(sorted(agents)),
        hypotheses=0,
        held=probability,
        level=TELL_ABOVE,
        share=rule.share,
        turning=1.0 / (1.0 + math.exp(gain)),
        x=x,
        y=y,
        moved_px=math.dist((x, y), previous.belief.mean[:2].tolist()),
        ud_px2=context.ud_px2,
        above_px2=0.0,
        within_px=_searched(reach.half_px, box, find.box),
    )
    context = evolve(context, influences=evolve(context.influences, jump_share=rule.share))
    return replace(moves, motion_context=context), evolve(
        jumped, reports=(*jumped.reports, lambda frame, target: event)
    )


def _that_look(searching: frozenset[str], plan: Plan, step: Step[Posterior]) -> frozenset[str]:
    """The agents of the whole that can look elsewhere and were asked in the frame's step."""
    able = {
        observation.agent
        for observation in plan.observations
        if observation.agent in searching and observation.at == plan.root
    }
    return frozenset(able & step.evidence.measured.keys())


def _is_missing(work: FrameContext, target: str, context: MotionContext) -> bool:
    """True if the target is lost, or uncertain for as long as it takes to be called lost."""
    status, plate = work.net.targets[target].status, work.plate_of(target).plate
    lost = plate.inference(plate.root).lost
    return status == "lost" or (status == "uncertain" and lost is not None and context.away > lost.frames)


def _reached(rule: Relocalize, context: MotionContext, box: Floats, work: FrameContext) -> Within:
    """Places where the target may be by now that was last held in the centre box (4,)."""
    half_px = math.inf
    if rule.grow_box is not None and context.held is not None:
        half_px = rule.grow_box * context.away * math.sqrt(box[2] * box[3])
    return Within.around(box, half_px, work.frame.width, work.frame.height)


def _searched(half_px: float, box: Floats, found_box: Floats) -> float | None:
    """Distance from a box that was searched, px; None for the whole frame. Finds farther away count, too."""
    if math.isinf(half_px):
        return None
    return max(half_px, float(np.abs(found_box[:2] - box[:2]).max()))


def _lay_places(reach: Within, apart_px: float) -> Floats:
    """(M, 2) places on a lattice over the part of the frame, about so far apart, px."""
    lines = []
    for low, high in zip(reach.low.tolist(), reach.high.tolist(), strict=True):
        count = max(round((high - low) / apart_px), 1)
        lines.append(low + (np.arange(count) + 0.5) * (high - low) / count)
    return np.stack(np.meshgrid(*lines), axis=2).reshape(-1, 2)


def pick_place(frame: int, count: int) -> int:
    """Index of the one of `count` places that is looked at in a frame.

    Multiples of the golden ratio leave no gap in 0..1, so that all places have their turn, also if agents run
    in every second, third or fourth frame only.
    """
    return int(count * (frame * GOLDEN % 1.0))


def _look_at(
    work: FrameContext, previous: TargetState, inquiry: tuple[Plan, Observer, frozenset[str]], box: Floats
) -> Find:
    """See what agents measure around a centre box (4,): they are asked with a hypothesis in each corner.

    One that fails there, or gives no answer, does so in this frame.
    """
    plan, observer, agents = inquiry
    states = np.tile(np.concatenate([box, previous.belief.mean[4:]]), (len(CORNERS), 1))
    states[:, :2] += 0.5 * APART_BOX * math.sqrt(box[2] * box[3]) * CORNERS
    hypotheses = hypotheses_of(states, previous.belief.fields)
    steps = [step for step in plan.observations if step.agent in agents and step.at == plan.root]
    uniform = np.full(len(CORNERS), -math.log(len(CORNERS)))
    question = Question({plan.root: hypotheses}, uniform, region_of_boxes(hypotheses.boxes))
    answers = ask_agents(question, replace(observer, measured={}), steps)
    measured = {
        step.agent: answer if isinstance(answer, Measurement) else None for step, answer in answers.items()
    }
    find = _see(measured, agents, box)
    return replace(find, box=inside_frame(find.box, work.frame))


def _see(measured: Mapping[str, Measurement | None], agents: Collection[str], box: Floats) -> Find:
    """Combine the agents' measurements; one without any is as unsure as can be, and none leaves the box."""
    total, best_odds, found_box = 0.0, -math.inf, box.copy()
    for agent in sorted(agents):
        measurement = measured.get(agent)
        agent_odds = log_odds(
            0.0 if measurement is None or measurement.confidence is None else measurement.confidence
        )
        total += agent_odds
        if measurement is not None and agent_odds > best_odds:
            best_odds, found_box = agent_odds, box.copy()
            for field, value in zip(measurement.fields, measurement.mean.tolist(), strict=True):
                if field in BOX_FIELDS:
                    found_box[BOX_FIELDS.index(field)] = value
    return Find(found_box, total)


CELL_BOX = 1.0 / 6.0
"""Side of a cell of the lattice, in box sides: a correlation filter answers within about so much."""


Again = Callable[[MotionModel], Step[Posterior]]
"""Filters the frame again with another motion."""


def search_around(
    work: FrameContext,
    target: str,
    previous: TargetState,
    moves: PredictedMotion,
    steps: tuple[Plan, Step[Posterior], Again],
) -> tuple[PredictedMotion, Step[Posterior]]:
    """The motion and the step of the frame: those of the search where that finds it, else the first.

    It finds the target where hypotheses that jumped hold most of the belief, which the step then reports, and
    one fits, so well that this bounds no score: what a badly held target usually fits is soon reached. A
    target that is in doubt or lost is not searched for: what hides it stays, and look-alikes come along.
    `steps` are the agents that took part in the first step, that step, and what makes another.
    """
    plan, first, step_with = steps
    compiled, typical_fit = work.plate_of(target), usual_fit(previous.scored)
    rule, score = _sudden_rule(compiled), compiled.plate.inference(compiled.plate.root).score
    if rule is None or typical_fit is None or not is_sudden(work, target, previous, _fit(plan, first)):
        return moves, first
    share, box = _fit(plan, first) / typical_fit, previous.belief.mean[:4]
    search_step = step_with(_widened(rule, share, box, moves.motion, work))
    full_fit = 0.0 if score is None else score.settings.full_fit
    if not search_step.reports or _fit(plan, search_step) < max(rule.below_fit * typical_fit, full_fit):
        return moves, first
    context = moves.motion_context
    if context is not None and context.influences is not None:
        jumped = replace(context.influences, jump_share=rule.share)
        moves = replace(moves, motion_context=replace(context, influences=jumped))
    return moves, search_step


def _sudden_rule(compiled: CompiledPlate) -> Sudden | None:
    """The rule by which targets of a plate are searched for around where they were."""
    moving = compiled.moving
    return None if moving is None or moving.relocalize is None else moving.relocalize.sudden


def is_sudden(work: FrameContext, target: str, previous: TargetState, fit: float) -> bool:
    """True where a tracked target, whose best hypothesis fits so well, is to be searched for."""
    rule, typical_fit = _sudden_rule(work.plate_of(target)), usual_fit(previous.scored)
    if rule is None or typical_fit is None or work.net.targets[target].status != "tracking":
        return False
    is_large = min(work.frame.width, work.frame.height) >= 3
    return fit / typical_fit < rule.below_fit and is_large and _pans(rule, previous.belief.mean[:4], work)


def _fit(plan: Plan, step: Step[Posterior]) -> float:
    """Likelihood of the best hypothesis, geometric mean over the agents that saw something."""
    evidence = step.evidence
    silent = {agent for agent, measurement in evidence.measured.items() if measurement is None}
    seeing = [observation.agent for observation in plan.observations if observation.agent not in silent]
    return fit_of([evidence.messages[agent] for agent in seeing if agent in evidence.messages])


def _pans(rule: Sudden, box: Floats, work: FrameContext) -> bool:
    """True if the whole picture moved far enough for a target in the centre box (4,) to be searched for."""
    if rule.pan_box == 0.0:
        return True
    from bayesnet_track.vision.motion_planes import PanPlane

    plane, frame = PanPlane(), work.frame
    shift = work.cache.planes([plane], Region(0, 0, frame.width, frame.height))[plane]
    return bool(np.hypot(*shift) >= rule.pan_box * np.sqrt(box[2] * box[3]))


def _widened(rule: Sudden, share: float, box: Floats, motion: MotionModel, work: FrameContext) -> Jumping:
    """`motion`, or with probability `rule.share` anywhere in the square around the centre box (4,)."""
    width, height = work.frame.width, work.frame.height
    half_px = rule.reach_box * float(np.sqrt(box[2] * box[3]))
    search = Search(
        hypotheses=rule.share,
        by="agents",
        probes=(int(2.0 * rule.reach_box / CELL_BOX) + 1) ** 2,
        boxes=np.empty((0, 4)),
        scores=np.empty(0),
        ud_px2=0.0,
        above_px2=0.0,
        fit=share,
        below_fit=rule.below_fit,
    )
    base = motion.motion if isinstance(motion, Jumping) else motion
    return Jumping(
        base, rule.share, width, height, search, Within.around(box, half_px, width, height, CELL_BOX)
    )


By = Callable[[Plan], Step[Posterior]]
"""Another step of the frame, by the agents of a plan."""


def plan_without_calls(work: FrameContext, target: str, state: TargetState) -> Plan:
    """The plan of the agents that look at a frame first.

    `before.plan` itself when none is left out: nothing is to be weighed again then.
    """
    plate, plan = work.plate_of(target).plate, state.plan
    if on_call_rule(plate) is None:
        return plan
    by_hand = work.net.targets[target].by_hand
    first = {agent for agent in plan.active if plate.governor[agent] != plate.root or agent in by_hand}
    return plan_for(work.plate_of(target), frozenset(first)) if first and first != plan.active else plan


def call_agents(
    work: FrameContext,
    target: str,
    state: TargetState,
    observer: Observer,
    steps: tuple[Plan, Step[Posterior], By],
) -> tuple[Plan, Step[Posterior], OnCallOutcome | None]:
    """The agents that took part in the frame, its step, and what became of those on call.

    `steps` are the agents that look first, their step, and what makes another. Those on call run, too,
    where none of the first gave an answer. Then, or where they gave none themselves, nothing can be compared.
    """
    plan, first, step_of = steps
    plate, net = work.plate_of(target).plate, work.net.targets[target]
    root = plate.inference(plate.root)
    agents = tuple(
        observation.agent for observation in state.plan.observations if observation.agent not in plan.active
    )
    first_estimate = estimate(root.estimate, first)
    reading = _read(plate, state.memory, plan, first, first_estimate)
    due = is_due(net, work.frame.index) or plan.active <= _without_answer(observer)
    if not due and (reading is None or not reading.above):
        return plan, first, OnCallOutcome(agents, ran=False)
    _ask_around(state.plan, observer, agents, hypotheses_of(first_estimate[None], first.posterior.fields))
    combined, failed = step_of(state.plan), _without_answer(observer)
    ran = tuple(agent for agent in agents if agent not in failed)
    if not ran or plan.active <= failed:
        return state.plan, combined, None
    share = overlap_of_two(first_estimate[:4], estimate(root.estimate, combined)[:4])
    cause = None if due or reading is None else reading.cause(1, reading.value)
    return state.plan, combined, OnCallOutcome(ran, True, share, cause)


def _without_answer(observer: Observer) -> set[str]:
    return observer.faults.keys() | observer.missed.keys()


def _ask_around(plan: Plan, observer: Observer, agents: Collection[str], hypotheses: Hypotheses) -> None:
    """Ask the agents that measure, once a frame, where the others found the target: they search around it."""
    observations = [
        observation
        for observation in plan.observations
        if observation.agent in agents and observation.measures and observation.at == plan.root
    ]
    ask_agents(
        Question({plan.root: hypotheses}, np.zeros(1), region_of_boxes(hypotheses.boxes)),
        observer,
        observations,
    )


def _read(
    plate: CheckedTarget, memory: RuleMemory, plan: Plan, step: Step[Posterior], state: Floats
) -> Reading | None:
    """UD of a step by the agents of a plan, without those on call; its estimate is `state` (D,)."""
    rule = on_call_rule(plate)
    assert rule is not None
    ud_px2 = step.posterior.uncertainty(step.map_state, state_columns(plate, plate.root))
    # Of more agents the baseline is lower: they would always be called.
    quiet = (
        baseline_level(plate, plan.active, memory, plate.root) if rule.above.kind == "ud_baseline" else None
    )
    return read_level(rule.above, ud_px2, float(state[2] * state[3]), quiet)


def overlap_of_two(a: Floats, b: Floats) -> float:
    """`overlap` of two centre boxes (4,), in a tenth of the time.

    >>> overlap_of_two(np.array([0.0, 0.0, 2.0, 2.0]), np.array([1.0, 0.0, 2.0, 2.0]))
    0.3333333333333333
    """
    (x, y, w, h), (u, v, other_width, other_height) = a.tolist(), b.tolist()
    width = min(x + w / 2, u + other_width / 2) - max(x - w / 2, u - other_width / 2)
    height = min(y + h / 2, v + other_height / 2) - max(y - h / 2, v - other_height / 2)
    intersection = max(width, 0.0) * max(height, 0.0)
    union = w * h + other_width * other_height - intersection
    return intersection / union if union > 0 else 0.0


def is_due(net: TargetNet, frame: int) -> bool:
    """True where agents on call run in a frame, whatever the others say of it."""
    return net.turn is None or frame >= net.turn.due or net.status == "lost"
