"""Reading the journal back. A torn last line is dropped with a notice; any other damage is an error."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

from bayesnet_track.journal.codec import JournalError, event_name, from_json
from bayesnet_track.journal.encoder import short
from bayesnet_track.journal.events.event import Event, Input
from bayesnet_track.journal.frame_file import FrameFile
from bayesnet_track.journal.metrics import FrameMetrics, PartMetrics

Notice = Callable[[str], None]


def read_events(path: Path, notice: Notice | None = None) -> Iterator[Event]:
    """The events of ``journal.jsonl``, in order.

    A last line without its newline is what a killed process leaves: it is dropped, and `notice` is called
    with a sentence that says so.

    Raises:
        JournalError: any other damaged line, named as file:line.
        OSError: the file cannot be read.
    """
    for where, event in _read(path, notice):
        if isinstance(event, FrameMetrics):
            raise JournalError(f"{where}: frame_metrics belong into no journal")
        if not isinstance(event, Event):
            raise JournalError(f"{where}: {event_name(type(event))} belongs into inputs.jsonl")
        yield event


def read_metrics(path: Path, notice: Notice | None = None) -> Iterator[FrameMetrics]:
    """Measurements of ``frames.npy.gz``, a line per target and frame, in order.

    A torn last record is dropped, and `notice` told of it.

    Raises:
        JournalError: any other damage.
        OSError: the file cannot be read.
    """
    for line in FrameFile(path, notice).lines():
        try:
            check_line(line)
        except JournalError as error:
            raise JournalError(f"{path}: frame {line.frame}: {error}") from error
        yield line


def read_inputs(path: Path, notice: Notice | None = None) -> Iterator[Input]:
    """The lines of ``inputs.jsonl``, in order; torn lines and errors as in `read_events`."""
    for where, event in _read(path, notice):
        if not isinstance(event, Input):
            raise JournalError(f"{where}: {event_name(type(event))} is nothing that comes from outside")
        yield event


def _read(path: Path, notice: Notice | None) -> Iterator[tuple[str, Event | Input | FrameMetrics]]:
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            where = f"{path}:{number}"
            if not line.endswith(b"\n"):
                if notice is not None:
                    notice(f"{where}: the last line is torn ({len(line)} bytes) and was dropped")
                return
            try:
                event = from_json(line[:-1].decode("utf-8"))
                check_line(event)
            except (JournalError, UnicodeDecodeError) as error:
                raise JournalError(f"{where}: {error}") from error
            yield where, event


MOST = 2**31 - 1
"""Largest frame, count or size in pixels: what the columns of a page hold."""


def check_line(event: Any) -> None:
    """Refuse a frame or count that is none, a box that is none, a size without pixels.

    Raises:
        JournalError: names the field, what it is and what it may be.
    """
    kind: Any = type(event)  # a class of events is hashable, whatever mypy says of Any
    for name, is_valid, what in _checks_of(kind):
        value = getattr(event, name)
        if not is_valid(value):
            raise JournalError(f"{name}: {short(repr(value))} is not {what}")


def _is_count(value: int | None) -> bool:
    return value is None or 0 <= value <= MOST


def _is_size(value: int) -> bool:
    return 1 <= value <= MOST


def _is_box(value: Sequence[float]) -> bool:
    return len(value) == 4


def _are_boxes(value: Sequence[Sequence[int]]) -> bool:
    return all(len(box) == 4 and min(box) >= -MOST and max(box) <= MOST for box in value)


def _are_parts(value: Mapping[str, PartMetrics]) -> bool:
    return all(_is_box(part.centre_box) and _is_box(part.sd) for part in value.values())


def _is_interval(value: float) -> bool:
    return math.isnan(value) or 0 <= value < math.inf


Check = tuple[str, Callable[[Any], bool], str]

_COUNT = (_is_count, f"an integer from 0 to {MOST}")
_SIZE = (_is_size, f"an integer from 1 to {MOST}")
_BOX = (_is_box, "four numbers")
_CHECKS: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    **dict.fromkeys(("frame", "frames", "declared_frames", "particles", "first_frame"), _COUNT),
    **dict.fromkeys(("width", "height"), _SIZE),
    **dict.fromkeys(("box", "centre_box", "map", "sd", "region50", "region90"), _BOX),
    "cloud": (_are_boxes, f"lists of four integers from -{MOST} to {MOST}"),
    "parts": (_are_parts, "parts with boxes of four numbers"),
    "frame_interval_s": (_is_interval, "a number of seconds from 0 on"),
}
"""By the field's name: a field of the same name means the same in every event."""


@cache
def _checks_of(kind: Any) -> tuple[Check, ...]:
    return tuple((item.name, *_CHECKS[item.name]) for item in fields(kind) if item.name in _CHECKS)
