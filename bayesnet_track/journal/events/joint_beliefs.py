"""What a joint belief says: who hides whom, who carries whom, and which pair a ring leaves out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import assert_never

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


Events = OcclusionChanged | AttachmentChanged | RingChanged


def describe(event: Events) -> str:
    """The sentence of an event, without its frame."""
    match event:
        case OcclusionChanged():
            return _describe_occlusion(event)
        case AttachmentChanged():
            return _describe_attachment(event)
        case RingChanged():
            return _describe_ring(event)
        case _:
            assert_never(event)


def _describe_occlusion(event: OcclusionChanged) -> str:
    """`target 1 is in front (probability 0.97) and hides 0.62 > 0.5 of target 2 → ...`."""
    value, level = distinct_texts(event.share, event.above)
    if event.hidden:
        return (
            f"target {event.other} is in front with probability {event.in_front:.2f} and hides {value} "
            f"> {level} of target {event.target} → target {event.target} hidden, does not learn"
        )
    return (
        f"target {event.other} hides {value} ≤ {level} of target {event.target} "
        f"→ target {event.target} visible again after {plural(event.frames, 'frame')}"
    )


def _describe_attachment(event: AttachmentChanged) -> str:
    """`target 2 moves as target 1 does, with probability 0.93 → carried`."""
    if event.attached:
        return (
            f"target {event.target} moves as target {event.other} does with probability "
            f"{event.probability:.2f} → carried by target {event.other}"
        )
    return (
        f"target {event.target} moves as target {event.other} does with probability "
        f"{event.probability:.2f} → no longer carried, after {plural(event.frames, 'frame')}"
    )


def _describe_ring(event: RingChanged) -> str:
    """`targets 1, 2, 3 are joined in a ring → the pair 1, 3 is left out`."""
    pair = f"target {event.target} and target {event.other}"
    if not event.left_out:
        return f"no ring is closed by {pair} any more → their joint belief is of the tree again"
    group = ", ".join(event.group)
    return (
        f"targets {group} are joined in a ring → {pair}, with an overlap of {event.overlap:.2g} the least, "
        "are left out: each receives only the other's own belief"
    )
