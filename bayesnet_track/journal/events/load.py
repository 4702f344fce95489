"""Events of load and of people who watch: agents shed and restored, and requests by hand."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from bayesnet_track.journal.target_net import TargetNet
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

    def describe(self) -> str:
        """`3 of the last 10 frames were late: ... → motion off; would have stayed on at a budget ≥ ...`."""
        late = f"{self.late} of the last {self.within} frames were late"
        late = f"{late}, {self.spent_ms:.3g} ms > {self.budget_ms:g}"
        rivals = {name: value for name, value in self.index.items() if name != self.node}
        reason = f"{self.index[self.node]:.2g} nats per ms"
        if rivals:
            second = min(rivals, key=lambda name: rivals[name])
            reason = f"{reason} against {second} {rivals[second]:.2g}"
        turning = round_away(self.turning_ms, max(2 - math.floor(math.log10(self.turning_ms)), 0), up=True)
        return f"{late} → {self.node} off ({reason}); would have stayed on at a budget ≥ {turning} ms"

    def shorten(self) -> str:
        """The switch in a word, for a summary."""
        return "off for want of time"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        shed = (*net.shed_without(self.node), self.node)
        return replace(net, active=net.active - {self.node}, shed=shed)


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

    def describe(self) -> str:
        """`50 frames took at most ... → motion on again`."""
        time = f"{plural(self.frames, 'frame')} took at most {self.spent_ms:.3g} of {self.budget_ms:g} ms"
        expected = f"with {self.node} {self.expected_ms:.3g} ms are expected"
        return f"{time}, {expected} → {self.node} on again"

    def shorten(self) -> str:
        """The switch in a word, for a summary."""
        return "on again"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        return replace(net, active=net.active | {self.node}, shed=net.shed_without(self.node))


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

    def describe(self) -> str:
        """`frames took ... ms, ... allowed → at most 250 hypotheses, 500 before`."""
        limit = "as many hypotheses as asked for" if self.most is None else f"at most {self.most} hypotheses"
        return f"frames took {self.spent_ms:.3g} of {self.budget_ms:g} ms → {limit}, {self.before} before"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        return replace(net, most_particles=self.most)


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
        held_by_hand = {agent: is_on for agent, is_on in net.by_hand.items() if agent != self.node}
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
