"""What a person who watches a run asks for."""

from __future__ import annotations

from dataclasses import dataclass, replace

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

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        how = "on" if self.on else "off"
        return f"switched by hand → {self.node} {how}; no rule switches it until it is released"

    def shorten(self) -> str:
        """The switch in a word, for a summary."""
        return f"{'on' if self.on else 'off'} by hand"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        active = net.active | {self.node} if self.on else net.active - {self.node}
        by_hand = {**net.by_hand, self.node: self.on}
        return replace(net, active=active, by_hand=by_hand, shed=net.shed_without(self.node))


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

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        return f"released by hand → the rules may switch {self.node} again"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        held_by_hand = {agent: on for agent, on in net.by_hand.items() if agent != self.node}
        return replace(net, by_hand=held_by_hand)


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

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        return f"the request for {self.node} is refused: {self.reason}"


Decisions = Toggled | Released
Switches = Toggled
Events = Decisions | InputRefused
