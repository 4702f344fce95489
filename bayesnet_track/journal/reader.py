"""Reading the journal back. A torn last line is dropped with a notice; any other damage is an error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from bayesnet_track.journal.codec import JournalError, event_name, from_json
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.inputs import Input
from bayesnet_track.journal.frame_file import FrameFile
from bayesnet_track.journal.line_checks import check_line
from bayesnet_track.journal.metrics import FrameMetrics

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
    """What ``frames.npy.gz`` holds, a line per target and frame, in order.

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
