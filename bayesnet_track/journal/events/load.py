"""What is done without so that a run keeps its time, and what is taken back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import assert_never

from bayesnet_track.journal.net.target_net import TargetNet
from bayesnet_track.journal.text.wording import plural, round_away


@dataclass(frozen=True)
class Shed:
    """Frames were late: the agent with the least information per millisecond is switched off for a time.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        node: the agent.
        spent_ms: median of what the late frames took.
        budget_ms: what a frame may take.
        late: how many of the last frames were late.
        within: how many frames those were.
        turning_ms: the budget at which it would have stayed on, because few enough frames would have been
            late.
        index: agent -> mean contribution per declared cost, nats per ms, for every agent of this target that
            could be switched off.
    """

    frame: int
    target: str
    node: str
    spent_ms: float
    budget_ms: float
    late: int
    within: int
    turning_ms: float
    index: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class TakenBack:
    """Frames are in time again: an agent that was switched off to save time is switched on.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        node: the agent.
        spent_ms: the longest that one of the frames in time took.
        expected_ms: the same with the agent, by declared costs.
        budget_ms: what a frame may take.
        frames: how many frames in a row were in time.
    """

    frame: int
    target: str
    node: str
    spent_ms: float
    expected_ms: float
    budget_ms: float
    frames: int


@dataclass(frozen=True)
class ParticlesLimited:
    """Frames were late and no agent could be switched off: fewer hypotheses. Or there is time for more.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        most: largest number of hypotheses from now on; null when there is no limit any more.
        before: how many there were.
        spent_ms: what frames took: the median of the late ones, or the longest of those in time.
        budget_ms: what a frame may take.
    """

    frame: int
    target: str
    most: int | None
    before: int
    spent_ms: float
    budget_ms: float


@dataclass(frozen=True)
class LateFrame:
    """The frame before this one took longer than its budget.

    Attributes:
        frame: the frame in which rules respond to it.
        spent_ms: wall-clock milliseconds that the frame before took.
        budget_ms: milliseconds that it had.
    """

    frame: int
    spent_ms: float
    budget_ms: float


@dataclass(frozen=True)
class SpareTime:
    """The frames before this one were in time, while something is switched off to save time.

    Attributes:
        frame: the frame in which rules respond to it.
        spent_ms: the longest that one of them took, in wall-clock milliseconds.
        budget_ms: milliseconds that each had.
        frames: how many they were.
    """

    frame: int
    spent_ms: float
    budget_ms: float
    frames: int


Decisions = Shed | TakenBack | ParticlesLimited
Switches = Shed | TakenBack
Events = Decisions


def describe(event: Events) -> str:
    """The sentence of an event, without its frame."""
    match event:
        case Shed():
            return _describe_shed(event)
        case TakenBack():
            return _describe_taken_back(event)
        case ParticlesLimited():
            return _describe_limit(event)
        case _:
            assert_never(event)


def shorten(event: Switches) -> str:
    """The switch in a word, for a summary."""
    return "off for want of time" if isinstance(event, Shed) else "on again"


def change(net: TargetNet, decision: Decisions) -> TargetNet:
    """The net of a target after a decision."""
    match decision:
        case Shed():
            shed = (*net.shed_without(decision.node), decision.node)
            return replace(net, active=net.active - {decision.node}, shed=shed)
        case TakenBack():
            return replace(net, active=net.active | {decision.node}, shed=net.shed_without(decision.node))
        case ParticlesLimited():
            return replace(net, most_particles=decision.most)
        case _:
            assert_never(decision)


def _describe_shed(event: Shed) -> str:
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


def _describe_taken_back(event: TakenBack) -> str:
    """`50 frames took at most ... → motion on again`."""
    time = f"{plural(event.frames, 'frame')} took at most {event.spent_ms:.3g} of {event.budget_ms:g} ms"
    expected = f"with {event.node} {event.expected_ms:.3g} ms are expected"
    return f"{time}, {expected} → {event.node} on again"


def _describe_limit(event: ParticlesLimited) -> str:
    """`frames took ... ms, ... allowed → at most 250 hypotheses, 500 before`."""
    most = "as many hypotheses as asked for" if event.most is None else f"at most {event.most} hypotheses"
    return f"frames took {event.spent_ms:.3g} of {event.budget_ms:g} ms → {most}, {event.before} before"
