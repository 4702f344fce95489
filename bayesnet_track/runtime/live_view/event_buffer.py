"""Lines in order, kept on disk: a run appends, and whoever reads does so from any place, at leisure."""

from __future__ import annotations

import tempfile
import threading
from array import array


class EventBuffer:
    """Appended to by one thread, read by any. What is read was appended whole; nothing is ever skipped.

    >>> buffer = EventBuffer()
    >>> for line in (b"a", b"bc", b"d"):
    ...     buffer.append(line)
    >>> buffer.read(1, most=2), buffer.read(1, most=3), len(buffer)
    ([b'bc'], [b'bc', b'd'], 3)

    Raises:
        OSError: no temporary file can be made; from `append`, too, when the disk is full.
    """

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115
        self._ends = array("Q")
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._ends)

    def append(self, line: bytes) -> None:
        """Add a line behind the others."""
        with self._lock:
            end = self._ends[-1] if self._ends else 0
            # What a full disk cut off is written over.
            self._file.seek(end)
            rest = memoryview(line)
            while rest:
                rest = rest[self._file.write(rest) :]
            self._ends.append(end + len(line))

    def read(self, first: int, most: int) -> list[bytes]:
        """Lines from number `first` on, at most `most` bytes together, but one at least if there is one."""
        with self._lock:
            if not 0 <= first < len(self._ends):
                return []
            begin = place = self._ends[first - 1] if first else 0
            ends: list[int] = []
            for number in range(first, len(self._ends)):
                if ends and self._ends[number] - begin > most:
                    break
                ends.append(self._ends[number])
            self._file.seek(begin)
            data = b""
            while len(data) < ends[-1] - begin:
                data += self._file.read(ends[-1] - begin - len(data))
        lines = []
        for end in ends:
            lines.append(data[place - begin : end - begin])
            place = end
        return lines

    def close(self) -> None:
        """Let go of the file, and of the lines."""
        self._file.close()
