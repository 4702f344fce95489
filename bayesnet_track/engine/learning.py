"""Second half of a frame, second part: references move toward the estimates, and agents act by themselves.

An agent learns of all targets of a group at once. What guards references, tunes them, or lets an agent start
late is done for one target at a time, and only where it is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from bayesnet_track.adapt.rule_inputs import baseline_level, largest_rate, learning_rate
from bayesnet_track.adapt.status import quarantine
from bayesnet_track.belief.contract import hypotheses_of
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_context import FrameContext, inside_frame, planes_of_each
from bayesnet_track.engine.judging import JudgedGroup
from bayesnet_track.engine.starting import start_late, unmet
from bayesnet_track.graph.spec import Learn
from bayesnet_track.inference.asking import Fault, Missing, fault_of, follow
from bayesnet_track.inference.learn import (
    GuardVerdict,
    LearningInputs,
    SlowReferences,
    adapt_reference,
    blend_ahead,
    guard,
    judge,
    judge_nothing,
    watch,
)
from bayesnet_track.journal.events.switches import LocallyAdapted
from bayesnet_track.journal.net import Decision
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import ANGLE, FAULTS, Reference, context_of, over_frames
from bayesnet_track.observation.likelihoods import ReferenceRows

References = Mapping[str, Sequence[Reference]]
"""Agent -> its reference of each target."""


@dataclass(frozen=True, eq=False)
class Beside:
    """Outcome of learning for one target besides the references that moved.

    Attributes:
        references: agent -> what it remembers.
        watched: the slow references that guard the others against drift.
        judged: what these say.
        decisions: those that stand, in order.
    """

    references: Mapping[str, Reference]
    watched: SlowReferences
    judged: GuardVerdict
    decisions: tuple[Decision, ...]


@dataclass(frozen=True, eq=False)
class LearntGroup:
    """Outcome of learning for T targets.

    Attributes:
        references: agent -> its reference of each.
        rates: of each the share of the largest learning rate.
        beside: row -> what was done besides.
        angles: (T,) rotations of the estimates, degrees; None for a motion without them.
    """

    references: References
    rates: Sequence[float]
    beside: Mapping[int, Beside] = field(default_factory=dict)
    angles: Floats | None = None

    def angle(self, row: int) -> float:
        """The rotation of one estimate, degrees."""
        return 0.0 if self.angles is None else float(self.angles[row])


def learn_group(work: FrameContext, group: JudgedGroup) -> LearntGroup:
    """References move toward the estimates; agents that gave none at the start learn theirs."""
    filtered, compiled = group.filtered, group.filtered.compiled
    shares, rates = learning_rates(work, group)
    is_learning = any(map(any, rates.values()))
    fields = filtered.fields
    angles = group.states[:, fields.index(ANGLE)] if ANGLE in fields else None
    news = _meeting(work, group) if compiled.looking and not filtered.keeps_status else ()
    if not is_learning and not news and (filtered.keeps_status or not group.chosen):
        return LearntGroup(filtered.references, shares, angles=angles)
    lesson, checks, free = partial(_lesson, work, group), dict[int, GuardVerdict](), rates
    if is_learning and compiled.guard is not None:
        free = {agent: [*values] for agent, values in rates.items()}
        for row in range(len(shares)):
            own_rates = {agent: values[row] for agent, values in rates.items()}
            if any(own_rates.values()):
                own_references = {agent: values[row] for agent, values in filtered.references.items()}
                checks[row] = judge(
                    lesson(row), filtered.state(row).watched, own_references, own_rates, compiled.guard
                )
            for agent in checks[row].held & free.keys() if row in checks else ():
                free[agent][row] = 0.0
    references, faults = move_references(work, group, lesson, free, angles)
    beside = {}
    for row in sorted({*group.chosen, *faults, *checks, *news}):
        judged = checks.get(row) or judge_nothing(filtered.state(row).watched)
        own_learnt = {agent: values[row] for agent, values in references.items()}
        own_rates = {agent: values[row] for agent, values in rates.items()}
        beside[row] = _learn_beside(
            group, row, lesson(row), judged, (own_learnt, own_rates, faults.get(row, {}))
        )
    return LearntGroup(references, shares, beside, angles)


def _lesson(work: FrameContext, group: JudgedGroup, row: int) -> LearningInputs:
    """Inputs from which the agents of one target learn."""
    filtered, compiled = group.filtered, group.filtered.compiled
    state = np.concatenate([group.boxes[row], group.states[row, 4:]])[None]
    parts = group.measures.of(row).parts if compiled.part_of else {}
    boxes = {agent: inside_frame(parts[part].box, work.frame) for agent, part in compiled.part_of.items()}
    for agent in compiled.looking:
        boxes[agent] = compiled.boxes_of(agent, group.states[row : row + 1], work.frame)[0]
    hypotheses, cameras = hypotheses_of(state, filtered.fields), compiled.looking
    return LearningInputs(
        compiled.cues, work.cache, hypotheses, boxes, work.availability, filtered.ids[row], cameras
    )


def _meeting(work: FrameContext, group: JudgedGroup) -> list[int]:
    """The targets that one of several cameras sees for the first time."""
    looking, references = group.filtered.compiled.looking, group.filtered.references
    if looking.keys() <= references.keys():
        return []
    tracked = [row for row, net in enumerate(group.nets) if net.status == "tracking"]
    return [row for row in tracked if unmet(_lesson(work, group, row), group.nets[row], references)]


# ------------------------------------------------------------------------------------ rates


def learning_rates(work: FrameContext, group: JudgedGroup) -> tuple[list[float], dict[str, list[float]]]:
    """Of each target the share of the largest rate that its belief allows, and agent -> the rate of each.

    The less of the target is visible the less is learnt, and nothing when half of it is hidden, since the box
    shows what hides it.
    """
    filtered, compiled, measures = group.filtered, group.filtered.compiled, group.measures
    plate, count, all_beside = compiled.plate, len(group.nets), filtered.beside
    rule = plate.inference(plate.root).learn
    if rule is None:
        return [0.0] * count, {}
    shares, rates = [], {agent: [0.0] * count for agent in compiled.rate_max}
    columns = zip(
        measures.uds[plate.root].tolist(),
        measures.areas.tolist(),
        group.baselines_px2,
        filtered.hidden,
        strict=True,
    )
    for row, (ud_px2, area_px2, baseline_px2, hidden) in enumerate(columns):
        beside = None if all_beside is None else all_beside[row]
        visible = max(1.0 - 2.0 * hidden, 0.0)
        share, of_parts = learning_rate(rule, ud_px2, area_px2, baseline_px2) * visible, dict[str, float]()
        if measures.part_areas:
            of_parts = _part_rates(group, row, rule, visible)
        interval, rests = _rhythm(work, group, row, rule, beside)
        if rests or not _is_held(group, row, rule) or (beside is not None and beside.step.degenerate):
            share, of_parts = 0.0, {}
        shares.append(share)
        if share <= 0.0 and not any(of_parts.values()):
            continue
        age = work.frame.since(filtered.state(row).started) if rule.early_rate else 0
        net = group.nets[row]
        for agent, largest in compiled.rate_max.items():
            if agent not in net.quarantined and (beside is None or agent not in beside.missed):
                rate = of_parts.get(compiled.part_of.get(agent, ""), share) * largest_rate(rule, largest, age)
                rates[agent][row] = over_frames(rate, interval)
    return shares, rates


def _part_rates(group: JudgedGroup, row: int, rule: Learn, visible: float) -> dict[str, float]:
    """Part -> share of the largest rate: the root's rule at the UD of the part, 0 unless it is seen."""
    plate, net = group.filtered.compiled.plate, group.nets[row]
    baseline_of = partial(baseline_level, plate, net.active, group.memory.take([row]))
    return {
        name: visible * learning_rate(rule, part.ud_px2, part.area_px2, baseline_of(name))
        if part.status == "seen"
        else 0.0
        for name, part in group.measures.of(row).parts.items()
    }


def _is_held(group: JudgedGroup, row: int, rule: Learn) -> bool:
    """True where the box shows the target, as far as status and score say."""
    net, outcome = group.nets[row], group.score(row)
    likely = outcome.score is not None and rule.score_above is not None and outcome.score > rule.score_above
    is_held = net.status == "tracking" or (net.status == "uncertain" and (likely or outcome.scored.doubt > 0))
    return is_held and outcome.scored.missing is None and len(net.active) > 0


def _rhythm(
    work: FrameContext, group: JudgedGroup, row: int, rule: Learn, beside: Filtered | None
) -> tuple[int, bool]:
    """In one of how many frames a target's agents learn, and whether they rest in this one."""
    live = work.net.targets[group.filtered.ids[row]]
    interval = _frames_between(rule, live.sampled)
    if beside is None or beside.call is None or live.turn is None:
        return interval, interval > 1 and work.frame.ordinal % interval > 0
    return live.turn.since(work.frame.index, work.frame.stride), not beside.call.ran


# ------------------------------------------------------------------------------------ references


def move_references(
    work: FrameContext,
    group: JudgedGroup,
    lesson: Callable[[int], LearningInputs],
    rates: Mapping[str, Sequence[float]],
    angles: Floats | None,
) -> tuple[References, dict[int, dict[str, str]]]:
    """The references of all agents, active or not, each moved by its rate toward what its box holds now.

    Planes are computed on the estimate and as much around it as the agent asks for, unless the hypotheses'
    own region holds that. An agent that fails keeps its reference; the second mapping says of each row what
    was wrong. An agent that gives no answer for a reason outside of it keeps
    its reference, too; the frame's availability has it.
    """
    filtered, elsewhere = group.filtered, group.filtered.compiled.elsewhere
    references, outcomes = dict(filtered.references), dict[str, dict[int, Fault]]()
    learning = {
        agent: _rows(work, group, agent, agent_rates)
        for agent, agent_rates in rates.items()
        if agent in references
    }
    waits = {
        (agent, row): blend_ahead(lesson(row), agent, references[agent][row], rates[agent][row])
        for agent, rows in learning.items()
        for row in (rows if agent in elsewhere else ())
    }
    for agent, rows in learning.items():
        if len(rows) and agent not in elsewhere:
            row_rates, previous = np.array(rates[agent])[rows], references[agent]
            if len(rows) < len(previous):
                previous = ReferenceRows.some(previous, rows)
            learnt, outcomes[agent] = _follow(work, group, agent, rows, (previous, row_rates, angles))
            references[agent] = _replaced(references[agent], rows, learnt)
    for (agent, row), wait in waits.items():
        answer = wait()
        if isinstance(answer, str | Missing):
            outcomes.setdefault(agent, {})[row] = answer
        else:
            references[agent] = _replaced(references[agent], np.array([row]), [answer])
    faults: dict[int, dict[str, str]] = {}
    for agent in rates:
        for row, fault in outcomes.get(agent, {}).items():
            if isinstance(fault, str):
                faults.setdefault(row, {})[agent] = fault
            else:
                work.availability.note(filtered.ids[row], agent, "learning", fault.reason)
    return references, faults


def _rows(work: FrameContext, group: JudgedGroup, agent: str, rates: Sequence[float]) -> Ints:
    """The targets of which an agent learns."""
    ids, availability = group.filtered.ids, work.availability
    rows = [row for row, rate in enumerate(rates) if rate > 0.0]
    if agent in group.filtered.compiled.looking:
        rows = [row for row in rows if _lesson(work, group, row).sees(agent)]
    if availability.known:
        rows = [row for row in rows if availability.misses(ids[row], agent, "learning") is None]
    return np.array(rows, dtype=np.intp)


def _follow(
    work: FrameContext,
    group: JudgedGroup,
    agent: str,
    rows: Ints,
    inputs: tuple[Sequence[Reference], Floats, Floats | None],
) -> tuple[Sequence[Reference], dict[int, Fault]]:
    """References of some rows after learning, and row -> what was wrong.

    `inputs` are the references and rates of these rows, and the rotations of all targets.
    """
    compiled = group.filtered.compiled
    cue, part, (references, rates, angles) = compiled.cues[agent], compiled.part_of.get(agent), inputs
    boxes = group.boxes[rows]
    if part is not None:
        places = [group.measures.of(row).parts[part].box for row in rows.tolist()]
        boxes = np.array([inside_frame(box, work.frame) for box in places])
    elif agent in compiled.looking:
        boxes = compiled.boxes_of(agent, group.states[rows], work.frame)
        cache = work.cache.of_camera(compiled.looking[agent])
        assert cache is not None  # else its rows were left out
        work = evolve(work, cache=cache)
    try:
        starts, share = np.arange(len(boxes) + 1), hasattr(cue, "follow_each")
        planes = planes_of_each(work, cue.needs, boxes, starts, context_of(cue), share)
    except FAULTS as error:
        if len(rows) == 1:
            return references, {int(rows[0]): fault_of(error, " while learning")}
        learnt_each: list[Reference] = []
        faults: dict[int, Fault] = {}
        for t in range(len(rows)):  # of which target it is shows where each learns by itself
            learnt_one, fault = _follow(
                work, group, agent, rows[t : t + 1], ([references[t]], rates[t : t + 1], angles)
            )
            learnt_each, faults = [*learnt_each, *learnt_one], faults | fault
        return learnt_each, faults
    turned = None if angles is None else angles[rows]
    learnt, failed = follow(cue, planes, boxes, references, rates, turned)
    return learnt, {int(rows[t]): fault for t, fault in failed.items()}


def _replaced(
    references: Sequence[Reference], rows: Ints, replacements: Sequence[Reference]
) -> Sequence[Reference]:
    """References with those of some rows replaced."""
    if len(rows) == len(references):
        return replacements
    if isinstance(references, ReferenceRows) and isinstance(replacements, ReferenceRows):
        together = references.replaced(rows, replacements)
        if together is not None:
            return together
    replaced = list(references)
    for row, reference in zip(rows.tolist(), replacements, strict=True):
        replaced[row] = reference
    return replaced


# ------------------------------------------------------------------------------------ one target


def _learn_beside(
    group: JudgedGroup,
    row: int,
    lesson: LearningInputs,
    judged: GuardVerdict,
    learnt: tuple[Mapping[str, Reference], Mapping[str, float], Mapping[str, str]],
) -> Beside:
    """Guard the references of one target, carry out local actions, and let agents start late.

    `learnt` are its references, the rates, and agent -> what was wrong. The decisions that stand are those
    chosen, without actions that found nothing left to try, and the quarantine of agents that failed here.
    """
    references_learnt, rates, faults = learnt
    compiled, previous = group.filtered.compiled, group.filtered.state(row)
    view, decisions = group.see(row), group.chosen.get(row, ())
    references, watched, failed = guard(
        lesson, previous.watched, judged, references_learnt, rates, compiled.guard
    )
    faults = {**faults, **failed}
    standing: list[Decision] = []
    for decision in decisions:
        if isinstance(decision, LocallyAdapted):
            if decision.node in faults:
                continue
            tuned = adapt_reference(lesson, decision.node, references[decision.node], decision.attempt)
            if isinstance(tuned, str):
                faults[decision.node] = tuned
            if tuned is None or isinstance(tuned, str):
                continue
            references[decision.node] = tuned
        standing.append(decision)
    first, still_out = start_late(lesson, view, references, decisions)
    slow = {**watched.slow, **watch(first, compiled.looks, compiled.guard).slow}
    quarantined = (
        quarantine(view.net, view.frame, view.target, agent, reason) for agent, reason in faults.items()
    )
    return Beside(
        {**references, **first}, evolve(watched, slow=slow), judged, (*standing, *quarantined, *still_out)
    )


def _frames_between(rule: Learn | None, sampled: Mapping[str, int]) -> int:
    """Learning takes place in one of so many tracked frames.

    `sampled`: agent that is evaluated now and then -> in one of so many tracked frames. Between samples
    the others are less sure alone, and what is learnt then would be their errors.

    >>> from bayesnet_track.graph.spec import Learn, Level
    >>> _frames_between(Learn(below=Level(ud_px2=100.0), every=2), {"filter": 3})
    6
    """
    return math.lcm(1 if rule is None else rule.every, min(sampled.values(), default=1))
