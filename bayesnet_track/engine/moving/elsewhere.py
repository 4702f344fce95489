"""A missing target of a Gaussian belief is looked for at another place in each frame.

A Gaussian has no hypotheses to spare for a search. Agents that measure and say how sure they are look
instead. The odds of their confidence stand for the likelihood of the target against none, and the belief
moves to where it more probably is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.belief.contract import BOX_FIELDS, Posterior, Step, hypotheses_of
from bayesnet_track.belief.motion.jumps import TELL_ABOVE, Within
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.moving.predicting import MotionContext, PredictedMotion
from bayesnet_track.engine.scoring.score import log_odds
from bayesnet_track.engine.state import TargetState, inside_frame
from bayesnet_track.graph.settings.motion import Relocalize
from bayesnet_track.inference.compile import Plan
from bayesnet_track.inference.observe import Observer, Question, ask_agents
from bayesnet_track.journal.events.beliefs import Reappeared
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import overlap_of_two
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import Measurement
from bayesnet_track.observation.planes import region_of_boxes

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
