"""Reading the journal back. A torn last line is dropped with a notice; any other damage is an error."""

from __future__ import annotations

import json
import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from functools import cache
from itertools import accumulate, takewhile
from pathlib import Path
from typing import Any, overload

from bayesnet_track.journal.codec import event_name, from_json
from bayesnet_track.journal.encoder import JournalError, short
from bayesnet_track.journal.events.event import Event, Input
from bayesnet_track.journal.frame_file import FrameFile, RecordPlace
from bayesnet_track.journal.metrics import FrameMetrics, PartMetrics


def read_seconds(path: Path) -> Iterator[tuple[int, float]]:
    """Frame and seconds of each line; nothing where there is no such file.

    Raises:
        JournalError: a line is malformed; says file and line.
        OSError: it cannot be read.
    """
    if not path.is_file():
        return
    # What follows the last newline is what a killed process leaves of a line.
    for number, line in enumerate(path.read_bytes().split(b"\n")[:-1], start=1):
        try:
            entry = json.loads(line)
            frame, seconds = int(entry["frame"]), float(entry["seconds"])
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
            frame, seconds = -1, math.nan
        if not (0 <= frame <= MOST and 0 <= seconds < math.inf):
            raise JournalError(f"{path}:{number}: expected an object with frame and seconds")
        yield frame, seconds


Notice = Callable[[str], None]


def read_events(path: Path, notice: Notice | None = None) -> Iterator[Event]:
    """The events of ``journal.jsonl``, in order.

    A last line without its newline is what a killed process leaves: it is dropped, and `notice` is called
    with a sentence that says so.

    Raises:
        JournalError: any other damaged line, named as file:line.
        OSError: the file cannot be read.
    """
    for location, event in _read(path, notice):
        if isinstance(event, FrameMetrics):
            raise JournalError(f"{location}: frame_metrics belong into no journal")
        if not isinstance(event, Event):
            raise JournalError(f"{location}: {event_name(type(event))} belongs into inputs.jsonl")
        yield event


def read_metrics(
    path: Path, notice: Notice | None = None, target: str | None = None
) -> Iterator[FrameMetrics]:
    """Measurements of ``frames.npy.gz``, a line per target and frame, in order; or of one `target` alone.

    A torn last record is dropped, and `notice` told of it.

    Raises:
        JournalError: any other damage.
        OSError: the file cannot be read.
    """
    yield from _checked(FrameFile(path, notice), None, target)


def _checked(
    file: FrameFile, places: Sequence[RecordPlace] | None, target: str | None = None
) -> Iterator[FrameMetrics]:
    for line in file.lines(places, target):
        try:
            check_line(line)
        except JournalError as error:
            raise JournalError(f"{file.path}: frame {line.frame}: {error}") from error
        yield line


class Measurements(Sequence[FrameMetrics]):
    """The lines of ``frames.npy.gz`` as a sequence that reads a frame when it is asked for one of its lines.

    Memory does not grow with the run; going through all lines reads the file once.

    Args:
        path: the file.
        notice: told of a torn last record.
        targets: ids of the targets that start in the journal, if it was read.

    Raises:
        JournalError: a record is damaged, or about a target that never starts, when it is read.
        OSError: the file cannot be read.
    """

    def __init__(
        self, path: Path, notice: Notice | None = None, targets: Container[str] | None = None
    ) -> None:
        self.file, self._targets = FrameFile(path, notice), targets
        self._ends = list(accumulate(place.targets for place in self.file.places))
        self._last: tuple[int, list[FrameMetrics]] = (-1, [])

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __iter__(self) -> Iterator[FrameMetrics]:
        for number in range(len(self.file)):
            yield from self._read(number)

    @overload
    def __getitem__(self, index: int) -> FrameMetrics: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[FrameMetrics]: ...

    def __getitem__(self, index: int | slice) -> FrameMetrics | Sequence[FrameMetrics]:
        if isinstance(index, slice):
            return tuple(self[number] for number in range(len(self))[index])
        position = range(len(self))[index]
        number = bisect_right(self._ends, position)
        if self._last[0] != number:
            self._last = number, self._read(number)
        return self._last[1][position - self._ends[number]]

    def check_targets(self, targets: Iterable[str]) -> None:
        """Raise JournalError for the first of some targets that never starts."""
        for target in () if self._targets is None else sorted(targets):
            if target not in (self._targets or ()):
                raise JournalError(f"{self.file.path}: target {target!r} never starts in journal.jsonl")

    def __repr__(self) -> str:
        return f"Measurements({str(self.file.path)!r}: {len(self)} lines)"

    def _read(self, number: int) -> list[FrameMetrics]:
        place = self.file.places[number]
        lines = list(_checked(self.file, [place]))
        if len(lines) != place.targets:
            raise JournalError(
                f"{self.file.path}: frame {place.frame}: {len(lines)} lines, not {place.targets}"
            )
        self.check_targets(line.target for line in lines)
        return lines


def lines_of_frame(metrics: Sequence[FrameMetrics], frame: int) -> Sequence[FrameMetrics]:
    """The lines of one frame, of measurements in the order of frames."""
    start = bisect_left(metrics, frame, key=lambda line: line.frame)
    return [
        *takewhile(lambda line: line.frame == frame, (metrics[row] for row in range(start, len(metrics))))
    ]


def read_inputs(path: Path, notice: Notice | None = None) -> Iterator[Input]:
    """The lines of ``inputs.jsonl``, in order; torn lines and errors as in `read_events`."""
    for location, event in _read(path, notice):
        if not isinstance(event, Input):
            raise JournalError(f"{location}: {event_name(type(event))} is nothing that comes from outside")
        yield event


def _read(path: Path, notice: Notice | None) -> Iterator[tuple[str, Event | Input | FrameMetrics]]:
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            location = f"{path}:{number}"
            if not line.endswith(b"\n"):
                if notice is not None:
                    notice(f"{location}: the last line is torn ({len(line)} bytes) and was dropped")
                return
            try:
                event = from_json(line[:-1].decode("utf-8"))
                check_line(event)
            except (JournalError, UnicodeDecodeError) as error:
                raise JournalError(f"{location}: {error}") from error
            yield location, event


MOST = 2**31 - 1
"""Largest frame, count or size in pixels: what the columns of a page hold."""


def check_line(event: Any) -> None:
    """Refuse a frame or count that is none, a box that is none, a size without pixels.

    Raises:
        JournalError: names the field, what it is and what it may be.
    """
    kind: Any = type(event)  # a class of events is hashable, whatever mypy says of Any
    for name, is_valid, requirement in _checks_of(kind):
        value = getattr(event, name)
        if not is_valid(value):
            raise JournalError(f"{name}: {short(repr(value))} is not {requirement}")


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
