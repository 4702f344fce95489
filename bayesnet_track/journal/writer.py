"""Writing: the journal in whole lines, small files whole or not at all."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from bayesnet_track.journal import disk
from bayesnet_track.journal.codec import to_json
from bayesnet_track.journal.events.event import Event, Input
from bayesnet_track.journal.metrics import FrameMetrics


class OutputError(OSError):
    """An output file that cannot be written (disk full, no permission, ...)."""


@dataclass(frozen=True)
class Position:
    """Length of a file that is written, and the checksum of its bytes.

    Attributes:
        size: its bytes.
        sha256: of these, in hexadecimal.
    """

    size: int
    sha256: str


def read_position(path: Path, size: int | None = None) -> Position:
    """The position at the end of a file, or after its first `size` bytes (fewer where it has no more).

    Raises:
        OSError: it cannot be read.
    """
    digest, count = hashlib.sha256(), 0
    with path.open("rb") as file:
        while part := file.read(1 << 20 if size is None else min(1 << 20, size - count)):
            digest.update(part)
            count += len(part)
    return Position(count, digest.hexdigest())


class LineFile:
    """A UTF-8 text file of lines that end in a plain newline: a new one, or one that is continued.

    Lines are gathered until `flush`, which hands them to the operating system at once, so that a killed
    process leaves whole flushes. Where writing fails, the file is cut back to its last whole flush.

    Args:
        path: the file.
        after: continue after so many bytes; what follows them is cut off. None begins anew.

    Raises:
        OutputError: the file cannot be created, is shorter than `after`, or, at `flush`, cannot be written or
            was removed, replaced or changed by something else.
    """

    def __init__(self, path: Path, after: int | None = None) -> None:
        self.path = path
        self._place = path.absolute()
        self._lines: list[str] = []
        self._size = 0
        self._digest = hashlib.sha256()
        with writing(path):
            self._file = disk.open_raw(path, "wb" if after is None else "r+b")
        if after is not None:
            try:
                self._continue(after)
            except OSError as error:
                self._file.close()
                raise output_error(path, error) from error

    def _continue(self, after: int) -> None:
        while self._size < after:
            part = self._file.read(min(1 << 20, after - self._size))
            if not part:
                raise OutputError(
                    f"{self.path}: it has {self._size} bytes, not the {after} to continue after"
                )
            self._digest.update(part)
            self._size += len(part)
        self._file.truncate(after)

    @property
    def position(self) -> Position:
        """The position up to which the system has the file: after the last flush."""
        return Position(self._size, self._digest.hexdigest())

    def sync(self) -> None:
        """Let the disk have what was flushed."""
        with writing(self.path):
            disk.sync(self._file)

    def check(self) -> None:
        """Refuse to go on where something else removed, replaced or changed the file.

        Raises:
            OutputError: it did; says what.
        """
        with writing(self.path):
            disk.check_held(self._file, self._place, self._size)

    def append(self, line: str) -> None:
        """Add a line (without its newline) to the next flush."""
        self._lines.append(line)

    def _pending(self) -> bytes:
        """Lines since the last flush."""
        data = "".join([f"{line}\n" for line in self._lines]).encode("utf-8")
        self._lines.clear()
        return data

    def flush(self) -> None:
        """Hand every line added so far to the operating system."""
        data = memoryview(self._pending())
        if not data:
            return
        self.check()
        count = 0
        try:
            while count < len(data):
                count += self._file.write(data[count:]) or 0
        except OSError as error:
            with suppress(OSError):
                self._file.truncate(self._size)
                self._file.seek(self._size)
            raise output_error(self.path, error) from error
        self._size += count
        self._digest.update(data)

    def close(self) -> None:
        """Flush and close; safe to call twice."""
        if not self._file.closed:
            try:
                self.flush()
            finally:
                self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class JournalWriter(LineFile):
    """A new file of events, one a line: ``journal.jsonl`` and ``inputs.jsonl``."""

    def write(self, event: Event | Input | FrameMetrics) -> None:
        """Add an event to the next flush.

        Raises:
            JournalError: a value of the event is not of its field's type.
        """
        self.append(to_json(event))


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an error of the system inside it into an `OutputError`, which names the output."""
    try:
        yield
    except OSError as error:
        raise output_error(path, error) from error


def output_error(path: Path, error: OSError) -> OutputError:
    """The system's error about a file that cannot be written."""
    if isinstance(error, OutputError):
        return error
    if isinstance(error, disk.LostFileError):
        return OutputError(f"{path}: {error}")
    return OutputError(
        error.errno, f"cannot write: {error.strerror or os.strerror(error.errno or 0)}", str(path)
    )


PART = ".part"
"""What the name of a file that is not whole yet ends in."""


def write_atomically(path: Path, data: bytes, previous: Path | None = None) -> None:
    """Write beside `path`, let the disk have it, and give it its name; the old file gets the name `previous`.

    After a crash at any moment the old file is there, under one of its names, or the new one, and perhaps a
    part that nobody reads.

    Raises:
        OutputError: it cannot be written; the old file is as it was.
    """
    part = path.with_name(path.name + PART)
    try:
        with closing(disk.open_raw(part, "wb")) as file:
            disk.write_whole(file, data)
            disk.sync(file)
        if previous is not None and path.exists():
            disk.replace(path, previous)
        disk.replace(part, path)
        disk.sync_folder(path.parent)
    except OSError as error:
        with suppress(OSError):
            disk.unlink(part)
        raise output_error(path, error) from error
