"""All frames of a video, in any order: decoded once, then kept without loss in a temporary folder."""

from __future__ import annotations

import hashlib
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np

from bayesnet_track.numerics.arrays import Image
from bayesnet_track.observation.planes import Frame

AT_HAND = 48
"""Decoded frames that are kept in memory."""

FASTEST = (cv2.IMWRITE_PNG_COMPRESSION, 1)


@dataclass(frozen=True)
class Video:
    """What annotations must fit.

    Attributes:
        name: as the person gave it.
        frame_interval_s: nominal seconds between frames.
        pixels: SHA-256 of the first, the middle and the last frame.
    """

    name: str
    frames: int
    width: int
    height: int
    frame_interval_s: float
    pixels: str = ""


class FrameStore:
    """The frames of a source, decoded when it is made. Use as a context manager: the folder goes at the end.

    Called from several threads: pictures for the page and for the tracker.
    """

    def __init__(
        self, name: str, interval_s: float, notice: Callable[[int], None] = lambda count: None
    ) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="bayesnet_track_frames_")
        self._near: OrderedDict[int, Image] = OrderedDict()
        self._name, self._interval_s, self._notice = name, interval_s, notice
        self._count, self._size = 0, (0, 0)

    @classmethod
    def of(
        cls,
        source: Iterable[Any],
        name: str,
        interval_s: float,
        notice: Callable[[int], None] = lambda _: None,
    ) -> Self:
        """The frames of a source, gaps closed; `notice` is told how many there are as they come."""
        store = cls(name, interval_s, notice)
        for item in source:
            if isinstance(item, Frame):
                store._add(item.image)
        return store

    def _add(self, image: Image) -> None:
        done, data = cv2.imencode(".png", image, FASTEST)
        assert done
        self._file(self._count).write_bytes(data.tobytes())
        self._count, self._size = self._count + 1, (image.shape[1], image.shape[0])
        self._notice(self._count)

    def __len__(self) -> int:
        return self._count

    def image(self, frame: int) -> Image:
        """A frame (H, W, 3) uint8, BGR."""
        found = self._near.get(frame)
        if found is None:
            found = np.asarray(cv2.imread(str(self._file(frame)), cv2.IMREAD_COLOR), dtype=np.uint8)
            self._near[frame] = found
            while len(self._near) > AT_HAND:
                self._near.pop(next(iter(self._near.copy())), None)
        return found

    def about(self) -> Video:
        """What annotations must fit."""
        digest = hashlib.sha256()
        for frame in sorted({0, self._count // 2, self._count - 1}):
            digest.update(np.ascontiguousarray(self.image(frame)).tobytes())
        return Video(self._name, self._count, *self._size, self._interval_s, digest.hexdigest())

    def _file(self, frame: int) -> Path:
        return Path(self._folder.name) / f"{frame:08d}.png"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()
