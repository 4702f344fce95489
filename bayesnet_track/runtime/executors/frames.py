"""Frames where agents work: in memory that worker processes share, or decoded there, by the host of a camera.

The shared memory is written once by the engine and read in place by the workers. It has no name: a file that
exists only as long as a process holds it, so that nothing is left behind, however the processes end.

The stream of a camera is placed like an agent, in the worker of those that look at it; the engine is told
numbers and times. It answers from its file alone, so that a fresh worker gives the same frames.
"""

from __future__ import annotations

import math
import mmap
import os
import tempfile
import zlib
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.planes import Depth, Frame, PointMap, RightEye, StereoGeometry
from bayesnet_track.observation.settings import by_command_line, setting
from bayesnet_track.runtime.executors.messages import CueCall
from bayesnet_track.sources.entrances.notices import heard, notice
from bayesnet_track.sources.frames import EndReason, SourceItem
from bayesnet_track.sources.origin import Origin
from bayesnet_track.sources.paths import SourceError

SLOTS = 4
"""Frames that are held: the current one, the one before, and those of targets that start."""
ALIGNED = 64


@dataclass(frozen=True)
class _Block:
    """An array in the shared memory."""

    offset: int
    shape: tuple[int, ...]
    dtype: str


@dataclass(frozen=True)
class SharedFrame:
    """The place of a frame, and what is known of it. No two frames of a run have the same `number`."""

    number: int
    index: int
    time: float
    time_s: float
    has_color: bool
    image: _Block
    depth: _Block | None
    geometry: StereoGeometry | None
    stride: int


class FrameRing:
    """The engine's side: a ring of slots, of which each holds one frame with its depth.

    Attributes:
        descriptor: of the file, to be handed to workers.
    """

    def __init__(self) -> None:
        if hasattr(os, "memfd_create"):
            self.descriptor = os.memfd_create("bayesnet_track frames")
        else:
            with tempfile.TemporaryFile() as file:
                self.descriptor = os.dup(file.fileno())
        self._memory: mmap.mmap | None = None
        self._base = self._slot_size = self._number = 0
        self._held: deque[tuple[Frame, SharedFrame]] = deque(maxlen=SLOTS)

    def put(self, frame: Frame) -> SharedFrame:
        """Write the frame, unless it is one of the last ones already, and return its place."""
        for stored, shared in self._held:
            if stored is frame:
                return shared
        second = _pixels_of(frame.depth)
        size = _align(frame.image.nbytes) + (0 if second is None else _align(second.nbytes))
        if size > self._slot_size:
            self._grow(size)
        offset = self._base + self._number % SLOTS * self._slot_size
        self._number += 1
        image = self._write(frame.image, offset)
        depth = None if second is None else self._write(second, offset + _align(frame.image.nbytes))
        geometry = frame.depth.geometry if isinstance(frame.depth, RightEye) else None
        times = (frame.index, frame.time, frame.time_s)
        shared = SharedFrame(self._number, *times, frame.has_color, image, depth, geometry, frame.stride)
        self._held.append((frame, shared))
        return shared

    def close(self) -> None:
        """Let go of the memory; it is gone when the last worker has."""
        self._held.clear()
        if self._memory is not None:
            self._memory.close()
            self._memory = None
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1

    def _grow(self, size: int) -> None:
        """Larger slots, behind the old ones, in which a worker may still look."""
        self._base, self._slot_size = self._base + SLOTS * self._slot_size, size
        self._held.clear()
        os.ftruncate(self.descriptor, self._base + SLOTS * size)
        if self._memory is not None:
            self._memory.close()
        self._memory = mmap.mmap(self.descriptor, self._base + SLOTS * size)

    def _write(self, array: Array, offset: int) -> _Block:
        block = _Block(offset, array.shape, array.dtype.str)
        assert self._memory is not None
        target = np.frombuffer(self._memory, array.dtype, array.size, offset).reshape(array.shape)
        target[...] = array
        return block


class FrameView:
    """A worker's side: frames are views of the shared memory, in which it can only read."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._memory: mmap.mmap | None = None
        self._frames: dict[int, Frame] = {}

    def get(self, shared: SharedFrame) -> Frame:
        """The frame; the same object as long as it is one of the last."""
        frame = self._frames.get(shared.number)
        if frame is None:
            for number in [stored for stored in self._frames if stored <= shared.number - SLOTS]:
                del self._frames[number]
            frame = Frame(
                shared.index,
                shared.time,
                self._array(shared.image),
                shared.has_color,
                shared.time_s,
                self._depth(shared),
                shared.stride,
            )
            self._frames[shared.number] = frame
        return frame

    def _depth(self, shared: SharedFrame) -> Depth | None:
        if shared.depth is None:
            return None
        pixels = self._array(shared.depth)
        return PointMap(pixels) if shared.geometry is None else RightEye(pixels, shared.geometry)

    def _array(self, block: _Block) -> Array:
        dtype, size = np.dtype(block.dtype), math.prod(block.shape)
        end = block.offset + size * dtype.itemsize
        if self._memory is None or len(self._memory) < end:
            # The old memory stays as long as a frame in it does.
            file_size = os.fstat(self._descriptor).st_size
            self._memory = mmap.mmap(self._descriptor, file_size, access=mmap.ACCESS_READ)
        return np.frombuffer(self._memory, dtype, size, block.offset).reshape(block.shape)


def _pixels_of(depth: Depth | None) -> Array | None:
    """The other eye's picture, or the points."""
    if depth is None:
        return None
    return depth.image if isinstance(depth, RightEye) else depth.points


def _align(size: int) -> int:
    return -(-size // ALIGNED) * ALIGNED


HELD = 4
"""Frames that a host keeps: that of the step, the one before, the next one, and one of reserve."""


@dataclass(frozen=True)
class HostedFrame:
    """A frame without its pixels, which its host has.

    Attributes:
        stream: the name of the stream at its host.
        number: the frame's index.
        time: as of the frame, in frame intervals.
        time_s: the same in seconds.
        shape: rows, columns and channels.
        has_color: as of the frame.
        stride: as of the frame.
        checksum: CRC-32 of its pixels, by which a run that goes on knows it again.
    """

    stream: str
    number: int
    time: float
    time_s: float
    shape: tuple[int, ...]
    has_color: bool
    stride: int
    checksum: int

    def __reduce__(self) -> tuple[Any, ...]:
        """Values without the names of the fields: two frames go with each question."""
        return HostedFrame, tuple(getattr(self, field.name) for field in fields(self))

    def frame(self) -> Frame:
        """The frame as the engine has it: black, all pixels in one byte."""
        image = np.broadcast_to(np.zeros((), np.uint8), self.shape)
        return Frame(
            self.number, self.time, image, self.has_color, self.time_s, stride=self.stride, place=self
        )


@dataclass(frozen=True)
class StreamSettings:
    """The name of a stream, and how its source was opened."""

    name: str
    origin: Origin
    is_command: bool


HEADER = (
    *("description", "width", "height", "has_color", "has_depth", "frame_interval_s", "is_live", "stride"),
    *("declared_frames", "expected_frames", "numbers"),
)
"""Attributes of an opened source that the engine is told."""


class HostedOrigin(Origin):
    """The origin of a source that is read elsewhere, with the fingerprints of its files there."""

    def marked(self) -> Origin:
        """The same; no file is read here."""
        return Origin(**vars(self))


class CameraStream:
    """The frames of one camera at its host."""

    needs = ()

    def __init__(self, settings: StreamSettings) -> None:
        self._settings = settings
        self._frames: deque[Frame] = deque(maxlen=HELD)
        self._items: Iterator[SourceItem] | None = None

    def open(self) -> tuple[dict[str, Any], Origin, list[str]] | tuple[str, ...]:
        """Attributes of the opened source (`HEADER`), its origin with fingerprints, and notices about it.

        One that cannot be opened, or is not what its origin says, as the parts of a `SourceError`.
        """
        origin, notices = self._settings.origin, list[str]()
        try:
            changes = "; ".join(origin.changes())
            if changes:
                raise SourceError(
                    origin.text, f"it is not what it was: {changes}", "the same file", "put it back"
                )
            with heard(notices.append), by_command_line() if self._settings.is_command else nullcontext():
                self._open()
            return {name: getattr(self._source, name) for name in HEADER}, origin.marked(), notices
        except SourceError as error:
            return error.given, error.found, error.allowed, error.mend

    def read_next(self, number: int) -> tuple[list[Any], EndReason]:
        """The next frame after `number` (-1 before the first) and the events before it; why the source ended.

        Without a frame the source has ended.
        """
        self._read_to(number)
        items: list[Any] = []
        for item in self._items or ():
            if not isinstance(item, Frame):
                items.append(item)
                continue
            self._hold(item)
            times = item.index, item.time, item.time_s
            checksum = zlib.crc32(item.image.tobytes())
            items.append(
                HostedFrame(
                    self._settings.name, *times, item.image.shape, item.has_color, item.stride, checksum
                )
            )
            break
        return items, self._source.end_reason

    def frame(self, number: int) -> Frame:
        """The frame of an index."""
        for frame in self._frames:
            if frame.index == number:
                return frame
        self._read_to(number)
        return self._frames[-1]

    def _open(self) -> None:
        from bayesnet_track.sources.several import reopen

        self._source = reopen(self._settings.origin)
        self._items = iter(self._source)
        self._frames.clear()

    def _hold(self, frame: Frame) -> None:
        self._frames.append(frame)

    def _read_to(self, number: int) -> None:
        """Make `number` the last frame that was read: from the first one on, where it was read before."""
        if self._items is None or (self._frames and self._frames[-1].index > number):
            self._open()
        assert self._items is not None
        while number >= 0 and not (self._frames and self._frames[-1].index >= number):
            item = next(self._items)
            if isinstance(item, Frame):
                self._hold(item)


class HostedSource:
    """The source of a camera as the engine has it: what its host says of it, and frames without pixels.

    Attributes:
        numbers: those of its frames, as of a `Source`.
        origin: how it was opened, and what its files held at the host.

    Raises:
        SourceError: its host cannot read it, or there is no host.
    """

    description: str
    width: int
    height: int
    has_color: bool
    frame_interval_s: float
    is_live: bool
    expected_frames: int | None
    numbers: range

    def __init__(
        self, camera: str, origin: Origin, ask: Callable[[CueCall], Any], close_host: Callable[[], None]
    ) -> None:
        self._camera, self._ask, self.close = camera, ask, close_host
        self.description = origin.description
        self.end_reason: EndReason = "end_of_source"
        opened = self._ask_host("open")
        if len(opened) != len(("header", "origin", "notices")):
            raise SourceError(*opened)
        header, marked, notices = opened
        vars(self).update(header)
        self.origin = HostedOrigin(**vars(marked))
        for text in notices:
            notice(text)

    def __iter__(self) -> Iterator[SourceItem]:
        number = -1
        while True:
            items, self.end_reason = self._ask_host("read_next", number)
            for item in items:
                yield item.frame() if isinstance(item, HostedFrame) else item
            if not items or not isinstance(items[-1], HostedFrame):
                return
            number = items[-1].number

    def _ask_host(self, method: str, *arguments: int) -> Any:
        """The answer of the host, where frames wait for it."""
        try:
            return self._ask(CueCall(stream_name(self._camera), method, None, None, arguments))
        except Exception as error:  # of any type: it was raised in another process
            position = "".join(f" after {number}" for number in arguments)
            raise SourceError(
                self.description,
                f"the host of camera {self._camera} gave no frame{position}: {error}",
                "a host that can read the video",
                f"use {setting('--hosts', 'engine')}, or resume the run",
            ) from error


STREAM = "camera "


def stream_name(camera: str) -> str:
    """The name by which the stream of a camera is asked."""
    return STREAM + camera
