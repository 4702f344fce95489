"""What a person says of a target in a frame, and which answers are in force after some were taken back."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from bayesnet_track.runtime.annotation.names import describe_fault

Box = tuple[float, float, float, float]
"""Top-left corner x, y, width and height, px."""

Kind = Literal["box", "correct", "gone", "undo"]
KINDS: tuple[Kind, ...] = ("box", "correct", "gone", "undo")


class AnswerError(ValueError):
    """An answer that makes no sense; the message is for the person who gave it."""


@dataclass(frozen=True)
class Answer:
    """One answer.

    Attributes:
        kind: `box`: it is here; `correct`: the box that was shown is right; `gone`: it cannot be seen from
            this frame on, until a box says otherwise; `undo`: the newest answer that is in force is not.
        frame: from 0; 0 of an undo.
        target: name of the target; empty of an undo.
        box: of `box` and `correct`.
    """

    kind: Kind
    frame: int = 0
    target: str = ""
    box: Box | None = None

    def as_dict(self) -> dict[str, Any]:
        """What stands in a line of the file."""
        if self.kind == "undo":
            return {"kind": "undo"}
        line: dict[str, Any] = {"kind": self.kind, "frame": self.frame, "target": self.target}
        return line if self.box is None else {**line, "box": list(self.box)}


UNDO = Answer("undo")


def read_answer(given: Mapping[str, Any], frames: int, width: int, height: int) -> Answer:
    """The answer that a line or a page gives.

    Raises:
        AnswerError: it is none of this video.
    """
    kind = given.get("kind")
    if kind not in KINDS:
        raise AnswerError(f"kind {kind!r}: one of {', '.join(KINDS)} is needed")
    if kind == "undo":
        return UNDO
    frame, target = given.get("frame"), given.get("target")
    if type(frame) is not int or not 0 <= frame < frames:
        raise AnswerError(f"frame {frame!r}: the video has frames 0 to {frames - 1}")
    fault = describe_fault(target)
    if fault is not None:
        raise AnswerError(fault)
    assert isinstance(target, str)
    if kind == "gone":
        return Answer("gone", frame, target)
    return Answer(kind, frame, target, read_box(given.get("box"), width, height))


def read_box(given: object, width: int, height: int) -> Box:
    """Four finite numbers x, y, w, h with an area that touches the frame; raises AnswerError."""
    values = list(given) if isinstance(given, list | tuple) else []
    if len(values) != 4 or any(type(value) not in (int, float) for value in values):
        raise AnswerError(f"box {given!r}: four numbers x, y, w, h are needed")
    try:
        x, y, w, h = (float(value) for value in values)
    except OverflowError as error:
        raise AnswerError("a box is four numbers of px") from error
    if not all(map(math.isfinite, (x, y, w, h))) or w <= 0 or h <= 0:
        raise AnswerError(f"box {x:g},{y:g},{w:g},{h:g}: width and height above 0 are needed")
    if x >= width or y >= height or x + w <= 0 or y + h <= 0:
        raise AnswerError(f"box {x:g},{y:g},{w:g},{h:g}: it lies outside of the frame of {width}x{height} px")
    return x, y, w, h


def in_force(answers: Iterable[Answer]) -> tuple[Answer, ...]:
    """Those that no undo took back, in the order in which they were given."""
    kept: list[Answer] = []
    for one in answers:
        if one.kind != "undo":
            kept.append(one)
        elif kept:
            kept.pop()
    return tuple(kept)
