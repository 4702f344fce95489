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


Events = ModeChanged


def describe(event: Events) -> str:
    """The sentence of an event, without its frame."""
    side = "higher" if event.nats >= 0 else "lower"
    turning = round_away(event.turning, decimals(event.turning, event.nats), up=False)
    hidden = "" if event.hidden is None else f"; hidden with probability {event.hidden:.2f}"
    return (
        f"the frame's evidence is {abs(event.nats):.3g} nats {side} in mode {event.mode} than in "
        f"{event.before} → target {event.target} in mode {event.mode} with probability "
        f"{event.probability:.2f}, predicted {event.predicted:.2g}{hidden}; would have stayed in "
        f"{event.before} at ≤ {turning} nats"
    )
