"""How long an agent that fails stays out, longer with each failure in a row: a function of the journal."""

from __future__ import annotations

from collections.abc import Mapping

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.situation import Situation
from bayesnet_track.journal.events.faults import Quarantined, Readmitted
from bayesnet_track.journal.net.net import Decision
from bayesnet_track.journal.net.target_net import Fault, TargetNet

FIRST_WAIT = 10
"""Frames for which an agent is out at its first failure."""

LONGEST_WAIT = 1280
"""Frames beyond which the time does not double any more."""

STEADY = 10
"""An agent that works so many times as long as it was out has not failed in a row."""

MISSED_FRAMES = 3
"""Frames in a row without an answer after which an agent is out for a while: others wait for it."""


def quarantine(net: TargetNet, frame: int, target: str, agent: str, reason: str) -> Quarantined:
    """The decision that an agent which failed in `frame` is out, and for how long.

    >>> first = quarantine(TargetNet("plate", frozenset("a")), 5, "1", "a", "raised")
    >>> first.until, first.times
    (15, 1)
    """
    until, times = next_try(frame, net.faults.get(agent))
    return Quarantined(frame, target, agent, reason, until, times)


def next_try(frame: int, before: Fault | None) -> tuple[int, int]:
    """When something that failed in `frame` is tried again, and how many times in a row it has failed.

    >>> next_try(15, Fault(1, 5, 15, True)), next_try(200, Fault(1, 5, 15, True))
    ((35, 2), (210, 1))
    """
    times = 1
    if before is not None and before.until is not None:
        worked, waited = frame - before.until, before.until - before.frame
        times = before.times + 1 if worked < STEADY * waited else 1
    return frame + min(FIRST_WAIT * 2 ** min(times - 1, 20), LONGEST_WAIT), times


def readmit(now: Situation) -> list[Decision]:
    """The agents whose time is over, in the order of the plate."""
    decisions: list[Decision] = []
    for agent in now.plate.agents:
        fault = now.net.faults.get(agent)
        if fault is None or agent not in now.net.quarantined or fault.until is None:
            continue
        if fault.until <= now.frame + 1:
            on = now.net.by_hand.get(agent, fault.was_on)
            waited = now.frame + 1 - fault.frame
            decisions.append(Readmitted(now.frame, now.target, agent, on, fault.times, waited))
    return decisions


def give_up_on_missing(
    now: Situation, memory: RuleMemory, decisions: list[Decision]
) -> Mapping[str, int] | None:
    """Put out agents that gave no answer for some frames in a row; how many there were of the others.

    None where all gave one, in the last frame, too.
    """
    if not now.missed and not memory.missed.any():
        return None
    columns = memory.layout.agents
    missed = {agent: int(memory.missed[0, columns[agent]]) + 1 for agent in now.missed}
    for agent, count in list(missed.items()):
        if count >= MISSED_FRAMES:
            reason = f"gave no answer in {count} frames in a row, the last time: {now.missed[agent]}"
            decisions.append(quarantine(now.net, now.frame, now.target, agent, reason))
            del missed[agent]
    return missed
