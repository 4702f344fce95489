"""The last part of a target's frame: its references learn, and agents do what they do by themselves."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.backoff import quarantined
from bayesnet_track.adapt.situation import Situation
from bayesnet_track.engine.compiled import Engine, Machinery
from bayesnet_track.engine.state import TargetState
from bayesnet_track.inference.guard import Judged, Watched, guard, judge
from bayesnet_track.inference.learn import adapt_reference, learn_references
from bayesnet_track.journal.net.net import Decision, LocallyAdapted, Quarantined
from bayesnet_track.observation.cue import ANGLE, Hypotheses, LocallyAdaptable, Reference
from bayesnet_track.observation.planes import PlaneCache

Floats = NDArray[np.float64]

DURING = ("guarding", "learning", "blending", "adapting")
"""What an agent may be asked for here, each of which it may fail to answer."""


def learn(
    now: Situation,
    machine: Machinery,
    before: TargetState,
    rates: Mapping[str, float],
    cache: PlaneCache,
    at: Hypotheses,
    own: Mapping[str, Floats],
    chosen: tuple[Decision, ...],
    engine: Engine,
) -> tuple[dict[str, Reference], Watched, Judged, tuple[Decision, ...]]:
    """Move all references that are guarded by none or agree with their guard, then carry out local actions.

    Agents in `own` look at a part, whose box (4,) it holds, the others at the estimate `at`.

    Returns:
        The references, their guard and what it said, and the decisions that stand: those chosen, without
        actions that found nothing left to try, and the quarantine of agents that failed here.
    """
    rolls = {what: engine.absent.roll(now.target, what) for what in DURING}
    judged = judge(
        before.watched,
        before.references,
        machine.cues,
        rates,
        cache,
        at,
        machine.guard,
        own,
        rolls["guarding"],
    )
    free = {agent: rate for agent, rate in rates.items() if agent not in judged.held}
    moved, faults = learn_references(
        before.references,
        machine.cues,
        free,
        cache,
        at.boxes[0],
        own,
        angle_of(at),
        engine.executor,
        rolls["learning"],
    )
    moved, watched, failed = guard(
        before.watched, judged, moved, machine.cues, rates, machine.guard, rolls["blending"]
    )
    faults |= failed
    kept: list[Decision] = []
    for decision in chosen:
        if isinstance(decision, LocallyAdapted):
            cue = machine.cues[decision.node]
            assert isinstance(cue, LocallyAdaptable)
            if decision.node in faults:
                continue
            tuned = adapt_reference(
                cue, moved[decision.node], decision.attempt, decision.node, rolls["adapting"]
            )
            if isinstance(tuned, str):
                faults[decision.node] = tuned
            if tuned is None or isinstance(tuned, str):
                continue
            moved[decision.node] = tuned
        kept.append(decision)
    return moved, watched, judged, (*kept, *_failed(now, faults))


def angle_of(at: Hypotheses) -> float:
    """The estimate's rotation, degrees; 0 for a motion without one."""
    return float(at.fields[ANGLE][0]) if ANGLE in at.fields else 0.0


def _failed(now: Situation, faults: Mapping[str, str]) -> tuple[Quarantined, ...]:
    return tuple(
        quarantined(now.net, now.frame, now.target, agent, reason) for agent, reason in faults.items()
    )
