"""Agents that fail or give no answer: left out, and tried again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import assert_never

from bayesnet_track.journal.net.target_net import Fault, TargetNet
from bayesnet_track.journal.text.wording import plural


@dataclass(frozen=True)
class Quarantined:
    """An agent failed: it is paused, and tried again after a time that doubles with each failure in a row.

    Attributes:
        frame: frame at which it failed (its evidence is not used in this frame either).
        target: target id.
        node: the agent.
        reason: what it returned or raised.
        until: first frame in which it may work again; null when it stays off for the rest of the run, because
            it could not learn its first reference or needs colour and the source is gray.
        times: how many times in a row it has failed, this one included; the count starts again once the agent
            has worked ten times as long as it was paused.
    """

    frame: int
    target: str
    node: str
    reason: str
    until: int | None = None
    times: int = 1


@dataclass(frozen=True)
class Readmitted:
    """An agent that failed is tried again.

    Attributes:
        frame: frame at which its pause ended; it works from the next frame on.
        target: target id.
        node: the agent.
        on: whether it is switched on: because it was on when it failed, or by hand.
        times: how many times in a row it had failed.
        waited: for how many frames it was paused.
    """

    frame: int
    target: str
    node: str
    on: bool
    times: int
    waited: int


@dataclass(frozen=True)
class AgentMissed:
    """An agent gave no answer, through no fault of its own: its process died or hung, or the answer was late.

    It is left out of this frame as if it were switched off; the other agents are not affected.

    Attributes:
        frame: the frame.
        target: target id.
        node: the agent.
        reason: what happened to it.
        during: the request that got no answer and is left out: observing (and then all that follows in the
            frame), guarding, learning, blending or adapting its reference, starting a target, joining,
            claiming or recalling.
    """

    frame: int
    target: str
    node: str
    reason: str
    during: str = "observing"


Decisions = Quarantined | Readmitted
Switches = Decisions
Events = Decisions | AgentMissed


def describe(event: Events) -> str:
    """The sentence of an event, without its frame."""
    match event:
        case Quarantined():
            return _describe_quarantine(event)
        case Readmitted():
            return _describe_readmission(event)
        case AgentMissed():
            return _describe_miss(event)
        case _:
            assert_never(event)


def shorten(event: Switches) -> str:
    """The switch in a word, for a summary."""
    if isinstance(event, Quarantined):
        return "failed"
    return "on again" if event.on else "let in again"


def change(net: TargetNet, decision: Decisions) -> TargetNet:
    """The net of a target after a decision."""
    match decision:
        case Quarantined():
            fault = Fault(decision.times, decision.frame, decision.until, decision.node in net.active)
            return replace(
                net,
                active=net.active - {decision.node},
                quarantined=net.quarantined | {decision.node},
                faults={**net.faults, decision.node: fault},
            )
        case Readmitted():
            return replace(
                net,
                active=net.active | {decision.node} if decision.on else net.active,
                quarantined=net.quarantined - {decision.node},
            )
        case _:
            assert_never(decision)


def _describe_quarantine(event: Quarantined) -> str:
    """`motion failed: raised ... → paused for 10 frames, tried again in frame 52`."""
    again = "" if event.times == 1 else f", the {_ordinal(event.times)} time in a row"
    failed = f"{event.node} failed{again}: {event.reason}"
    if event.until is None:
        return f"{failed} → off for the rest of the run"
    return (
        f"{failed} → paused for {plural(event.until - event.frame, 'frame')}, tried again in frame"
        f" {event.until}"
    )


def _describe_readmission(event: Readmitted) -> str:
    """`motion was paused for 10 frames after failing once → on again`."""
    often = "failing" if event.times == 1 else f"failing {event.times} times in a row"
    waited = f"{event.node} was paused for {plural(event.waited, 'frame')} after {often}"
    return f"{waited} → {'on again' if event.on else 'may be switched on again'}"


def _describe_miss(event: AgentMissed) -> str:
    """`motion gave no answer: its process died → left out of this frame`."""
    asked = "" if event.during == "observing" else f" while {event.during}"
    return f"{event.node} gave no answer{asked}: {event.reason} → left out of this frame"


def _ordinal(number: int) -> str:
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10 if number % 100 not in (11, 12, 13) else 0, "th")
    return f"{number}{ending}"
