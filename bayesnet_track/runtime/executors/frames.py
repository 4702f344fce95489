"""Frames in memory that worker processes share: written once by the engine, read in place by the workers.

The memory has no name: a file that exists only as long as a process holds it, so that nothing is left behind,
however the processes end.
"""

from __future__ import annotations

import math
import mmap
import os
import tempfile
from collections import deque
from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.planes import Depth, Frame, PointMap, RightEye, StereoGeometry

SLOTS = 4
"""Frames that are held: the current one, the one before, and those of targets that start."""
ALIGNED = 64


@dataclass(frozen=True)
class Block:
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
    image: Block
    depth: Block | None
    geometry: StereoGeometry | None
    stride: int


class FrameStore:
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
        second = pixels_of(frame.depth)
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

    def _write(self, array: Array, offset: int) -> Block:
        block = Block(offset, array.shape, array.dtype.str)
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

    def _array(self, block: Block) -> Array:
        dtype, size = np.dtype(block.dtype), math.prod(block.shape)
        end = block.offset + size * dtype.itemsize
        if self._memory is None or len(self._memory) < end:
            # The old memory stays as long as a frame in it does.
            file_size = os.fstat(self._descriptor).st_size
            self._memory = mmap.mmap(self._descriptor, file_size, access=mmap.ACCESS_READ)
        return np.frombuffer(self._memory, dtype, size, block.offset).reshape(block.shape)


def pixels_of(depth: Depth | None) -> Array | None:
    """The other eye's picture, or the points."""
    if depth is None:
        return None
    return depth.image if isinstance(depth, RightEye) else depth.points


def _align(size: int) -> int:
    return -(-size // ALIGNED) * ALIGNED
