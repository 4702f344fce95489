"""The annotated video as a file that stays readable when the writer is killed: MKV, or fragmented MP4.

A fragmented MP4 as a plain one, with one index at its end, which every player can seek in.

Calls that are made in the background, in order: a frame does not wait for the disk or the encoder.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from fractions import Fraction
from hashlib import sha256
from io import FileIO
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal import disk
from bayesnet_track.journal.writer import PART, OutputError

Call = tuple[Future[None], Callable[..., None], tuple[Any, ...]]


class Background:
    """Makes calls one after the other on a thread of its own, which starts with the first one.

    Unlike that of a `ThreadPoolExecutor` it works until a program has called everything that it left for its
    end. Where no thread can start any more, calls are made at once, by the caller.

    Args:
        name: of the thread.
        most: calls that may wait; with more, the caller waits.

    >>> seen = []
    >>> background = Background("example")
    >>> background.submit(seen.append, 1).result()
    >>> background.submit(seen.append, 2)  # doctest: +ELLIPSIS
    <Future at ...>
    >>> background.shutdown()
    >>> seen
    [1, 2]
    """

    def __init__(self, name: str, limit: int = 1) -> None:
        self._name, self._most = name, limit
        self._calls: Queue[Call | None] = Queue(limit)
        self._thread: Thread | None = None

    def submit(self, call: Callable[..., None], *arguments: Any) -> Future[None]:
        """Have a call made; what it raises is raised by the `result` of what is returned."""
        future: Future[None] = Future()
        if self._is_at_work():
            self._calls.put((future, call, arguments))
        else:
            _make(future, call, arguments)
        return future

    def shutdown(self) -> None:
        """Wait until every call is made; safe to call twice."""
        thread, self._thread = self._thread, None
        if thread is not None and thread.is_alive():
            self._calls.put(None)
            thread.join()

    def _is_at_work(self) -> bool:
        """True if there is a thread, which is started where there is none; a forked process has none."""
        if self._thread is None or not self._thread.is_alive():
            self._calls = Queue(self._most)
            thread = Thread(target=_work, args=(self._calls,), name=self._name, daemon=True)
            try:
                thread.start()
            except RuntimeError:  # the interpreter ends, or the system has no more threads
                return False
            self._thread = thread
        return True


def _work(calls: Queue[Call | None]) -> None:
    while (item := calls.get()) is not None:
        _make(*item)
        del item  # the arguments of the last call may be large


def _make(future: Future[None], call: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    try:
        call(*arguments)
    except BaseException as error:
        future.set_exception(error)
        if not isinstance(error, Exception):
            raise
    else:
        future.set_result(None)


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
        written, position = bytes(data), self._file.tell()
        over = min(len(written), max(self.size - position, 0))
        if over:
            self._replaced.append((position, self._file.read(over), written[:over]))
            self._file.seek(position)
        disk.write_whole(self._file, written)
        self._appended.update(bytes(max(position - self.size, 0)) + written[over:])
        self.size = max(self.size, self._file.tell())
        return len(written)

    def check(self) -> None:
        """Refuse a file whose bytes are not those that were written; raises LostFileError."""
        digest, begin = sha256(), 0
        self._file.seek(0)
        while part := self._file.read(PART_BYTES):
            former = bytearray(part)
            for position, old_bytes, new_bytes in reversed(self._replaced):
                low, high = max(position, begin), min(position + len(new_bytes), begin + len(part))
                if low < high:
                    in_part, in_change = (
                        slice(low - begin, high - begin),
                        slice(low - position, high - position),
                    )
                    if former[in_part] != new_bytes[in_change]:
                        raise disk.LostFileError(CHANGED)
                    former[in_part] = old_bytes[in_change]
            digest.update(former)
            begin += len(part)
        if digest.digest() != self._appended.digest():
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
            source: Any = stack.enter_context(av.open(f"file:{path.absolute()}"))
            file = disk.open_raw(part, "w+b")
            stack.callback(file.close)
            target: Any = av.open(DiskFile(file), mode="w", format="mp4", options={"fflags": "+bitexact"})
            with target:
                stream = _same_stream(target, source.streams.video[0])
                for packet in source.demux(source.streams.video[0]):
                    if packet.dts is not None:  # the last packet is empty
                        packet.stream = stream
                        target.mux(packet)
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


SUFFIXES = {".mkv": "matroska", ".mp4": "mp4"}
_CLUSTER_S = 1
LONGEST_SIDE = 1920
"""Pixels of the longer side of a video, where nothing else is asked for."""
LEAST_SIDE = 16


def video_size(width: int, height: int, longest: int) -> tuple[int, int]:
    """Columns and rows of the video of frames of a size: even, and none above `longest`.

    >>> video_size(3840, 2160, 1920), video_size(65, 49, 1920)
    ((1920, 1080), (64, 48))
    """
    shrink = min(1.0, longest / max(width, height))
    if shrink == 1.0:
        return width - width % 2, height - height % 2
    return max(2, 2 * int(width * shrink / 2)), max(2, 2 * int(height * shrink / 2))


class VideoWriter:
    """A video sink for BGR frames of one size.

    ``.mkv`` (Matroska, a new cluster every second) or ``.mp4`` (fragmented at every key frame); H.264 where
    the library has libx264, else MPEG-4. An odd width or height is cut by one pixel, as 4:2:0 needs. Larger
    frames than `longest_side` px are scaled down to that.

    Raises:
        OutputError: another suffix, or the file cannot be created or written.
    """

    def __init__(
        self, path: Path, width: int, height: int, frame_interval_s: float, longest_side: int = LONGEST_SIDE
    ) -> None:
        import av

        self.path, self._place = path, path.absolute()
        self._faults = (av.error.FFmpegError, OSError, ValueError)
        if path.suffix.lower() not in SUFFIXES:
            raise OutputError(f"{path}: a video is written as {' or '.join(SUFFIXES)}")
        if width < 2 or height < 2:
            raise OutputError(f"{path}: a video needs at least 2x2 px, not {width}x{height}")
        rate = max(Fraction(1.0 / frame_interval_s).limit_denominator(1001), Fraction(1, 1001))
        self._size = video_size(width, height, longest_side)
        self._is_scaled = max(width, height) > longest_side
        codec = "libx264" if "libx264" in av.codecs_available else "mpeg4"
        options = {"cluster_time_limit": str(1000 * _CLUSTER_S), "flush_packets": "1"}
        if path.suffix.lower() == ".mp4":
            options = {"movflags": "frag_keyframe+empty_moov+default_base_moof", "flush_packets": "1"}
        # Without random identifiers, equal pictures make equal files.
        options["fflags"] = "+bitexact"
        # Without reordering and look-ahead a frame is in the file as soon as its cluster is.
        tuning = {"preset": "superfast", "crf": "23", "tune": "zerolatency"} if codec == "libx264" else {}
        self._count = 0
        self._container: Any = None
        try:
            self._file = disk.open_raw(path, "w+b")
        except OSError as error:
            raise self._error(error) from error
        try:
            self._output = DiskFile(self._file)
            self._container = av.open(
                self._output, mode="w", format=SUFFIXES[path.suffix.lower()], options=options
            )
            self._stream: Any = self._container.add_stream(codec, rate=rate, options=tuning)
            self._stream.width, self._stream.height = self._size
            self._stream.pix_fmt = "yuv420p"
            self._stream.codec_context.gop_size = max(1, round(rate * _CLUSTER_S))
            if codec == "mpeg4":
                self._stream.bit_rate = max(400_000, int(self._size[0] * self._size[1] * float(rate) * 0.2))
            # Otherwise the file would be made at the first frame.
            self._container.start_encoding()
        except self._faults as error:
            self._abandon()
            raise self._error(error) from error
        self._time_base = 1 / rate

    def write(self, image: NDArray[np.uint8]) -> None:
        """Add a frame, (H, W, 3) uint8 BGR."""
        import av

        width, height = self._size
        try:
            disk.check_held(self._file, self._place, self._output.size)
            if not self._is_scaled:
                image = image[:height, :width]
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="bgr24")
            if self._is_scaled:
                frame = frame.reformat(width, height, "yuv420p", interpolation="AREA")
            frame.pts, frame.time_base = self._count, self._time_base
            self._count += 1
            for packet in self._stream.encode(frame):
                self._container.mux(packet)
        except self._faults as error:
            self._abandon()
            raise self._error(error) from error

    def finish(self) -> None:
        """Close the file, and wait until the disk has it; an MP4 is no longer fragmented then."""
        self._end()
        try:
            disk.check_held(self._file, self._place, self._output.size)
            self._output.check()
            disk.sync(self._file)
        except OSError as error:
            raise self._error(error) from error
        finally:
            self._file.close()
        if self._count and self.path.suffix.lower() == ".mp4":
            try:
                remux(self.path)
            except self._faults as error:
                raise self._error(error) from error

    def close(self) -> None:
        """Close the file; safe to call twice."""
        self._end()
        self._file.close()

    def _end(self) -> None:
        if self._container is None:
            return
        try:
            for packet in self._stream.encode() if self._count else ():
                self._container.mux(packet)
            self._container.close()
            self._container = None
        except self._faults as error:
            self._abandon()
            raise self._error(error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _abandon(self) -> None:
        container, self._container = self._container, None
        if container is not None:
            with suppress(*self._faults):
                container.close()
        self._file.close()

    def _error(self, error: Exception) -> OutputError:
        if isinstance(error, disk.LostFileError):
            return OutputError(f"{self.path}: {error}")
        reason = getattr(error, "strerror", None) or error
        return OutputError(f"{self.path}: cannot write the video: {reason}")
