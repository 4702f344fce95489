"""Sentences for what comes from outside, and for agents that fail."""

from __future__ import annotations

from bayesnet_track.graph.fault_decisions import Quarantined, Readmitted
from bayesnet_track.graph.hand_decisions import Released, Toggled
from bayesnet_track.journal.inputs import AgentMissed
from bayesnet_track.journal.wording import plural


def by_hand(event: Toggled | Released) -> str:
    """`a person switched motion off; no rule switches it until it is released`."""
    if isinstance(event, Released):
        return f"a person released {event.node} → the rules may switch it again"
    how = "on" if event.on else "off"
    return f"a person switched {event.node} → {how}; no rule switches it until it is released"


def missed(event: AgentMissed) -> str:
    """`motion gave no answer: its process died → left out of this frame`."""
    asked = "" if event.during == "observing" else f" while {event.during}"
    return f"{event.node} gave no answer{asked}: {event.reason} → left out of this frame"


def quarantined(event: Quarantined) -> str:
    """`motion failed: raised ... → out for 10 frames, tried again in frame 52`."""
    again = "" if event.times == 1 else f", the {_ordinal(event.times)} time in a row"
    failed = f"{event.node} failed{again}: {event.reason}"
    if event.until is None:
        return f"{failed} → out for the rest of the run"
    return (
        f"{failed} → out for {plural(event.until - event.frame, 'frame')}, tried again in frame {event.until}"
    )


def readmitted(event: Readmitted) -> str:
    """`motion was out for 10 frames after failing once → on again`."""
    often = "failing" if event.times == 1 else f"failing {event.times} times in a row"
    waited = f"{event.node} was out for {plural(event.waited, 'frame')} after {often}"
    return f"{waited} → {'on again' if event.on else 'may be switched on again'}"


def _ordinal(number: int) -> str:
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10 if number % 100 not in (11, 12, 13) else 0, "th")
    return f"{number}{ending}"
