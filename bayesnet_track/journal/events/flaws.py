"""What is wrong with the expressions of a graph: written when it begins, and when it ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import assert_never


@dataclass(frozen=True)
class FactorFlawed:
    """A factor had no value for some hypotheses, or was zero for all; written in the first such frame.

    Attributes:
        frame: the frame.
        target: target id.
        node: the factor.
        undefined: hypotheses for which the expression has no value (0 / 0, the root of a negative number);
            they count as impossible.
        hypotheses: hypotheses of the frame's first evaluation.
        ignored: true when all were impossible: the factor was left out of the frame.
    """

    frame: int
    target: str
    node: str
    undefined: int
    hypotheses: int
    ignored: bool


@dataclass(frozen=True)
class MotionFlawed:
    """An expression of the motion, or of a latent node, had no value for some hypotheses.

    Written in the first such frame.

    Attributes:
        frame: the frame.
        target: target id.
        part: drift or sd, and the field, `drift x`; or `given`, the node and the field, `given head.x`.
        undefined: hypotheses for which it has no value, or for which an sd is negative: the field stays as it
            is, or has no noise.
        hypotheses: hypotheses that were asked about first.
    """

    frame: int
    target: str
    part: str
    undefined: int
    hypotheses: int


@dataclass(frozen=True)
class FlawEnded:
    """An expression is sound again; written in the first frame without a flaw.

    Attributes:
        frame: the frame.
        target: target id.
        what: the factor, or the part of the motion, such as `drift x`.
    """

    frame: int
    target: str
    what: str


Events = FactorFlawed | MotionFlawed | FlawEnded


def describe(event: Events) -> str:
    """The sentence of an event, without its frame."""
    match event:
        case FactorFlawed():
            return _describe_factor(event)
        case MotionFlawed():
            of = f"{event.undefined} of {event.hypotheses} hypotheses"
            then = {
                "sd": "these have no such noise",
                "given": "these have the value of the node above",
                "measures": "these are impossible",
            }.get(event.part.partition(" ")[0], "it stays as it is for these")
            return f"{event.part} of target {event.target} has no value for {of} (such as 0 / 0) → {then}"
        case FlawEnded():
            return f"{event.what} of target {event.target} has a value for every hypothesis again"
        case _:
            assert_never(event)


def _describe_factor(event: FactorFlawed) -> str:
    """A factor whose values are no densities."""
    out = "it is left out until it is above 0 for some"
    if not event.undefined:
        return f"factor {event.node} of target {event.target} is 0 for all hypotheses → {out}"
    of = f"{event.undefined} of {event.hypotheses} hypotheses"
    then = out if event.ignored else "they count as impossible"
    return f"factor {event.node} of target {event.target} has no value for {of} (such as 0 / 0) → {then}"
