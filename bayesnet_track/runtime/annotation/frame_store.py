"""All frames of a video, in any order: decoded once, then kept without loss in a file without a name."""

from __future__ import annotations

import hashlib
import math
import shutil
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Self

import cv2
import numpy as np

from bayesnet_track.journal.disk import write_whole
from bayesnet_track.journal.writer import OutputError
from bayesnet_track.numerics.arrays import Image
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.entrances.notices import few, notice

AT_HAND = 48
"""Decoded frames that are kept in memory."""

PREFIX = "bayesnet_track_frames_"
"""Of the name of the temporary file, where the system has none without a name."""

FIRST_LOOK = 16
"""Frames that say how large those to come are."""

REMEDY = "make room there, or set TMPDIR to a folder that has room"

FASTEST = (cv2.IMWRITE_PNG_COMPRESSION, 1)


@dataclass(frozen=True)
class Video:
    """Properties of a video that annotations must fit.

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
    """The frames of a source, decoded when it is made. Use as a context manager: they go at the end.

    They are PNG images in one temporary file that has no name (on Windows: that the system removes when it is
    closed), so that nothing stays however the process ends. Called from several threads: pictures for the
    page and for the tracker.

    Args:
        name: of the video.
        interval_s: nominal seconds between frames.
        expected: how many frames there will be, where that is known.

    Raises:
        OutputError: the folder for temporary files has no room.
    """

    def __init__(self, name: str, interval_s: float, expected: int | None = None) -> None:
        self._name = "".join(
            character if character.isprintable() else "\N{REPLACEMENT CHARACTER}" for character in name
        )
        self._interval_s, self._expected = interval_s, expected
        self._ends, self._size = [0], (0, 0)
        self._near: OrderedDict[int, Image] = OrderedDict()
        self._lock = threading.Lock()
        try:
            self._file = tempfile.TemporaryFile(prefix=PREFIX, buffering=0)  # noqa: SIM115
        except OSError as error:
            raise OutputError(f"no temporary file for decoded frames: {error}; {REMEDY}") from error

    @classmethod
    def of(
        cls,
        source: Iterable[Any],
        name: str,
        interval_s: float,
        hear: Callable[[int], None] = lambda count: None,
    ) -> Self:
        """The frames of a source, gaps closed and said; `hear` is told how many there are as they come."""
        store = cls(name, interval_s, getattr(source, "expected_frames", None))
        missing, following = list[int](), None
        try:
            for item in source:
                if isinstance(item, Frame):
                    missing += range(item.index if following is None else following, item.index)
                    following = item.index + 1
                    store._add(item.image)
                    hear(len(store))
        except BaseException:
            store.close()
            raise
        if missing:
            notice(
                f"{name}: frames cannot be read and are left out: {few(missing)}; those behind them are "
                "counted without them"
            )
        return store

    def _add(self, image: Image) -> None:
        is_encoded, data = cv2.imencode(".png", image, FASTEST)
        assert is_encoded
        try:
            write_whole(self._file, data.tobytes())
        except OSError as error:
            raise self._describe_full(error.strerror or str(error)) from error
        self._ends.append(self._ends[-1] + len(data))
        self._size = (image.shape[1], image.shape[0])
        if len(self) >= FIRST_LOOK and len(self) & (len(self) - 1) == 0:  # 16, 32, 64, ...
            self._check_room()

    def _check_room(self) -> None:
        """Refuse a video that will not fit, before the disk is full."""
        if self._expected is None:
            return
        missing = self._ends[-1] / len(self) * (self._expected - len(self))
        free = _find_free()
        if free is not None and free < missing:
            raise self._describe_full("too little room")

    def _describe_full(self, reason: str) -> OutputError:
        size, free = self._ends[-1], _find_free()
        room = "" if free is None else f", {_megabytes(free)} free"
        needed = f"{len(self)} frames take {_megabytes(size)}"
        if self._expected is not None and len(self):
            total = size / len(self) * max(self._expected, len(self))
            needed = f"all {self._expected} frames need about {_megabytes(total)}, the first {needed}"
        place = f"{tempfile.gettempdir()}: {reason}{room}"
        return OutputError(f"{place} (decoded frames of {self._name}): {needed}; {REMEDY}")

    def __len__(self) -> int:
        return len(self._ends) - 1

    def image(self, frame: int) -> Image:
        """A frame (H, W, 3) uint8, BGR."""
        with self._lock:
            image = self._near.get(frame)
            if image is not None:
                return image
            start, end = self._ends[frame], self._ends[frame + 1]
            self._file.seek(start)
            data = np.frombuffer(self._file.read(end - start), np.uint8)
        image = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)
        with self._lock:
            self._near[frame] = image
            while len(self._near) > AT_HAND:
                self._near.popitem(last=False)
        return image

    def about(self) -> Video:
        """Properties of the video that annotations must fit."""
        digest = hashlib.sha256()
        for frame in sorted({0, len(self) // 2, len(self) - 1}):
            digest.update(np.ascontiguousarray(self.image(frame)).tobytes())
        return Video(self._name, len(self), *self._size, self._interval_s, digest.hexdigest())

    def close(self) -> None:
        """Let go of the frames."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _find_free() -> int | None:
    """Bytes that the folder for temporary files has room for; None where the system cannot say."""
    with suppress(OSError):
        return shutil.disk_usage(tempfile.gettempdir()).free
    return None


def _megabytes(size: float) -> str:
    return f"{math.ceil(size / 1e6):,} MB"
