"""Targets that are joined and parted: a joint node is added above them, or goes."""

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


Decisions = Joined | Parted
