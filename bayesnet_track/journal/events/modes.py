"""Which hidden discrete state a target is in, as far as its belief says."""

from __future__ import annotations

from dataclasses import dataclass

from bayesnet_track.journal.text.wording import decimals, round_away


@dataclass(frozen=True)
class ModeChanged:
    """Another mode is the most probable one.

    Attributes:
        frame: the frame.
        target: target id.
        mode: the mode that is most probable from this frame on.
        before: the one that was.
        probability: of `mode`, by all evidence so far.
        predicted: of `mode` before the evidence of this frame.
        nats: log of how much likelier the frame's evidence is in `mode` than in `before`.
        turning: nats up to which `before` would have stayed more probable.
        hidden: probability that the target cannot be seen; None where it always can.
    """

    frame: int
    target: str
    mode: str
    before: str
    probability: float
    predicted: float
    nats: float
    turning: float
    hidden: float | None = None

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        side = "higher" if self.nats >= 0 else "lower"
        turning = round_away(self.turning, decimals(self.turning, self.nats), up=False)
        hidden = "" if self.hidden is None else f"; hidden with probability {self.hidden:.2f}"
        return (
            f"the frame's evidence is {abs(self.nats):.3g} nats {side} in mode {self.mode} than in "
            f"{self.before} → target {self.target} in mode {self.mode} with probability "
            f"{self.probability:.2f}, predicted {self.predicted:.2g}{hidden}; would have stayed in "
            f"{self.before} at ≤ {turning} nats"
        )


Events = ModeChanged
