"""The last part of a target's frame: its references learn, and agents do what they do by themselves."""

from __future__ import annotations

from collections.abc import Mapping

from bayesnet_track.adapt.backoff import quarantine
from bayesnet_track.adapt.situation import Situation
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.findings import Decided, Learnt
from bayesnet_track.engine.state import TargetState
from bayesnet_track.inference.guard import guard, judge
from bayesnet_track.inference.learn import Lesson, adapt_reference, learn_references
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.journal.events.self_checks import LocallyAdapted
from bayesnet_track.journal.net.net import Decision


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
