"""Events of identities: who may be whom since targets came close."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class IdentityDoubtful:
    """Targets came close and parted, and one of them may be another one.

    Attributes:
        frame: frame in which they had been apart for long enough.
        target: target id.
        other: whose identity it may have.
        since: frame in which they came close.
        probability: that it is the other one.
        keeps: that it is itself.
        appearance: what looks told for the identities as they are, against the other ones, nats.
        motion: the same of places and velocities.
        mutual: whether the two would have swapped; else the other one is not there any more.
        refused: others that were close, too, and were not asked about.
    """

    frame: int
    target: str
    other: str
    since: int
    probability: float
    keeps: float
    appearance: float
    motion: float
    mutual: bool = True
    refused: tuple[str, ...] = field(default=(), metadata={"left_out_when_empty": True})

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        by = f"decided by appearance {self.appearance:+.1f}, motion {self.motion:+.1f} nats"
        if self.mutual:
            text = (
                f"identities {self.target} and {self.other} could be swapped since frame {self.since}, "
                f"probability {self.probability:.2f}; {by}"
            )
        else:
            text = (
                f"target {self.target} could be {self.other} since frame {self.since}, "
                f"probability {self.probability:.2f}; {by}"
            )
        if self.refused:
            text += f"; also close, and not asked about: {', '.join(self.refused)}"
        return text
