"""The last part of a target's frame: its references learn, and agents do what they do by themselves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from bayesnet_track.adapt.rule_inputs import Situation, quiet_level
from bayesnet_track.adapt.status import quarantine
from bayesnet_track.belief.contract import hypotheses_of
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.findings import Decided, Learnt, Measured
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.starting import start_late
from bayesnet_track.engine.state import TargetState, inside_frame
from bayesnet_track.inference.executor import is_elsewhere
from bayesnet_track.inference.guard import guard, judge, judge_nothing, watch
from bayesnet_track.inference.learn import (
    Lesson,
    adapt_reference,
    frames_between,
    largest_rate,
    learn_references,
    learning_rate,
    over_frames,
)
from bayesnet_track.inference.part_measures import part_rates
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.journal.events.switches import LocallyAdapted
from bayesnet_track.journal.net.net import Decision
from bayesnet_track.numerics.records import changed
from bayesnet_track.observation.cue import ANGLE

Rates = tuple[float, Mapping[str, float]]
"""The share of the largest rate that the belief allows, and agent -> its rate."""


def learn_all(
    work: FrameWork,
    filtered: Mapping[str, Filtered],
    measured: Mapping[str, Measured],
    decided: Mapping[str, Decided],
) -> dict[str, Learnt]:
    """Target -> what its agents learnt."""
    rates = {
        target: learning_rates(work, one, measured[target], decided[target])
        for target, one in filtered.items()
    }
    found: dict[str, Learnt] = {}
    for target, one in filtered.items():
        if _learns_nothing(one, decided[target], rates[target]):
            before, chosen = one.before, decided[target].chosen
            judged = judge_nothing(before.watched)
            found[target] = Learnt(before.references, before.watched, judged, chosen, 0.0, rates[target][0])
        else:
            found[target] = learn_target(work, one, measured[target], decided[target], rates[target])
    return found


def _learns_nothing(filtered: Filtered, decided: Decided, rates: Rates) -> bool:
    """Whether no reference moves and nothing else is done to one."""
    still = all(rate <= 0.0 for rate in rates[1].values())
    return still and not decided.chosen and ANGLE not in filtered.step.posterior.fields


@lru_cache(maxsize=64)
def plate_learns(compiled: CompiledPlate) -> bool:
    """Whether the references of a plate's targets do nothing but learn, by cues that are at work here."""
    return (
        compiled.guard is None
        and not compiled.part_of
        and not any(is_elsewhere(cue) for cue in compiled.cues.values())
    )


def learn_target(
    work: FrameWork, filtered: Filtered, measured: Measured, decided: Decided, rates: Rates
) -> Learnt:
    """References move toward the estimate; agents that gave none at the start learn theirs."""
    compiled, box, (rate, own_rates) = work.plate_of(filtered.target), measured.box, rates
    parts = measured.measures.parts
    lesson = Lesson(
        compiled.cues,
        work.cache,
        hypotheses_of(np.concatenate([box, measured.state[4:]])[None], filtered.step.posterior.fields),
        {agent: inside_frame(parts[part].box, work.frame) for agent, part in compiled.part_of.items()},
        work.availability,
        filtered.target,
        work.faults.get((filtered.target, "learning"), {}),
    )
    learnt = learn(lesson, compiled, filtered.before, decided, own_rates)
    first, still_out = start_late(lesson, decided.now, learnt.references, decided.chosen)
    if not first and not still_out:
        return changed(learnt, rate=rate)
    slow = {**learnt.watched.slow, **watch(first, compiled.looks, compiled.guard).slow}
    return replace(
        learnt,
        references={**learnt.references, **first},
        watched=replace(learnt.watched, slow=slow),
        decisions=(*learnt.decisions, *still_out),
        rate=rate,
    )


def learning_rates(work: FrameWork, filtered: Filtered, measured: Measured, decided: Decided) -> Rates:
    """The share of the largest rate that the belief allows, and agent -> its rate.

    The less of the target is visible the less is learnt, and nothing when half of it is hidden, since the box
    shows what hides it.
    """
    compiled, measures, net = work.plate_of(filtered.target), measured.measures, measured.net
    rule = compiled.plate.inference(compiled.plate.root).learn
    ud_px2 = measures.ud_px2[compiled.plate.root]
    rate = learning_rate(rule, ud_px2, measures.area_px2, decided.quiet_px2)
    seen = max(1.0 - 2.0 * filtered.hidden, 0.0)
    rate, at_parts = rate * seen, dict[str, float]()
    if measures.parts:
        quiet_of = partial(quiet_level, compiled.plate, net.active, decided.memory)
        at_parts = {part: own * seen for part, own in part_rates(rule, measures.parts, quiet_of).items()}
    score, least = measured.score, None if rule is None else rule.score_above
    likely = score is not None and least is not None and score > least
    held = net.status == "tracking" or (net.status == "uncertain" and (likely or measured.scored.doubt > 0))
    held = held and measured.scored.missing is None
    live = work.net.targets[filtered.target]
    every = frames_between(rule, live.sampled)
    rests = work.frame.ordinal % every > 0
    if filtered.call is not None and live.turn is not None:  # without a call none of them rests
        every, rests = live.turn.since(work.frame.index, work.frame.stride), not filtered.call.ran
    if not held or not net.active or filtered.step.degenerate is not None or rests:
        rate, at_parts = 0.0, {}
    age = work.frame.since(filtered.before.started)
    return rate, {
        agent: over_frames(
            at_parts.get(compiled.part_of.get(agent, ""), rate) * largest_rate(rule, own, age), every
        )
        for agent, own in compiled.rate_max.items()
        if agent not in net.quarantined and agent not in filtered.missed
    }


def learn(
    lesson: Lesson, compiled: CompiledPlate, before: TargetState, decided: Decided, rates: Mapping[str, float]
) -> Learnt:
    """Move all references that are guarded by none or agree with their guard, then carry out local actions.

    The decisions that stand are those chosen, without actions that found nothing left to try, and the
    quarantine of agents that failed here.
    """
    judged = judge(lesson, before.watched, before.references, rates, compiled.guard)
    free = {agent: rate for agent, rate in rates.items() if agent not in judged.held}
    moved, faults = learn_references(lesson, before.references, free)
    moved, watched, failed = guard(lesson, before.watched, judged, moved, rates, compiled.guard)
    faults |= failed
    kept: list[Decision] = []
    for decision in decided.chosen:
        if isinstance(decision, LocallyAdapted):
            if decision.node in faults:
                continue
            tuned = adapt_reference(lesson, decision.node, moved[decision.node], decision.attempt)
            if isinstance(tuned, str):
                faults[decision.node] = tuned
            if tuned is None or isinstance(tuned, str):
                continue
            moved[decision.node] = tuned
        kept.append(decision)
    return Learnt(moved, watched, judged, (*kept, *_quarantine_failed(decided.now, faults)), lesson.angle)


def _quarantine_failed(now: Situation, faults: Mapping[str, str]) -> tuple[Quarantined, ...]:
    return tuple(
        quarantine(now.net, now.frame, now.target, agent, reason) for agent, reason in faults.items()
    )
