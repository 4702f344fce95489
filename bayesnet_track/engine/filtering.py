"""The first half of a target's frame: predict its belief and weigh it by what its active agents see."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any, cast

import numpy as np

from bayesnet_track.adapt.rule_inputs import OnCallOutcome
from bayesnet_track.adapt.status import quarantine
from bayesnet_track.belief.contract import (
    BeliefFilter,
    Evaluate,
    Evidence,
    GroupEvidence,
    MotionModel,
    Posterior,
    Step,
    Stream,
    hypotheses_of,
)
from bayesnet_track.belief.gaussian.belief import GaussianFilter, GaussianPosterior
from bayesnet_track.belief.motion.formulas import Undefined, undefined_in
from bayesnet_track.belief.motion.modes import Modes
from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.engine.frame_context import FrameContext, ask_together
from bayesnet_track.engine.modes import ModeState, combination_probabilities, with_kinds
from bayesnet_track.engine.predicting import PredictedMotion, predict_motion
from bayesnet_track.engine.second_steps import (
    call_agents,
    look_elsewhere,
    plan_without_calls,
    search_around,
)
from bayesnet_track.engine.state import TargetState, with_agents
from bayesnet_track.inference.asking import is_elsewhere
from bayesnet_track.inference.compile import Observe, Plan, compile_plan
from bayesnet_track.inference.factors import Flaw
from bayesnet_track.inference.hidden import Sight, evaluate_modes
from bayesnet_track.inference.messages import Observer, evaluate
from bayesnet_track.inference.observe import Answer, Detected
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.journal.metrics import JoinMetrics
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import OWN_DETECTION, AssociatingCue, Hypotheses


@dataclass(frozen=True, eq=False)
class Ride:
    """Motion of a target that may be carried: with its carrier, or as its plate moves.

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


@dataclass(frozen=True, eq=False)
class Ready:
    """A target about to be filtered.

    Attributes:
        target: target id.
        before: its state after the last frame, with the plan of the agents that look.
        prior: its belief.
        belief: how that is held.
        moves: how the target is to move.
        plan: the agents that look first.
        stream: its random numbers.
        is_carried: whether another target may carry it.
    """

    target: str
    before: TargetState
    prior: Posterior
    belief: BeliefFilter[Any]
    moves: PredictedMotion
    plan: Plan
    stream: Stream
    is_carried: bool

    @classmethod
    def of(cls, work: FrameContext, target: str, previous: TargetState, ride: Ride | None = None) -> Ready:
        """A target with its motion in the frame and its agents."""
        live, compiled, frame = work.net.targets[target], work.plate_of(target), work.frame
        previous = with_agents(compiled, previous, live.looking(frame.ordinal))
        ride_motion, prior = (None, previous.belief) if ride is None else (ride.motion, ride.belief)
        dt = frame.time - previous.time
        moves = predict_motion(
            compiled, ride_motion, previous.motion_context, live.status == "lost", dt, work.cache
        )
        belief = within(compiled.belief, live.most_particles)
        plan = plan_without_calls(work, target, previous)
        stream = work.stream(target, compiled.plate.root)
        return cls(target, previous, prior, belief, moves, plan, stream, ride is not None)


Stepped = tuple[Observer, Step[Posterior]]
"""The step of a target, and what asked its agents."""


def ready_each(work: FrameContext, states: Mapping[str, TargetState]) -> list[tuple[Ready, Stepped | None]]:
    """The targets, each with its step where Gaussian beliefs that move alike have been stepped at once."""
    ready = [Ready.of(work, target, state) for target, state in states.items()]
    groups: dict[Hashable, list[Ready]] = {}
    for target in ready:
        if isinstance(target.belief, GaussianFilter) and not work.availability.known:
            plate, agents = work.net.targets[target.target].template, target.plan.active
            key = (plate, agents, target.before.time, id(target.belief), id(target.moves.motion))
            groups.setdefault(key, []).append(target)
    steps: dict[str, Stepped] = {}
    for group in groups.values():
        if len(group) > 1 or Detected.fits(group[0].plan):
            steps |= _step_each(work, group)
    return [(target, steps.get(target.target)) for target in ready]


def filter_target(
    work: FrameContext, target: str, previous: TargetState, ride: Ride | None = None
) -> Filtered:
    """Predict the target's belief and weigh it by what its active agents see."""
    return filter_ready(work, Ready.of(work, target, previous, ride))


def filter_ready(work: FrameContext, ready: Ready, stepped: Stepped | None = None) -> Filtered:
    """The first half of a target's frame, whose belief was `stepped` already or is now.

    It is weighed anew, without them, when agents fail that have answered before in the same frame. Those that
    failed when they were asked about a group are not asked again.
    """
    target, previous, prior, moves = ready.target, ready.before, ready.prior, ready.moves
    compiled, belief, stream, frame = work.plate_of(target), ready.belief, ready.stream, work.frame
    start, dt = work.engine.clock(), frame.time - previous.time
    motion = work.confined(moves.motion)
    failed: MutableMapping[str, str] = dict(work.faults.get((target, "observing"), {}))
    while True:
        observer = _observer(work, ready, failed) if stepped is None else stepped[0]
        failed = observer.faults
        see = partial(_evaluation, work, compiled.modes, observer)
        plan, call, motion_of_step = ready.plan, None, moves
        step = belief.step(prior, motion, dt, see(plan), stream) if stepped is None else stepped[1]
        if plan is not previous.plan:
            step_by = partial(_step_by, work, belief, (prior, dt, stream, moves.motion), see)
            plan, step, call = call_agents(work, target, previous, observer, (plan, step, step_by))
        if not ready.is_carried:
            step_again = partial(_step_again, work, belief, (prior, dt, see(plan), stream))
            motion_of_step, step = search_around(work, target, previous, moves, (plan, step, step_again))
            restart = partial(_step_from, work, belief, plan, (motion, dt, stream, compiled.modes, prior))
            motion_of_step, step = look_elsewhere(
                work, target, previous, motion_of_step, (plan, step, observer, restart)
            )
        # With the answers of one that later gave none the belief would be neither with it nor without it.
        if not observer.broke_off:
            break
        stepped = None
    work.charge("belief", start)
    return _filtered(work, ready, (motion, motion_of_step, plan, step), observer, call)


def _filtered(
    work: FrameContext,
    ready: Ready,
    results: tuple[MotionModel, PredictedMotion, Plan, Step[Posterior]],
    observer: Observer,
    call: OnCallOutcome | None,
) -> Filtered:
    """The first half of a frame, with what became of the agents, from the `results` of its step."""
    motion, predicted, plan, step = results
    target, previous, failed = ready.target, ready.before, observer.faults
    live, compiled, dt = work.net.targets[target], work.plate_of(target), work.frame.time - previous.time
    faults = tuple(
        quarantine(live, work.frame.index, target, agent, reason) for agent, reason in failed.items()
    )
    absent = failed.keys() | observer.missed.keys()
    if absent:
        plan = compile_plan(compiled.plate, plan.active - absent, compiled.cues)
    missed, flaws = dict(observer.missed), dict(observer.factors.flaws)
    undefined = {**undefined_in(motion), **observer.factors.undefined}
    modes = None
    if compiled.modes is not None:
        modes = ModeState.of(compiled.modes, ready.prior, step.posterior, dt)
    return Filtered(
        target,
        previous,
        step,
        faults,
        predicted,
        plan,
        missed,
        flaws=flaws,
        undefined=undefined,
        modes=modes,
        call=call,
    )


def _observer(work: FrameContext, ready: Ready, failed: MutableMapping[str, str]) -> Observer:
    """Observer of a target, without agents that `failed`."""
    return Observer(
        work.cache,
        work.plate_of(ready.target).cues,
        ready.before.references,
        ready.stream,
        work.engine.clock,
        work.seconds,
        faults=failed,
        availability=work.availability_of(ready.target, "observing"),
    )


def _step_each(work: FrameContext, group: Sequence[Ready]) -> dict[str, Stepped]:
    """Target -> its step, of Gaussian beliefs that move alike and are asked about by the same agents."""
    start, first, frame = work.engine.clock(), group[0], work.frame
    belief, dt = first.belief, frame.time - first.before.time
    assert isinstance(belief, GaussianFilter)
    observers = [
        _observer(work, ready, dict(work.faults.get((ready.target, "observing"), {}))) for ready in group
    ]
    motion = work.confined(first.moves.motion)
    see = partial(_evaluate_each, work, group, observers)
    priors = [cast(GaussianPosterior, ready.prior) for ready in group]
    steps = belief.step_each(priors, motion, dt, see, [ready.stream for ready in group])
    work.charge("belief", start)
    if undefined_in(motion):  # of which target is found out where each is stepped by itself
        return {}
    return dict(zip((ready.target for ready in group), zip(observers, steps, strict=True), strict=True))


def _evaluate_each(
    work: FrameContext,
    group: Sequence[Ready],
    observers: Sequence[Observer],
    hypotheses: Sequence[Hypotheses],
    log: Sequence[Floats],
) -> GroupEvidence:
    """Evidence of the net about each one's hypotheses; agents that score many targets are asked once."""
    plan, compiled = group[0].plan, work.plate_of(group[0].target)
    references = {
        observe.agent: [observer.references[observe.agent] for observer in observers]
        for observe in plan.observations
        if observe.at == plan.root and not observe.measures and _scores_each(compiled.cues[observe.agent])
        if all(observe.agent in observer.references for observer in observers)
    }
    known_answers: list[dict[Observe, Answer]] = [{} for _ in group]
    views: list[dict[str, Hypotheses] | None] = [None for _ in group]
    if references or plan.views:
        boxes = np.concatenate([cloud.boxes for cloud in hypotheses])
        fields = {
            name: np.concatenate([cloud.fields[name] for cloud in hypotheses])
            for name in hypotheses[0].fields
        }
        together, starts = Hypotheses(boxes, fields), np.cumsum([0, *map(len, hypotheses)])
    if plan.views:
        projected = {view.node: view.project(together, work.frame) for view in plan.views}
        ends = pairwise(starts.tolist())
        views = [{node: cloud.part(*rows) for node, cloud in projected.items()} for rows in ends]
    size = len(hypotheses[0])
    if Detected.fits(plan) and all(len(cloud) == size for cloud in hypotheses):
        detected = Detected.read(plan, observers)
        if detected is not None:
            return detected.evaluate([clouds or {} for clouds in views], size)
    if references:
        scored = {
            observe: replace(observe, temperature=1.0)
            for observe in plan.observations
            if observe.agent in references
        }
        scoring_plan = replace(plan, observations=tuple(scored.values()))
        answers, failed = ask_together(work, (compiled, scoring_plan, references), together, starts)
        for t in range(len(group)):
            if t not in failed:
                rows = slice(starts[t], starts[t + 1])
                known_answers[t] = {observe: answers[observe.agent][rows] for observe in scored}
    inputs_of_each = zip(observers, hypotheses, log, known_answers, views, strict=True)
    return GroupEvidence([evaluate(plan, *inputs) for inputs in inputs_of_each])


def _scores_each(cue: object) -> bool:
    """True of a cue that scores hypotheses of many targets at once, and is at work here."""
    return hasattr(cue, "log_likelihood_of_each") and not is_elsewhere(cue)


def _step_again(
    work: FrameContext,
    belief: BeliefFilter[Any],
    inputs: tuple[Posterior, float, Evaluate, Stream],
    motion: MotionModel,
) -> Step[Posterior]:
    """The step of the frame by another motion, with random numbers of its own."""
    prior, dt, see, stream = inputs
    confined_motion = work.confined(motion)
    return belief.step(prior, confined_motion, dt, see, lambda purpose: stream(f"{purpose} again"))


def evaluate_at(work: FrameContext, target: str, previous: TargetState, boxes: Floats) -> Evidence:
    """Evidence of a target's net about centre boxes (N, 4) that are as probable as each other.

    Every agent with a reference is asked, switched off or not. What a state holds beside the box is that of
    the belief's mean.
    """
    compiled = work.plate_of(target)
    more_fields = np.broadcast_to(previous.belief.mean[4:], (len(boxes), len(previous.belief.fields) - 4))
    hypotheses = hypotheses_of(np.hstack([boxes, more_fields]), previous.belief.fields)
    referenced = previous.references.keys() & set(compiled.plate.agents)
    plan = compile_plan(compiled.plate, referenced, compiled.cues).in_image()
    observer = Observer(
        work.cache,
        compiled.cues,
        previous.references,
        work.stream(target, compiled.plate.root),
        availability=work.availability_of(target, "observing"),
    )
    return evaluate(plan, observer, hypotheses, np.full(len(boxes), -np.log(len(boxes))))


def _step_by(
    work: FrameContext,
    belief: BeliefFilter[Any],
    inputs: tuple[Posterior, float, Stream, MotionModel],
    see: Callable[[Plan], Evaluate],
    plan: Plan,
) -> Step[Posterior]:
    """The step of the frame by more agents."""
    prior, dt, stream, motion = inputs
    own_stream = partial(_renamed, stream, "by more")
    return _step_again(work, belief, (prior, dt, see(plan), own_stream), motion)


def _step_from(
    work: FrameContext,
    belief: BeliefFilter[Any],
    plan: Plan,
    inputs: tuple[MotionModel, float, Stream, Modes | None, Posterior],
    box: Floats,
    observer: Observer,
) -> Step[Posterior]:
    """The step of the frame by a belief that starts in a centre box (4,)."""
    motion, dt, stream, modes, prior = inputs
    own_stream = partial(_renamed, stream, "elsewhere")
    start = with_kinds(belief.start(box, motion, own_stream), modes, combination_probabilities(prior, modes))
    step = belief.step(start, motion, dt, _evaluation(work, modes, observer, plan), own_stream)
    return evolve(step, ancestors=None)  # they are of a belief that starts here


def _renamed(stream: Stream, name: str, purpose: str) -> np.random.Generator:
    return stream(f"{purpose} {name}")


def _evaluation(work: FrameContext, modes: Modes | None, observer: Observer, plan: Plan) -> Evaluate:
    """Evidence of the net about hypotheses, those that are hidden included."""
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


def within(belief: BeliefFilter[Any], limit: int | None) -> BeliefFilter[Any]:
    """The belief with at most so many hypotheses."""
    if limit is None or not isinstance(belief, ParticleFilter):
        return belief
    settings = belief.settings
    if isinstance(settings.size, int):
        return ParticleFilter(settings.model_copy(update={"size": min(settings.size, limit)}))
    limits = {"min": min(settings.least, limit), "max": min(settings.most, limit)}
    return ParticleFilter(settings.model_copy(update=limits))
