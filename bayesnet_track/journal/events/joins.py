"""Events of joined targets: joint nodes that come and go, and the pairs that they hold."""

from __future__ import annotations

from dataclasses import dataclass

from bayesnet_track.journal.text.wording import decimals, distinct_texts, plural, round_away


@dataclass(frozen=True)
class Joined:
    """Two targets came so near that their beliefs depend on each other: a joint node is added above them.

    Attributes:
        frame: frame whose numbers caused it; they are joined from the next frame on.
        target: target id; by an attachment, the one that may carry.
        other: the other target's id.
        kinds: plates of the two.
        rule: index of the join in the graph, from 0.
        overlap: overlap of the beliefs' reaches, as a share of the smaller one.
        above: overlap from which on they are joined.
    """

    frame: int
    target: str
    other: str
    kinds: tuple[str, str]
    rule: int
    overlap: float
    above: float

    def describe(self) -> str:
        """`the beliefs of targets 1 and 2 overlap by 0.12 ≥ 0.05 → joined; ...`."""
        value, level = distinct_texts(self.overlap, self.above)
        turning = round_away(self.overlap, decimals(self.overlap, self.above), up=True)
        kinds = " and ".join(dict.fromkeys(self.kinds))
        return (
            f"the beliefs of target {self.target} and target {self.other} ({kinds}) overlap by {value} "
            f"≥ {level} → joined; would have stayed on their own at overlap > {turning}"
        )


@dataclass(frozen=True)
class Parted:
    """Two targets were apart for long enough: each keeps its marginal of the joint belief.

    Attributes:
        frame: frame whose numbers caused it; they are on their own from the next frame on.
        target: target id.
        other: the other target's id.
        overlap: overlap of the beliefs' reaches at this frame.
        below: overlap below which they count as apart.
        frames: consecutive frames in which they were.
        turning: largest overlap in these frames: with a threshold at or below it they would have stayed
            joined.
        together: frames for which they were joined.
    """

    frame: int
    target: str
    other: str
    overlap: float
    below: float
    frames: int
    turning: float
    together: int

    def describe(self) -> str:
        """`the beliefs of targets 1 and 2 overlap by 0 < 0.05 for 5 frames → parted; ...`."""
        value, level = distinct_texts(self.overlap, self.below)
        turning = round_away(self.turning, decimals(self.turning, self.below), up=False)
        stay = (
            f"overlap ≤ {turning} or apart_frames > {self.frames}"
            if float(turning)
            else f"apart_frames > {self.frames}"
        )
        return (
            f"the beliefs of target {self.target} and target {self.other} overlap by {value} < {level} "
            f"for {plural(self.frames, 'frame')} → parted, after {plural(self.together, 'frame')} together; "
            f"would have stayed joined at {stay}"
        )


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
