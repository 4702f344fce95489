"""Sentences for what comes from outside, for agents that fail, and for what is shed for want of time."""

from __future__ import annotations

import math

from bayesnet_track.journal.events.inputs import AgentMissed
from bayesnet_track.journal.net.fault_decisions import Quarantined, Readmitted
from bayesnet_track.journal.net.hand_decisions import Released, Toggled
from bayesnet_track.journal.net.load_decisions import ParticlesLimited, Shed, TakenBack
from bayesnet_track.journal.text.wording import plural, round_away


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


def shed(event: Shed) -> str:
    """`3 of the last 10 frames were late: ... → motion off; would have stayed on at a budget ≥ ...`."""
    late = f"{event.late} of the last {event.within} frames were late"
    late = f"{late}, {event.spent_ms:.3g} ms > {event.budget_ms:g}"
    others = {name: value for name, value in event.index.items() if name != event.node}
    least = f"{event.index[event.node]:.2g} nats per ms"
    if others:
        second = min(others, key=lambda name: others[name])
        least = f"{least} against {second} {others[second]:.2g}"
    turning = round_away(event.turning_ms, max(2 - math.floor(math.log10(event.turning_ms)), 0), up=True)
    return f"{late} → {event.node} off ({least}); would have stayed on at a budget ≥ {turning} ms"


def taken_back(event: TakenBack) -> str:
    """`50 frames took at most ... → motion on again`."""
    time = f"{plural(event.frames, 'frame')} took at most {event.spent_ms:.3g} ms"
    expected = f"{event.expected_ms:.3g} expected with it, of {event.budget_ms:g}"
    return f"{time}, {expected} → {event.node} on again"


def particles_limited(event: ParticlesLimited) -> str:
    """`frames took ... ms, ... allowed → at most 250 hypotheses, 500 before`."""
    most = "as many hypotheses as asked for" if event.most is None else f"at most {event.most} hypotheses"
    return f"frames took {event.spent_ms:.3g} ms of {event.budget_ms:g} → {most}, {event.before} before"


def _ordinal(number: int) -> str:
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10 if number % 100 not in (11, 12, 13) else 0, "th")
    return f"{number}{ending}"
