"""Targets that are joined and parted: a joint node is added above them, or goes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import assert_never

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


Decisions = Joined | Parted
Events = Decisions


def describe(event: Events) -> str:
    """The sentence of an event, without its frame."""
    match event:
        case Joined():
            return _describe_joined(event)
        case Parted():
            return _describe_parted(event)
        case _:
            assert_never(event)


def _describe_joined(event: Joined) -> str:
    """`the beliefs of targets 1 and 2 overlap by 0.12 ≥ 0.05 → joined; ...`."""
    value, level = distinct_texts(event.overlap, event.above)
    turning = round_away(event.overlap, decimals(event.overlap, event.above), up=True)
    kinds = " and ".join(dict.fromkeys(event.kinds))
    return (
        f"the beliefs of target {event.target} and target {event.other} ({kinds}) overlap by {value} "
        f"≥ {level} → joined; would have stayed on their own at overlap > {turning}"
    )


def _describe_parted(event: Parted) -> str:
    """`the beliefs of targets 1 and 2 overlap by 0 < 0.05 for 5 frames → parted; ...`."""
    value, level = distinct_texts(event.overlap, event.below)
    turning = round_away(event.turning, decimals(event.turning, event.below), up=False)
    stay = (
        f"overlap ≤ {turning} or apart_frames > {event.frames}"
        if float(turning)
        else f"apart_frames > {event.frames}"
    )
    return (
        f"the beliefs of target {event.target} and target {event.other} overlap by {value} < {level} "
        f"for {plural(event.frames, 'frame')} → parted, after {plural(event.together, 'frame')} together; "
        f"would have stayed joined at {stay}"
    )
