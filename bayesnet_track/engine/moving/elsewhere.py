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
    """What agents say of a place.

    Attributes:
        box: (4,) centre box where the surest of them sees the target, px.
        log_odds: of their confidence, summed.
    """

    box: Floats
    log_odds: float


def look_elsewhere(
    work: FrameContext,
    target: str,
    before: TargetState,
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
    rule, here = compiled.moving.relocalize, first.posterior.mean[:4]
    box = before.belief.mean[:4] if context.held is None else context.held
    within = _reached(rule, context, box, work)
    places = _lay_places(within, APART_BOX * math.sqrt(box[2] * box[3]))
    place = np.concatenate([places[pick_place(work.frame.index, len(places))], box[2:]])
    found = _look_at(work, before, (plan, observer, agents), place)
    stays = _see(first.evidence.measured, agents, here).log_odds
    if found.log_odds <= max(stays, 0.0) or overlap_of_two(found.box, here) > 0.0:
        return moves, first
    gain = found.log_odds - stays - math.log(len(places))
    held = 1.0 / (1.0 + math.exp(-gain) * (1.0 - rule.share) / rule.share)
    if held <= TELL_ABOVE:
        return moves, first
    jumped = restart(found.box, replace(observer, measured={}))
    x, y = found.box[:2].tolist()
    event = Reappeared(
        frame=work.frame.index,
        target=target,
        by=" and ".join(sorted(agents)),
        hypotheses=0,
        held=held,
        level=TELL_ABOVE,
        share=rule.share,
        turning=1.0 / (1.0 + math.exp(gain)),
        x=x,
        y=y,
        moved_px=math.dist((x, y), before.belief.mean[:2].tolist()),
        ud_px2=context.ud_px2,
        above_px2=0.0,
        within_px=_searched(within.half_px, box, found.box),
    )
    context = evolve(context, influences=evolve(context.influences, jump_share=rule.share))
    return replace(moves, motion_context=context), evolve(
        jumped, reports=(*jumped.reports, lambda frame, target: event)
    )


def _that_look(searching: frozenset[str], plan: Plan, step: Step[Posterior]) -> frozenset[str]:
    """The agents of the whole that can look elsewhere and were asked in the frame's step."""
    able = {one.agent for one in plan.observations if one.agent in searching and one.at == plan.root}
    return frozenset(able & step.evidence.measured.keys())


def _is_missing(work: FrameContext, target: str, context: MotionContext) -> bool:
    """True if the target is lost, or uncertain for as long as it takes to be called lost."""
    status, plate = work.net.targets[target].status, work.plate_of(target).plate
    lost = plate.inference(plate.root).lost
    return status == "lost" or (status == "uncertain" and lost is not None and context.away > lost.frames)


def _reached(rule: Relocalize, context: MotionContext, box: Floats, work: FrameContext) -> Within:
    """Where the target may be by now that was last held in the centre box (4,)."""
    half_px = math.inf
    if rule.grow_box is not None and context.held is not None:
        half_px = rule.grow_box * context.away * math.sqrt(box[2] * box[3])
    return Within.around(box, half_px, work.frame.width, work.frame.height)


def _searched(half_px: float, box: Floats, found: Floats) -> float | None:
    """How far from a box it was searched, px; None for the whole frame. Finds farther away count, too."""
    if math.isinf(half_px):
        return None
    return max(half_px, float(np.abs(found[:2] - box[:2]).max()))


def _lay_places(within: Within, apart_px: float) -> Floats:
    """(M, 2) places on a lattice over the part of the frame, about so far apart, px."""
    lines = []
    for low, high in zip(within.low.tolist(), within.high.tolist(), strict=True):
        count = max(round((high - low) / apart_px), 1)
        lines.append(low + (np.arange(count) + 0.5) * (high - low) / count)
    return np.stack(np.meshgrid(*lines), axis=2).reshape(-1, 2)


def pick_place(frame: int, count: int) -> int:
    """Which of `count` places is looked at in a frame.

    Multiples of the golden ratio leave no gap in 0..1, so that all places have their turn, also if agents run
    in every second, third or fourth frame only.
    """
    return int(count * (frame * GOLDEN % 1.0))


def _look_at(
    work: FrameContext, before: TargetState, asked: tuple[Plan, Observer, frozenset[str]], box: Floats
) -> Find:
    """What agents see around a centre box (4,): they are asked with a hypothesis in each corner.

    One that fails there, or gives no answer, does so in this frame.
    """
    plan, observer, agents = asked
    states = np.tile(np.concatenate([box, before.belief.mean[4:]]), (len(CORNERS), 1))
    states[:, :2] += 0.5 * APART_BOX * math.sqrt(box[2] * box[3]) * CORNERS
    at = hypotheses_of(states, before.belief.fields)
    steps = [one for one in plan.observations if one.agent in agents and one.at == plan.root]
    alike = np.full(len(CORNERS), -math.log(len(CORNERS)))
    question = Question({plan.root: at}, alike, region_of_boxes(at.boxes))
    answers = ask_agents(question, replace(observer, measured={}), steps)
    measured = {one.agent: own if isinstance(own, Measurement) else None for one, own in answers.items()}
    found = _see(measured, agents, box)
    return replace(found, box=inside_frame(found.box, work.frame))


def _see(measured: Mapping[str, Measurement | None], agents: Collection[str], box: Floats) -> Find:
    """What the agents measured; one that measured nothing is as unsure as can be, and none leaves the box."""
    total, most, found = 0.0, -math.inf, box.copy()
    for agent in sorted(agents):
        one = measured.get(agent)
        own = log_odds(0.0 if one is None or one.confidence is None else one.confidence)
        total += own
        if one is not None and own > most:
            most, found = own, box.copy()
            for field, value in zip(one.fields, one.mean.tolist(), strict=True):
                if field in BOX_FIELDS:
                    found[BOX_FIELDS.index(field)] = value
    return Find(found, total)
