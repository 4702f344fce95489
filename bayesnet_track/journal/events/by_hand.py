"""What a person who watches a run asks for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import assert_never

from bayesnet_track.journal.net.target_net import TargetNet


@dataclass(frozen=True)
class Toggled:
    """An agent was switched on or off by hand. No rule switches it until it is released.

    Attributes:
        frame: frame in which this was requested; it takes effect in the next frame.
        target: target id.
        node: the agent.
        on: true when it was switched on.
    """

    frame: int
    target: str
    node: str
    on: bool


@dataclass(frozen=True)
class Released:
    """An agent was given back to the rules. It stays on or off until one of them switches it.

    Attributes:
        frame: frame in which this was requested; rules may switch it in the next frame.
        target: target id.
        node: the agent.
    """

    frame: int
    target: str
    node: str


@dataclass(frozen=True)
class InputRefused:
    """A request by hand cannot be carried out; the net stays as it is.

    Attributes:
        frame: frame in which it was made.
        target: target id.
        node: the agent.
        reason: why not.
    """

    frame: int
    target: str
    node: str
    reason: str


Decisions = Toggled | Released
Switches = Toggled
Events = Decisions | InputRefused


def describe(event: Events) -> str:
    """The sentence of an event, without its frame."""
    match event:
        case Toggled():
            how = "on" if event.on else "off"
            return f"switched by hand → {event.node} {how}; no rule switches it until it is released"
        case Released():
            return f"released by hand → the rules may switch {event.node} again"
        case InputRefused():
            return f"the request for {event.node} is refused: {event.reason}"
        case _:
            assert_never(event)


def shorten(event: Switches) -> str:
    """The switch in a word, for a summary."""
    return f"{'on' if event.on else 'off'} by hand"


def change(net: TargetNet, decision: Decisions) -> TargetNet:
    """The net of a target after a decision."""
    match decision:
        case Toggled():
            active = net.active | {decision.node} if decision.on else net.active - {decision.node}
            by_hand = {**net.by_hand, decision.node: decision.on}
            return replace(net, active=active, by_hand=by_hand, shed=net.shed_without(decision.node))
        case Released():
            held_by_hand = {agent: on for agent, on in net.by_hand.items() if agent != decision.node}
            return replace(net, by_hand=held_by_hand)
        case _:
            assert_never(decision)
