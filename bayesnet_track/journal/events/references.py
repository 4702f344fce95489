"""An agent's reference that parts from its slow one: it stops learning, or goes on."""

from __future__ import annotations

from dataclasses import dataclass

from bayesnet_track.journal.text.wording import decimals, distinct_texts, plural, round_away


@dataclass(frozen=True)
class ReferenceGuarded:
    """An agent's reference and its slow one diverged, or agree again: learning stopped, or goes on.

    Attributes:
        frame: the frame.
        target: target id.
        node: the agent.
        parted: true when they diverged in this frame, false when they agree again.
        own: log-likelihood of the estimate by the agent's own reference, nats.
        slow: the same by its slow reference.
        apart_nats: difference from which on they count as diverged.
        pull: share of the slow reference that is mixed into the agent's own per frame while they differ.
        frames: for how many learning frames they had diverged; 0 when they diverge.
    """

    frame: int
    target: str
    node: str
    parted: bool
    own: float
    slow: float
    apart_nats: float
    pull: float
    frames: int

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        gap, level = distinct_texts(self.own - self.slow, self.apart_nats)
        own, slow = f"{self.own:.2f} nats by its reference", f"{self.slow:.2f} by its slow one"
        scored = f"{self.node}: the estimate scores {own}, {slow}"
        if not self.parted:
            lasted = plural(self.frames, "frame")
            return f"{scored}: {gap} ≤ {level} apart after {lasted} → learns again"
        turning = round_away(self.own - self.slow, decimals(self.own - self.slow, self.apart_nats), up=True)
        return (
            f"{scored}: {gap} > {level} apart → stops learning, pulled back by {self.pull:g} a frame; "
            f"would have learnt at apart_nats ≥ {turning}"
        )


Events = ReferenceGuarded
