"""A fast move: where suddenly nothing fits, the frame is filtered again, with a wider prior.

Whether it is depends on the frame, so its evidence then counts twice. That is the price of not searching a
large square in every frame: what comes out is a belief about the place, and no probability of the move.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bayesnet_track.belief.contract import MotionModel, Posterior, Step
from bayesnet_track.belief.motion.jumps import Jumping, Search, Within
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.moving.predicting import PredictedMotion
from bayesnet_track.engine.scoring.score import usual_fit
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.settings.motion import Sudden
from bayesnet_track.inference.compile import Plan
from bayesnet_track.inference.measure import fit_of
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.planes import Region

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
    rule, score = sudden_rule(compiled), compiled.plate.inference(compiled.plate.root).score
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


def sudden_rule(compiled: CompiledPlate) -> Sudden | None:
    """The rule by which targets of a plate are searched for around where they were."""
    moving = compiled.moving
    return None if moving is None or moving.relocalize is None else moving.relocalize.sudden


def is_sudden(work: FrameContext, target: str, previous: TargetState, fit: float) -> bool:
    """True where a tracked target, whose best hypothesis fits so well, is to be searched for."""
    rule, typical_fit = sudden_rule(work.plate_of(target)), usual_fit(previous.scored)
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
