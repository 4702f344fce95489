"""Writing the journal: whole lines only, flushed at every frame."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Self

from bayesnet_track.journal.codec import to_json
from bayesnet_track.journal.events import Event, FrameMetrics
from bayesnet_track.journal.inputs import Input


class OutputError(OSError):
    """An output file that cannot be written (disk full, no permission, ...)."""


class LineFile:
    """A new UTF-8 text file of lines that end in a plain newline.

    Lines are gathered until `flush`, which hands them to the operating system at once, so that a killed
    process leaves whole flushes. Where writing fails, the file is cut back to its last whole flush.

    Raises:
        OutputError: the file cannot be created, or, at `flush`, written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lines: list[str] = []
        self._size = 0
        try:
            self._file = path.open("wb", buffering=0)
        except OSError as error:
            raise output_error(path, error) from error

    def append(self, line: str) -> None:
        """Add a line (without its newline) to the next flush."""
        self._lines.append(line)

    def flush(self) -> None:
        """Hand every line added so far to the operating system."""
        if not self._lines:
            return
        data = memoryview("".join(f"{line}\n" for line in self._lines).encode("utf-8"))
        self._lines.clear()
        done = 0
        try:
            while done < len(data):
                done += self._file.write(data[done:]) or 0
        except OSError as error:
            with suppress(OSError):
                self._file.truncate(self._size)
            raise output_error(self.path, error) from error
        self._size += done

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
    """A new file of events, one a line: ``journal.jsonl``, ``frames.jsonl`` and ``inputs.jsonl``."""

    def write(self, event: Event | Input | FrameMetrics) -> None:
        """Add an event to the next flush.

        Raises:
            JournalError: a value of the event is not of its field's type.
        """
        self.append(to_json(event))


def output_error(path: Path, error: OSError) -> OutputError:
    """What the system said of a file that cannot be written."""
    return OutputError(
        error.errno, f"cannot write: {error.strerror or os.strerror(error.errno or 0)}", str(path)
    )
