"""Agents that are uncertain of themselves: they tune their reference, or stop."""

from __future__ import annotations

from dataclasses import dataclass, replace

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

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        return f"{self.node}: its own {held(self.cause, '>')} → adapted itself, attempt {self.attempt}"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        return net


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

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        return (
            f"{self.node}: its own {held(self.cause, '>')} → stopped itself; may be switched on again "
            f"from frame {self.rests_until}; would have continued at self_check ≥ "
            f"{show_turn(self.cause, up=True)}"
        )

    def shorten(self) -> str:
        """The switch in a word, for a summary."""
        return "stopped itself"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        return replace(
            net,
            active=net.active - {self.node},
            rests_until={**net.rests_until, self.node: self.rests_until},
            rest_count={**net.rest_count, self.node: net.rest_count.get(self.node, 0) + 1},
        )


Decisions = LocallyAdapted | SelfStopped
Switches = SelfStopped
