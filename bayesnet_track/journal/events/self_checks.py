"""Agents that are uncertain of themselves: they tune their reference, or stop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import assert_never

from bayesnet_track.journal.net.causes import Cause
from bayesnet_track.journal.net.target_net import TargetNet
from bayesnet_track.journal.text.wording import held, show_turn


@dataclass(frozen=True)
class LocallyAdapted:
    """An agent whose own likelihood was too wide sharpened it instead of stopping.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        node: the agent.
        attempt: how often it has tried in this episode, from 1.
        cause: the numbers (the agent's own UD).
    """

    frame: int
    target: str
    node: str
    attempt: int
    cause: Cause


@dataclass(frozen=True)
class SelfStopped:
    """An agent whose own likelihood stayed too wide stopped itself.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        node: the agent.
        cause: the numbers (the agent's own UD).
        rests_until: first frame at which it may be switched on again.
    """

    frame: int
    target: str
    node: str
    cause: Cause
    rests_until: int


Decisions = LocallyAdapted | SelfStopped
Switches = SelfStopped
Events = Decisions


def describe(event: Events) -> str:
    """The sentence of an event, without its frame."""
    match event:
        case LocallyAdapted():
            return f"{event.node}: its own {held(event.cause, '>')} → adapted itself, attempt {event.attempt}"
        case SelfStopped():
            return (
                f"{event.node}: its own {held(event.cause, '>')} → stopped itself; may be switched on again "
                f"from frame {event.rests_until}; would have continued at self_check ≥ "
                f"{show_turn(event.cause, up=True)}"
            )
        case _:
            assert_never(event)


def shorten(event: Switches) -> str:
    """The switch in a word, for a summary."""
    return "stopped itself"


def change(net: TargetNet, decision: Decisions) -> TargetNet:
    """The net of a target after a decision."""
    match decision:
        case LocallyAdapted():
            return net
        case SelfStopped():
            return replace(
                net,
                active=net.active - {decision.node},
                rests_until={**net.rests_until, decision.node: decision.rests_until},
                rest_count={**net.rest_count, decision.node: net.rest_count.get(decision.node, 0) + 1},
            )
        case _:
            assert_never(decision)
