"""The first half of a target's frame: predict its belief and weigh it by what its active agents see."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from bayesnet_track.adapt.rule_inputs import OnCallOutcome
from bayesnet_track.adapt.status import quarantine
from bayesnet_track.belief.contract import (
    Belief,
    Evaluate,
    Evidence,
    MotionModel,
    Posterior,
    Step,
    Stream,
    hypotheses_of,
)
from bayesnet_track.belief.motion.borders import confined
from bayesnet_track.belief.motion.formulas import Undefined, undefined_in
from bayesnet_track.belief.motion.modes import Modes
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.modes import ModeState, kinds_of, with_kinds
from bayesnet_track.engine.moving.elsewhere import look_elsewhere
from bayesnet_track.engine.moving.predicting import PredictedMotion, predict_motion
from bayesnet_track.engine.moving.sudden import search_around
from bayesnet_track.engine.on_call import call_agents, plan_without_calls
from bayesnet_track.engine.shedding import within
from bayesnet_track.engine.state import TargetState, with_agents
from bayesnet_track.inference.compile import Plan, compile_plan
from bayesnet_track.inference.factors import Flaw
from bayesnet_track.inference.hidden import Sight, evaluate_modes
from bayesnet_track.inference.messages import Observer, evaluate
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.journal.metrics import JoinMetrics
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import OWN_DETECTION, AssociatingCue


@dataclass(frozen=True, eq=False)
class Ride:
    """How a target that may be carried moves: with its carrier, or as its plate does.

    Attributes:
        motion: both, in place of the plate's motion.
        belief: the target's, each hypothesis with whether it is carried.
    """

    motion: MotionModel
    belief: Posterior


@dataclass(frozen=True, eq=False)
class Filtered:
    """The first half of a target's frame: its belief, weighed by its own agents.

    Attributes:
        target: target id.
        before: its state after the last frame.
        step: the belief's step.
        faults: agents that failed while they observed.
        predicted: how it was to move.
        plan: the compiled net of this frame, without those that failed or gave no answer.
        missed: agents that gave no answer for a reason outside of them -> that reason.
        join: what a joint belief says of it, once there is one; None for a target that is in none.
        flaws: factor -> what was wrong with its values.
        undefined: expression of the motion, or of a latent node -> at how many states it had no value.
        modes: its modes; None when it has none.
        call: what became of its agents on call; None without any.
    """

    target: str
    before: TargetState
    step: Step[Posterior]
    faults: tuple[Quarantined, ...]
    predicted: PredictedMotion
    plan: Plan
    missed: Mapping[str, str] = field(default_factory=dict)
    join: JoinMetrics | None = None
    flaws: Mapping[str, Flaw] = field(default_factory=dict)
    undefined: Mapping[str, Undefined] = field(default_factory=dict)
    modes: ModeState | None = None
    call: OnCallOutcome | None = None

    @property
    def resting(self) -> frozenset[str]:
        """The agents on call that did not run."""
        return frozenset() if self.call is None or self.call.ran else frozenset(self.call.agents)

    @property
    def hidden(self) -> float:
        """Expected share of the target that cannot be seen: another one hides it, or its mode does."""
        by_mode = 0.0 if self.modes is None else self.modes.hidden or 0.0
        return by_mode if self.join is None else max(self.join.hidden, by_mode)


def filter_target(work: FrameContext, target: str, before: TargetState, ride: Ride | None = None) -> Filtered:
    """Predict the target's belief and weigh it by what its active agents see.

    It is weighed anew, without them, when agents fail that have answered before in the same frame. Those that
    failed when they were asked about a group are not asked again.
    """
    live, compiled, frame = work.net.targets[target], work.plate_of(target), work.frame
    before = with_agents(compiled, before, live.looking(frame.ordinal))
    stream = work.stream(target, compiled.plate.root)
    started = work.engine.clock()
    dt = frame.time - before.time
    given, prior = (None, before.belief) if ride is None else (ride.motion, ride.belief)
    moves = predict_motion(compiled, given, before.motion_context, live.status == "lost", dt, work.cache)
    belief = within(compiled.belief, live.most_particles)
    motion = confined(moves.motion, frame.width, frame.height, work.inputs)
    failed = dict(work.faults.get((target, "observing"), {}))
    while True:
        observer = Observer(
            work.cache,
            compiled.cues,
            before.references,
            stream,
            work.engine.clock,
            work.seconds,
            faults=failed,
            availability=work.availability_of(target, "observing"),
        )
        see = partial(_evaluation, work, compiled.modes, observer)
        plan, call = plan_without_calls(work, target, before), None
        stepped, moved = belief.step(prior, motion, dt, see(plan), stream), moves
        if plan is not before.plan:
            by = partial(_step_by, work, belief, (prior, dt, stream, moves.motion), see)
            plan, stepped, call = call_agents(work, target, before, observer, (plan, stepped, by))
        if ride is None:
            again = partial(_step_again, work, belief, (prior, dt, see(plan), stream))
            moved, stepped = search_around(work, target, before, moves, (plan, stepped, again))
            restart = partial(_step_from, work, belief, plan, (motion, dt, stream, compiled.modes, prior))
            steps = plan, stepped, observer, restart
            moved, stepped = look_elsewhere(work, target, before, moved, steps)
        # With the answers of one that later gave none the belief would be neither with it nor without it.
        if not observer.broke_off:
            break
    work.charge("belief", started)
    faults = tuple(quarantine(live, frame.index, target, agent, reason) for agent, reason in failed.items())
    out = failed.keys() | observer.missed.keys()
    if out:
        plan = compile_plan(compiled.plate, plan.active - out, compiled.cues)
    missed, flaws = dict(observer.missed), dict(observer.factors.flaws)
    undefined = {**undefined_in(motion), **observer.factors.undefined}
    modes = None if compiled.modes is None else ModeState.of(compiled.modes, prior, stepped.posterior, dt)
    found = Filtered(
        target, before, stepped, faults, moved, plan, missed, flaws=flaws, undefined=undefined, call=call
    )
    return found if modes is None else replace(found, modes=modes)


def _step_again(
    work: FrameContext,
    belief: Belief[Any],
    given: tuple[Posterior, float, Evaluate, Stream],
    motion: MotionModel,
) -> Step[Posterior]:
    """The step of the frame by another motion, with random numbers of its own."""
    prior, dt, see, stream = given
    inside = confined(motion, work.frame.width, work.frame.height, work.inputs)
    return belief.step(prior, inside, dt, see, lambda purpose: stream(f"{purpose} again"))


def evaluate_at(work: FrameContext, target: str, before: TargetState, boxes: Floats) -> Evidence:
    """What the net of a target says of centre boxes (N, 4) that are as probable as each other.

    Every agent with a reference is asked, switched off or not. What a state holds beside the box is that of
    the belief's mean.
    """
    compiled = work.plate_of(target)
    rest = np.broadcast_to(before.belief.mean[4:], (len(boxes), len(before.belief.fields) - 4))
    hypotheses = hypotheses_of(np.hstack([boxes, rest]), before.belief.fields)
    known = before.references.keys() & set(compiled.plate.agents)
    plan = compile_plan(compiled.plate, known, compiled.cues).in_image()
    observer = Observer(
        work.cache,
        compiled.cues,
        before.references,
        work.stream(target, compiled.plate.root),
        availability=work.availability_of(target, "observing"),
    )
    return evaluate(plan, observer, hypotheses, np.full(len(boxes), -np.log(len(boxes))))


def _step_by(
    work: FrameContext,
    belief: Belief[Any],
    given: tuple[Posterior, float, Stream, MotionModel],
    see: Callable[[Plan], Evaluate],
    plan: Plan,
) -> Step[Posterior]:
    """The step of the frame by more agents."""
    prior, dt, stream, motion = given
    own = partial(_renamed, stream, "by more")
    return _step_again(work, belief, (prior, dt, see(plan), own), motion)


def _step_from(
    work: FrameContext,
    belief: Belief[Any],
    plan: Plan,
    given: tuple[MotionModel, float, Stream, Modes | None, Posterior],
    box: Floats,
    observer: Observer,
) -> Step[Posterior]:
    """The step of the frame by a belief that starts in a centre box (4,)."""
    motion, dt, stream, modes, prior = given
    own = partial(_renamed, stream, "elsewhere")
    start = with_kinds(belief.start(box, motion, own), modes, kinds_of(prior, modes))
    step = belief.step(start, motion, dt, _evaluation(work, modes, observer, plan), own)
    return evolve(step, ancestors=None)  # they are of a belief that starts here


def _renamed(stream: Stream, name: str, purpose: str) -> np.random.Generator:
    return stream(f"{purpose} {name}")


def _evaluation(work: FrameContext, modes: Modes | None, observer: Observer, plan: Plan) -> Evaluate:
    """What the net says of hypotheses, those that are hidden included."""
    visible = partial(evaluate, plan, observer)
    if modes is None:
        return visible
    unasked = frozenset(
        agent
        for agent, reference in observer.references.items()
        if isinstance(observer.cues.get(agent), AssociatingCue) and OWN_DETECTION not in reference
    )
    sight = Sight(modes, work.frame.width, work.frame.height, unasked)
    return partial(evaluate_modes, plan, sight, visible)
