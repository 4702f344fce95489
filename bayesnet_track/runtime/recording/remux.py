"""A fragmented MP4 as a plain one, with one index at its end, which every player can seek in."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from hashlib import sha256
from io import FileIO
from pathlib import Path
from typing import Any

from bayesnet_track.journal import disk
from bayesnet_track.journal.writer import PART

CHANGED = "something else changed it while it was being written"


PART_BYTES = 1 << 20


class DiskFile:
    """A new file as PyAV writes one: it does not look how much of its bytes was taken.

    Nearly all is appended. What is written over, such as the sizes of clusters, is kept, so that `check` can
    tell the bytes that were written from those of something else.
    """

    def __init__(self, file: FileIO) -> None:
        self._file, self.size = file, 0
        self.seek, self.tell = file.seek, file.tell
        self._appended = sha256()
        self._replaced: list[tuple[int, bytes, bytes]] = []

    def write(self, data: bytes | memoryview) -> int:
        """Write all of it."""
        written, at = bytes(data), self._file.tell()
        over = min(len(written), max(self.size - at, 0))
        if over:
            self._replaced.append((at, self._file.read(over), written[:over]))
            self._file.seek(at)
        disk.write_whole(self._file, written)
        self._appended.update(bytes(max(at - self.size, 0)) + written[over:])
        self.size = max(self.size, self._file.tell())
        return len(written)

    def check(self) -> None:
        """Refuse a file whose bytes are not those that were written; raises LostFileError."""
        found, begin = sha256(), 0
        self._file.seek(0)
        while part := self._file.read(PART_BYTES):
            former = bytearray(part)
            for at, before, after in reversed(self._replaced):
                low, high = max(at, begin), min(at + len(after), begin + len(part))
                if low < high:
                    here, there = slice(low - begin, high - begin), slice(low - at, high - at)
                    if former[here] != after[there]:
                        raise disk.LostFileError(CHANGED)
                    former[here] = before[there]
            found.update(former)
            begin += len(part)
        if found.digest() != self._appended.digest():
            raise disk.LostFileError(CHANGED)


def remux(path: Path) -> None:
    """Replace the MP4 at `path` by one with the same frames and one index; it is there whole or as it was.

    With PyAV 14.0 and 14.1 it stays as it was: they give the copy the headers of another encoder.

    Raises:
        OSError: it cannot be read or written (also those of FFmpeg).
    """
    import av

    if av.__version__.split(".")[:2] in (["14", "0"], ["14", "1"]):
        return
    part = path.with_name(path.name + PART)
    try:
        with ExitStack() as stack:
            # The explicit protocol keeps FFmpeg from reading a protocol into the file's name.
            given: Any = stack.enter_context(av.open(f"file:{path.absolute()}"))
            file = disk.open_raw(part, "w+b")
            stack.callback(file.close)
            made: Any = av.open(DiskFile(file), mode="w", format="mp4", options={"fflags": "+bitexact"})
            with made:
                stream = _same_stream(made, given.streams.video[0])
                for packet in given.demux(given.streams.video[0]):
                    if packet.dts is not None:  # the last packet is empty
                        packet.stream = stream
                        made.mux(packet)
            disk.sync(file)
        disk.replace(part, path)
    except (OSError, av.error.FFmpegError) as error:
        with suppress(OSError):
            disk.unlink(part)
        # Closing what could not be written raises again, without the reason.
        if isinstance(error.__context__, OSError) and not isinstance(error, OSError):
            raise error.__context__ from None
        raise


def _same_stream(container: Any, stream: Any) -> Any:
    if hasattr(container, "add_stream_from_template"):
        # Otherwise PyAV 14 opens an encoder, whose headers are not those of the packets.
        return container.add_stream_from_template(stream, opaque=True)
    return container.add_stream(template=stream)  # before PyAV 14
