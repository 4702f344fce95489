"""What a joint belief says: who hides whom, who carries whom, and which pair a ring leaves out."""

from __future__ import annotations

from dataclasses import dataclass

from bayesnet_track.journal.text.wording import distinct_texts, plural


@dataclass(frozen=True)
class OcclusionChanged:
    """A joined target went behind another, or came out again.

    Attributes:
        frame: the frame.
        target: target id of the one behind.
        other: the one in front.
        hidden: true when most of it is hidden from this frame on, false when most of it is visible again.
        share: expected share of its box that is hidden.
        above: share above which it counts as hidden.
        in_front: probability that the other is in front.
        frames: for how many frames it was hidden; 0 when it goes behind.
    """

    frame: int
    target: str
    other: str
    hidden: bool
    share: float
    above: float
    in_front: float
    frames: int

    def describe(self) -> str:
        """`target 1 is in front (probability 0.97) and hides 0.62 > 0.5 of target 2 → ...`."""
        value, level = distinct_texts(self.share, self.above)
        if self.hidden:
            return (
                f"target {self.other} is in front with probability {self.in_front:.2f} and hides {value} "
                f"> {level} of target {self.target} → target {self.target} hidden, does not learn"
            )
        return (
            f"target {self.other} hides {value} ≤ {level} of target {self.target} "
            f"→ target {self.target} visible again after {plural(self.frames, 'frame')}"
        )


@dataclass(frozen=True)
class AttachmentChanged:
    """A joined target is carried by another, or no longer.

    Attributes:
        frame: the frame.
        target: target id of the one that is carried.
        other: the one that carries.
        attached: true when it is more probably carried than not from this frame on.
        probability: probability that it is carried, by all evidence so far.
        frames: for how many frames it was carried; 0 when it is picked up.
    """

    frame: int
    target: str
    other: str
    attached: bool
    probability: float
    frames: int

    def describe(self) -> str:
        """`target 2 moves as target 1 does, with probability 0.93 → carried`."""
        if self.attached:
            return (
                f"target {self.target} moves as target {self.other} does with probability "
                f"{self.probability:.2f} → carried by target {self.other}"
            )
        return (
            f"target {self.target} moves as target {self.other} does with probability "
            f"{self.probability:.2f} → no longer carried, after {plural(self.frames, 'frame')}"
        )


@dataclass(frozen=True)
class RingChanged:
    """Joins formed a ring. Joint beliefs need a tree, so the pair that overlaps least is left out.

    Each of the two still takes the other's own belief into account: their joint belief is an approximation
    until the ring opens.

    Attributes:
        frame: the frame.
        target: target id.
        other: the other target's id.
        left_out: true when the pair is left out from this frame on, false when it is included again.
        overlap: overlap of the two beliefs' reaches.
        group: all targets that are connected by joins.
    """

    frame: int
    target: str
    other: str
    left_out: bool
    overlap: float
    group: tuple[str, ...]

    def describe(self) -> str:
        """`targets 1, 2, 3 are joined in a ring → the pair 1, 3 is left out`."""
        pair = f"target {self.target} and target {self.other}"
        if not self.left_out:
            return f"no ring is closed by {pair} any more → their joint belief is of the tree again"
        group = ", ".join(self.group)
        return (
            f"targets {group} are joined in a ring → {pair}, with an overlap of {self.overlap:.2g} the "
            "least, are left out: each receives only the other's own belief"
        )


Events = OcclusionChanged | AttachmentChanged | RingChanged
