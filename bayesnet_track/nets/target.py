"""One target of the net: how it starts, and how one frame goes for it.

A frame has two halves. `weigh` predicts the target's belief and weighs it by what its agents see; `conclude`
measures that, decides what changes, and learns. Between the two the beliefs of several targets can be joined.
Both are functions of the target's state and the frame; time is read for the timings only.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.guard import Judged, Watched, changes, guard, judge, watch
from bayesnet_track.adapt.learn import adapt_reference, learn_first, learn_references, learning_rate
from bayesnet_track.adapt.measure import measure
from bayesnet_track.adapt.memory import Memory, Streak
from bayesnet_track.adapt.parts import part_rates
from bayesnet_track.adapt.rules import decide
from bayesnet_track.adapt.situation import Situation, quiet_level
from bayesnet_track.belief.bounds import Confined
from bayesnet_track.belief.contract import Motion, Posterior, Step
from bayesnet_track.belief.estimate import estimate
from bayesnet_track.belief.states import hypotheses_of
from bayesnet_track.cue import ANGLE, Hypotheses, LocallyAdaptable, Reference
from bayesnet_track.executor import Executor
from bayesnet_track.graph.net import Decision, LocallyAdapted, Net, Quarantined, TargetStarted, apply
from bayesnet_track.inference.compile import Plan, compile_plan
from bayesnet_track.inference.messages import Observer, evaluate
from bayesnet_track.inference.parts import nominal_boxes
from bayesnet_track.journal.events import DegenerateBelief, Event, FrameMetrics
from bayesnet_track.journal.join_events import JoinMetrics
from bayesnet_track.machinery import Engine, Machinery
from bayesnet_track.nets.frame_metrics import first_frame_metrics, frame_metrics
from bayesnet_track.nets.predicting import Outlook, Predicted, outlook, predicted
from bayesnet_track.nets.score import Scored, probability
from bayesnet_track.planes import Frame, FramePair, PlaneCache

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TargetState:
    """What is known of one live target.

    Attributes:
        belief: the posterior of the last frame.
        references: agent -> what it remembers.
        memory: what the rules remember.
        plan: the compiled net.
        time: time of the last frame, frame intervals.
        watched: the slow references that guard the others against drift.
        outlook: what its motion depends on besides its states; None when on nothing.
        scored: what its score remembers.
    """

    belief: Posterior
    references: Mapping[str, Reference]
    memory: Memory
    plan: Plan
    time: float
    watched: Watched = field(default_factory=Watched)
    outlook: Outlook | None = None
    scored: Scored = field(default_factory=Scored)


@dataclass(frozen=True, eq=False)
class Born:
    """A target that starts in a frame: its state, the decisions, and what is written down of it."""

    state: TargetState
    decisions: tuple[Decision, ...]
    metrics: FrameMetrics


@dataclass(frozen=True, eq=False)
class Weighed:
    """The first half of a target's frame: its belief, weighed by its own agents.

    Attributes:
        target: target id.
        before: its state after the last frame.
        step: the belief's step.
        faults: agents that failed while they observed.
        predicted: how it was to move.
    """

    target: str
    before: TargetState
    step: Step[Posterior]
    faults: tuple[Quarantined, ...]
    predicted: Predicted


@dataclass(frozen=True, eq=False)
class Concluded:
    """The second half: what one frame gave for one target.

    Attributes:
        state: its state after the frame, still with the plan that the frame began with.
        metrics: what was measured.
        decisions: in order; they take effect on the next frame.
        told: what is written down besides.
        covariance: (D, D) of its belief.
    """

    state: TargetState
    metrics: FrameMetrics
    decisions: tuple[Decision, ...]
    told: tuple[Event, ...]
    covariance: Floats


def start(
    engine: Engine,
    frame: Frame,
    previous: Frame | None,
    target: str,
    template: str,
    box: Floats,
    known: Mapping[str, Reference] = MappingProxyType({}),
) -> Born:
    """A net for the target inside the centre box (4,) of `frame`: references learnt, belief placed.

    The belief of the first frame is the box itself; hypotheses spread with the first prediction. An agent
    that cannot learn its reference, or that needs colour where the frame has none, is out from the start.
    `known` are references that agents have already and need not learn.
    """
    machine = engine.machinery[template]
    active = tuple(agent for agent in machine.plate.agents if machine.plate.agent(agent).active)
    stream = partial(engine.streams.of, target, machine.plate.root, frame.index)
    parts = {part: _inside(at, frame) for part, at in nominal_boxes(machine.plate, box).items()}
    own = {agent: parts[part] for agent, part in machine.part_of.items()}
    unknown = {agent: cue for agent, cue in machine.cues.items() if agent not in known}
    learnt, faults = learn_first(unknown, PlaneCache(FramePair(frame, previous)), box, own, engine.executor)
    references = {**learnt, **known}
    if not frame.has_color:
        faults |= dict.fromkeys(sorted(machine.color_agents), "needs colour, and the source is gray")
    x, y, w, h = (float(v) for v in box)
    decisions: list[Decision] = [
        TargetStarted(frame.index, target, template, (x, y, w, h), active),
        *_quarantined(frame.index, target, faults),
    ]
    working = tuple(agent for agent in active if agent not in faults)
    born = TargetState(
        belief=machine.belief.start(box, Confined(machine.motion, frame.width, frame.height), stream),
        references=references,
        memory=Memory(),
        plan=compile_plan(machine.plate, working, machine.cues),
        time=frame.time,
        watched=watch(references, machine.looks, machine.guard),
        outlook=outlook(machine, box, FramePair(frame, previous)),
    )
    metrics = first_frame_metrics(frame, target, len(born.belief), working, box, parts)
    return Born(born, tuple(decisions), metrics)


def restart(
    engine: Engine,
    frame: Frame,
    previous: Frame | None,
    target: str,
    template: str,
    box: Floats,
    before: TargetState,
) -> TargetState:
    """The target as it was, its belief in the centre box (4,): agents that know its looks remember them."""
    machine = engine.machinery[template]
    stream = partial(engine.streams.of, target, machine.plate.root, frame.index)
    placed = {agent: cue for agent, cue in machine.cues.items() if agent not in machine.looks}
    parts = {part: _inside(at, frame) for part, at in nominal_boxes(machine.plate, box).items()}
    own = {agent: parts[part] for agent, part in machine.part_of.items()}
    learnt, _ = learn_first(placed, PlaneCache(FramePair(frame, previous)), box, own, engine.executor)
    return replace(
        before,
        belief=machine.belief.start(box, Confined(machine.motion, frame.width, frame.height), stream),
        references={**before.references, **learnt},
        memory=replace(
            before.memory,
            activate={},
            deactivate={},
            lost=Streak(),
            found=Streak(),
            seen=Streak(),
            unsure=Streak(),
        ),
        scored=replace(before.scored, smooth={}),
        time=frame.time,
    )


def weigh(
    engine: Engine,
    net: Net,
    before: TargetState,
    target: str,
    frame: Frame,
    cache: PlaneCache,
    seconds: dict[str, float],
    motion: Motion | None = None,
) -> Weighed:
    """Predict the target's belief and weigh it by what its active agents see; `seconds` is added to.

    `motion` stands in for the plate's.
    """
    machine = engine.machinery[net.targets[target].template]
    stream = partial(engine.streams.of, target, machine.plate.root, frame.index)
    started = engine.clock()
    observer = Observer(
        cache,
        machine.cues,
        before.references,
        stream,
        engine.clock,
        seconds,
        executor=engine.executor,
    )
    dt, is_lost = frame.time - before.time, net.targets[target].status == "lost"
    moves = predicted(machine, motion, before.outlook, is_lost, dt, cache)
    stepped = machine.belief.step(
        before.belief,
        Confined(moves.motion, frame.width, frame.height),
        dt,
        partial(evaluate, before.plan, observer),
        stream,
    )
    _charge(engine, seconds, "belief", started)
    return Weighed(target, before, stepped, _quarantined(frame.index, target, observer.faults), moves)


def conclude(
    engine: Engine,
    net: Net,
    weighed: Weighed,
    frame: Frame,
    cache: PlaneCache,
    seconds: dict[str, float],
    join: JoinMetrics | None = None,
    by_hand: tuple[Decision, ...] = (),
) -> Concluded:
    """Measure the belief, decide what changes, learn the references; `seconds` is added to.

    `join` is what a joint belief says of it: the less of it is visible the less is learnt, and nothing when
    half of it is hidden, since the box shows what hides it. `by_hand` is what a person switched, of which the
    rules know.
    """
    hidden = 0.0 if join is None else join.hidden
    target, before, stepped = weighed.target, weighed.before, weighed.step
    live = net.targets[target]
    machine = engine.machinery[live.template]
    root = machine.plate.inference(machine.plate.root)
    stream = partial(engine.streams.of, target, machine.plate.root, frame.index)

    started = engine.clock()
    state = estimate(root.estimate, stepped)
    box = _inside(state[:4], frame)
    started = _charge(engine, seconds, "belief", started)

    working = applied(net, (*weighed.faults, *by_hand)).targets[target]
    measures = measure(machine.plate, before.plan, stepped, float(box[2] * box[3]))
    scored, score = before.scored, None
    if root.score is not None:
        rule = root.score.settings
        scored = scored.after(rule, measures, stepped, measures.ud_px2[machine.plate.root])
        score = probability(rule, scored.smooth)
    now = Situation(
        frame.index,
        target,
        machine.plate,
        working,
        measures,
        machine.costs_ms,
        machine.adaptable,
        hidden,
        score,
    )
    chosen, memory = decide(now, before.memory)
    started = _charge(engine, seconds, "measure", started)

    quiet = quiet_level(machine.plate, working, memory, machine.plate.root)
    rate = learning_rate(root.learn, measures.ud_px2[machine.plate.root], measures.area_px2, quiet)
    at_parts = part_rates(root.learn, measures.parts, partial(quiet_level, machine.plate, working, memory))
    seen = max(1.0 - 2.0 * hidden, 0.0)
    rate, at_parts = rate * seen, {part: own * seen for part, own in at_parts.items()}
    if working.status != "tracking" or not working.active or stepped.degenerate is not None:
        rate, at_parts = 0.0, {}
    rates = {
        agent: at_parts.get(machine.part_of.get(agent, ""), rate) * most
        for agent, most in machine.rate_max.items()
        if agent not in working.quarantined
    }
    own = {agent: _inside(measures.parts[part].box, frame) for agent, part in machine.part_of.items()}
    at = hypotheses_of(np.concatenate([box, state[4:]])[None], stepped.posterior.fields)
    references, watched, judged, decisions = _learn(
        now, machine, before, rates, cache, at, own, chosen, engine.executor
    )
    _charge(engine, seconds, "learn", started)

    ahead = weighed.predicted.after(measures.ud_px2[machine.plate.root], measures.area_px2, quiet)
    after = TargetState(
        stepped.posterior, references, memory, before.plan, frame.time, watched, ahead, scored
    )
    told = [*weighed.predicted.told, *(report(frame.index, target) for report in stepped.reports)]
    if stepped.degenerate is not None:
        told.append(DegenerateBelief(frame.index, target, stepped.degenerate))
    told += changes(frame.index, target, before.watched, watched, judged, machine.guard)
    spread = stepped.posterior.covariance
    metrics = frame_metrics(
        frame,
        target,
        machine.plate,
        live.status,
        stepped,
        measures,
        box,
        spread,
        quiet,
        rate,
        stream,
        join,
        None if score is None else (score, scored.smooth),
        _angle(at),
    )
    return Concluded(after, metrics, (*weighed.faults, *by_hand, *decisions), tuple(told), spread)


def applied(net: Net, decisions: Iterable[Decision]) -> Net:
    """The net after the decisions, in their order."""
    for decision in decisions:
        net = apply(net, decision)
    return net


def recompiled(engine: Engine, net: Net, target: str, state: TargetState) -> TargetState:
    """The state with its plan compiled again when its active agents changed."""
    live = net.targets[target]
    if live.active == state.plan.active:
        return state
    machine = engine.machinery[live.template]
    return replace(state, plan=compile_plan(machine.plate, live.active, machine.cues))


def _learn(
    now: Situation,
    machine: Machinery,
    before: TargetState,
    rates: Mapping[str, float],
    cache: PlaneCache,
    at: Hypotheses,
    own: Mapping[str, Floats],
    chosen: tuple[Decision, ...],
    executor: Executor,
) -> tuple[dict[str, Reference], Watched, Judged, tuple[Decision, ...]]:
    """Move all references that are guarded by none or agree with their guard, then carry out local actions.

    Agents in `own` look at a part, whose box (4,) it holds, the others at the estimate `at`.

    Returns:
        The references, their guard and what it said, and the decisions that stand: those chosen, without
        actions that found nothing left to try, and the quarantine of agents that failed here.
    """
    judged = judge(before.watched, before.references, machine.cues, rates, cache, at, machine.guard, own)
    free = {agent: rate for agent, rate in rates.items() if agent not in judged.held}
    moved, faults = learn_references(
        before.references, machine.cues, free, cache, at.boxes[0], own, _angle(at), executor
    )
    moved, watched, failed = guard(before.watched, judged, moved, machine.cues, rates, machine.guard)
    faults |= failed
    kept: list[Decision] = []
    for decision in chosen:
        if isinstance(decision, LocallyAdapted):
            cue = machine.cues[decision.node]
            assert isinstance(cue, LocallyAdaptable)
            if decision.node in faults:
                continue
            tuned = adapt_reference(cue, moved[decision.node], decision.attempt)
            if isinstance(tuned, str):
                faults[decision.node] = tuned
            if tuned is None or isinstance(tuned, str):
                continue
            moved[decision.node] = tuned
        kept.append(decision)
    return moved, watched, judged, (*kept, *_quarantined(now.frame, now.target, faults))


def _quarantined(frame: int, target: str, faults: Mapping[str, str]) -> tuple[Quarantined, ...]:
    return tuple(Quarantined(frame, target, agent, reason) for agent, reason in faults.items())


def _angle(at: Hypotheses) -> float:
    """The estimate's rotation, degrees; 0 for a motion without one."""
    return float(at.fields[ANGLE][0]) if ANGLE in at.fields else 0.0


def _inside(box: Floats, frame: Frame) -> Floats:
    """The box with its centre on the image, so that tracks and references stay meaningful."""
    x, y, w, h = box.tolist()
    return np.array(
        [
            min(max(x, 0.0), frame.width - 1.0),
            min(max(y, 0.0), frame.height - 1.0),
            min(max(w, 1.0), 2.0 * frame.width),
            min(max(h, 1.0), 2.0 * frame.height),
        ]
    )


def _charge(engine: Engine, seconds: dict[str, float], name: str, started: float) -> float:
    now = engine.clock()
    seconds[name] = seconds.get(name, 0.0) + now - started
    return now
