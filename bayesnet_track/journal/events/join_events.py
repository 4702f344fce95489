"""What is told of joined targets: who hides whom, who carries whom, and which pair is left out of a ring."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class OcclusionChanged:
    """A joined target went behind another, or came out again.

    Attributes:
        frame: the frame.
        target: target id of the one behind.
        other: the one in front.
        hidden: true when most of it is hidden from this frame on, false when most of it is seen again.
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


@dataclass(frozen=True)
class RingChanged:
    """Joins closed a ring: joint beliefs live on a tree, so the pair that overlaps least is left out of it.

    Each of the two still hears of the other, but only what that one believes by itself: their joint belief is
    an approximation until the ring opens.

    Attributes:
        frame: the frame.
        target: target id.
        other: the other target's id.
        left_out: true when the pair is left out from this frame on, false when it is in again.
        overlap: overlap of the two beliefs' reaches.
        group: all targets that hang together by joins.
    """

    frame: int
    target: str
    other: str
    left_out: bool
    overlap: float
    group: tuple[str, ...]


@dataclass(frozen=True)
class JoinMetrics:
    """What a joint belief says of one target in one frame.

    Attributes:
        others: targets that it is joined with.
        hidden: expected share of its box that is hidden by one of them.
        behind: the one that most probably hides it, or empty.
        in_front: the other -> probability that this target is in front of it.
        attached: probability that it is carried; None when nothing may carry it.
        ess_own: effective hypotheses before the joint belief.
    """

    others: tuple[str, ...]
    hidden: float
    behind: str
    in_front: Mapping[str, float]
    attached: float | None
    ess_own: float
