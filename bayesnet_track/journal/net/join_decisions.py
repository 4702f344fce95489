"""The decisions that join nets of two targets and part them again: entries of the journal."""

from __future__ import annotations

from dataclasses import dataclass


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
        turning: largest overlap in these frames: with a level at or below it they would have stayed joined.
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
