"""One target of the net: how one frame goes for it.

A frame has two halves. `weigh` predicts the target's belief and weighs it by what its agents see; `conclude`
measures that, decides what changes, and learns. Between the two the beliefs of several targets can be joined.
Both are functions of the target's state and the frame; time is read for the timings only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.backoff import quarantined
from bayesnet_track.adapt.rules import decide
from bayesnet_track.adapt.situation import Situation, quiet_level
from bayesnet_track.belief.contract import Motion, Posterior, Step
from bayesnet_track.belief.estimate import estimate
from bayesnet_track.belief.motion.bounds import Confined
from bayesnet_track.belief.states import hypotheses_of
from bayesnet_track.engine.compiled import Engine
from bayesnet_track.engine.frame_metrics import frame_metrics
from bayesnet_track.engine.learning import angle_of, learn
from bayesnet_track.engine.predicting import Predicted, predicted
from bayesnet_track.engine.rivals import rival_seen
from bayesnet_track.engine.score import most, probability, with_rival
from bayesnet_track.engine.shedding import within
from bayesnet_track.engine.starting import start_late
from bayesnet_track.engine.state import TargetState, applied, inside_frame, with_agents
from bayesnet_track.inference.compile import Plan, compile_plan
from bayesnet_track.inference.guard import changes, watch
from bayesnet_track.inference.learn import learning_rate, over_frames
from bayesnet_track.inference.measure import measure
from bayesnet_track.inference.messages import Observer, evaluate
from bayesnet_track.inference.part_measures import part_rates
from bayesnet_track.journal.events.basic import Event, FrameMetrics
from bayesnet_track.journal.events.belief_events import DegenerateBelief
from bayesnet_track.journal.events.join_events import JoinMetrics
from bayesnet_track.journal.net.net import Decision, Net, Quarantined
from bayesnet_track.observation.planes import Frame, PlaneCache

__all__ = ["Concluded", "TargetState", "Weighed", "conclude", "weigh"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Weighed:
    """The first half of a target's frame: its belief, weighed by its own agents.

    Attributes:
        target: target id.
        before: its state after the last frame.
        step: the belief's step.
        faults: agents that failed while they observed.
        predicted: how it was to move.
        plan: the compiled net of this frame, without those that failed or gave no answer.
        missed: agents that gave no answer for a reason outside of them -> that reason.
    """

    target: str
    before: TargetState
    step: Step[Posterior]
    faults: tuple[Quarantined, ...]
    predicted: Predicted
    plan: Plan
    missed: Mapping[str, str] = field(default_factory=dict)


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

    It is weighed anew, without them, when agents fail that have answered before in the same frame. `motion`
    stands in for the plate's.
    """
    machine = engine.machinery[net.targets[target].template]
    before = with_agents(machine, before, net.targets[target].looking(frame.index))
    stream = partial(engine.streams.of, target, machine.plate.root, frame.index)
    started = engine.clock()
    dt, is_lost = frame.time - before.time, net.targets[target].status == "lost"
    moves = predicted(machine, motion, before.outlook, is_lost, dt, cache)
    belief = within(machine.belief, net.targets[target].most_particles)
    roll = engine.absent.roll(target, "observing")
    failed: dict[str, str] = {}
    while True:
        observer = Observer(
            cache,
            machine.cues,
            before.references,
            stream,
            engine.clock,
            seconds,
            faults=failed,
            executor=engine.executor,
            roll=roll,
        )
        stepped = belief.step(
            before.belief,
            Confined(moves.motion, frame.width, frame.height),
            dt,
            partial(evaluate, before.plan, observer),
            stream,
        )
        # With the answers of one that later gave none the belief would be neither with it nor without it.
        if not observer.broke_off:
            break
    _charge(engine, seconds, "belief", started)
    faults = tuple(
        quarantined(net.targets[target], frame.index, target, agent, reason)
        for agent, reason in failed.items()
    )
    plan, out = before.plan, failed.keys() | observer.missed.keys()
    if out:
        plan = compile_plan(machine.plate, plan.active - out, machine.cues)
    return Weighed(target, before, stepped, faults, moves, plan, dict(observer.missed))


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
    box = inside_frame(state[:4], frame)
    started = _charge(engine, seconds, "belief", started)

    working = applied(net, (*weighed.faults, *by_hand)).targets[target]
    working = replace(working, active=working.active - weighed.missed.keys())
    measures = measure(machine.plate, weighed.plan, stepped, float(box[2] * box[3]))
    scored, score, rival, bound = before.scored, None, None, 1.0
    if root.score is not None:
        rule = root.score.settings
        scored = scored.after(rule, measures, stepped, measures.ud_px2[machine.plate.root])
        if root.distractors is not None:
            rival = rival_seen(root.distractors, frame.index, target, live, machine.cues, stepped, measures)
            scored = with_rival(scored, rival, root.distractors.frames)
        bound = most(rule, measures.fit, scored.doubt)
        score = min(probability(rule, scored.smooth), bound)
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
        weighed.missed,
    )
    chosen, memory = decide(now, before.memory)
    started = _charge(engine, seconds, "measure", started)

    quiet = quiet_level(machine.plate, working, memory, machine.plate.root)
    rate = learning_rate(root.learn, measures.ud_px2[machine.plate.root], measures.area_px2, quiet)
    at_parts = part_rates(root.learn, measures.parts, partial(quiet_level, machine.plate, working, memory))
    seen = max(1.0 - 2.0 * hidden, 0.0)
    rate, at_parts = rate * seen, {part: own * seen for part, own in at_parts.items()}
    held = working.status == "tracking" or (working.status == "uncertain" and scored.doubt > 0)
    every = min(live.sampled.values(), default=1)
    # Between samples the others are less sure alone: what is learnt then would be their errors.
    if not held or not working.active or stepped.degenerate is not None or frame.index % every:
        rate, at_parts = 0.0, {}
    rates = {
        agent: over_frames(at_parts.get(machine.part_of.get(agent, ""), rate) * largest, every)
        for agent, largest in machine.rate_max.items()
        if agent not in working.quarantined and agent not in weighed.missed
    }
    own = {agent: inside_frame(measures.parts[part].box, frame) for agent, part in machine.part_of.items()}
    at = hypotheses_of(np.concatenate([box, state[4:]])[None], stepped.posterior.fields)
    references, watched, judged, decisions = learn(
        now, machine, before, rates, cache, at, own, chosen, engine
    )
    first, still_out = start_late(engine, now, machine, cache, box, own, references, chosen)
    references, decisions = {**references, **first}, (*decisions, *still_out)
    watched = replace(watched, slow={**watched.slow, **watch(first, machine.looks, machine.guard).slow})
    _charge(engine, seconds, "learn", started)

    ahead = weighed.predicted.after(measures.ud_px2[machine.plate.root], measures.area_px2, quiet)
    after = TargetState(
        stepped.posterior, references, memory, before.plan, frame.time, watched, ahead, scored
    )
    told = [*weighed.predicted.told, *(report(frame.index, target) for report in stepped.reports)]
    if stepped.degenerate is not None:
        told.append(DegenerateBelief(frame.index, target, stepped.degenerate))
    if rival is not None and scored.doubt > 0 and not before.scored.doubt:
        told.append(rival)
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
        None if score is None else (score, {**scored.smooth, "most": bound}),
        angle_of(at),
    )
    return Concluded(after, metrics, (*weighed.faults, *by_hand, *decisions), tuple(told), spread)


def _charge(engine: Engine, seconds: dict[str, float], name: str, started: float) -> float:
    now = engine.clock()
    seconds[name] = seconds.get(name, 0.0) + now - started
    return now
