"""Frames in Ray's object store: put there once by the engine, read by the actors of any node."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from bayesnet_track.observation.depth import Depth, PointMap, RightEye, StereoGeometry
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.executors.frames import SLOTS, pixels_of

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class StoredFrame:
    """Which objects a frame is, and what is known of it. No two frames of a run have the same `number`."""

    number: int
    index: int
    time: float
    time_s: float
    has_color: bool
    image: Any
    depth: Any
    geometry: StereoGeometry | None


class RayFrameStore:
    """The engine's side: the last frames, so that their objects are kept."""

    def __init__(self) -> None:
        self._number = 0
        self._held: deque[tuple[Frame, StoredFrame]] = deque(maxlen=SLOTS)

    def put(self, frame: Frame) -> StoredFrame:
        """The frame in the store; it is put there unless it is one of the last ones already."""
        import ray

        for held, stored in self._held:
            if held is frame:
                return stored
        self._number += 1
        other = pixels_of(frame.depth)
        stored = StoredFrame(
            self._number,
            frame.index,
            frame.time,
            frame.time_s,
            frame.has_color,
            ray.put(frame.image),
            None if other is None else ray.put(other),
            frame.depth.geometry if isinstance(frame.depth, RightEye) else None,
        )
        self._held.append((frame, stored))
        return stored

    def close(self) -> None:
        """Let go of the frames."""
        self._held.clear()


def fetched(stored: StoredFrame) -> Frame:
    """The frame, in an actor."""
    image = _array(stored.image)
    depth: Depth | None = None
    if stored.depth is not None:
        pixels = _array(stored.depth)
        depth = PointMap(pixels) if stored.geometry is None else RightEye(pixels, stored.geometry)
    return Frame(stored.index, stored.time, image, stored.has_color, stored.time_s, depth)


def _array(stored: Any) -> Array:
    """What lies in the store, which can only be read."""
    import ray

    array: Array = ray.get(stored)
    return array
