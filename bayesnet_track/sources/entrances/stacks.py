"""Files of several images: each page of a TIFF, Netpbm or animated WebP file is a frame."""

from __future__ import annotations

import math
from itertools import accumulate
from pathlib import Path
from struct import pack_into, unpack_from
from typing import Protocol

import numpy as np

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.image_files import decode
from bayesnet_track.observation.image_headers import (
    Pages,
    PictureError,
    check_size,
    declared_size,
    may_hold_several,
    pages_of,
)
from bayesnet_track.sources.paths import SourceError

IMAGE_INTERVAL_S = 1.0 / 25.0
MOST_BYTES = (1 << 31) - 1
"""Bytes of a file that OpenCV can address."""
AT_ONCE_PIXELS = 1 << 24
HEAD_BYTES = 1 << 20
LEAST_MS, USUAL_MS = 10, 100
"""A frame of an animation that is shown for less is shown for the usual time, as browsers do."""


class Stack(Protocol):
    """The images of one file."""

    @property
    def times(self) -> list[float]:
        """When each is shown, in intervals from 0."""

    @property
    def interval_s(self) -> float:
        """Seconds of an interval."""

    def read(self, index: int) -> Array:
        """The pixels of an image as they are; raises PictureError."""


def stack_of(path: Path) -> Stack | None:
    """The stack that a file is; None where it holds one image, or nothing that is known.

    Raises:
        SourceError: it is one that cannot be read.
    """
    try:
        with path.open("rb") as file:
            if not may_hold_several(file.read(16)):
                return None
        data = _bytes_of(path)
        pages = pages_of(path.name, data)
        if pages is None or pages.kind == "PNG":
            return None
        return Animation(path, data, pages) if pages.kind == "WebP" else PageStack(path, data, pages)
    except OSError:  # told when it is read
        return None
    except PictureError as error:
        raise SourceError(
            str(path),
            str(error),
            "stacks of images of one camera, one after the other in time",
            "save it anew, or split it into one file an image",
        ) from error


def is_animated_png(path: Path) -> bool:
    """Whether a file is a PNG of several frames, which is read as a video."""
    try:
        with path.open("rb") as file:
            pages = pages_of(path.name, file.read(HEAD_BYTES)) if path.suffix.lower() == ".png" else None
    except OSError:
        return False
    return pages is not None


def _bytes_of(path: Path) -> bytearray:
    """All of a file, to be changed; raises OSError, PictureError."""
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise PictureError(f"{path.name}: {size >> 20} MB; allowed: {MOST_BYTES >> 20} MB in a file")
    data = bytearray(size)
    with path.open("rb") as file:
        count = file.readinto(data)
    return data[:count] if count < size else data


class PageStack:
    """The pages of a TIFF or Netpbm file, which have no clock: one is one interval."""

    interval_s = IMAGE_INTERVAL_S

    def __init__(self, path: Path, data: bytearray, pages: Pages) -> None:
        self._path, self._data, self._pages = path, data, pages
        self.times = [float(number) for number in range(len(pages))]

    def read(self, index: int) -> Array:
        """The pixels of a page; raises PictureError."""
        name, place = f"{self._path.name}, page {index + 1}", self._pages.places[index]
        is_tiff = self._pages.kind == "TIFF"
        if is_tiff:
            begin_with(self._data, place)
        size = declared_size(self._data if is_tiff else self._data[place : place + 4096])
        if size is None:
            raise PictureError(f"{name}: not a readable image")
        check_size(name, *size)
        return decode(name, np.frombuffer(self._data, np.uint8)[0 if is_tiff else place :])


def begin_with(data: bytearray, directory: int) -> None:
    """Make the page of a directory the first one of a TIFF, which is the one that decoders read."""
    order = "<" if data[:2] == b"II" else ">"
    is_big = unpack_from(f"{order}H", data, 2)[0] == 43
    pack_into(f"{order}{'Q' if is_big else 'I'}", data, 8 if is_big else 4, directory)


class Animation:
    """The frames of an animated WebP, with the times for which they are shown.

    Raises:
        PictureError: this version of OpenCV cannot read it.
    """

    def __init__(self, path: Path, data: bytearray, pages: Pages) -> None:
        import cv2

        if not hasattr(cv2, "imdecodeanimation"):
            raise PictureError(
                f"{path.name}: {len(pages)} frames of an animated WebP, which OpenCV {cv2.__version__} does "
                "not read; 4.12 does, or convert it into an animated PNG or GIF"
            )
        self._path, self._data, self._count = path, data, len(pages)
        size = declared_size(bytes(data[:64]))
        check_size(path.name, *(size or (1, 1)))
        self._at_once = max(1, AT_ONCE_PIXELS // math.prod(size or (1, 1)))
        shown = [ms if ms > LEAST_MS else USUAL_MS for ms in _durations(data)]
        usual = sorted(shown)[(len(shown) - 1) // 2]
        self.interval_s = usual / 1000.0
        self.times = [ms / usual for ms in accumulate(shown[:-1], initial=0)]
        self._first, self._frames = 0, ()

    def read(self, index: int) -> Array:
        """The pixels of a frame; raises PictureError."""
        import cv2

        if not self._first <= index < self._first + len(self._frames):
            data = np.frombuffer(self._data, np.uint8)
            try:
                _, found = cv2.imdecodeanimation(data, start=index, count=self._at_once)
            except cv2.error as failed:
                raise PictureError(f"{self._path.name}: {str(failed).strip()}") from failed
            self._first, self._frames = index, tuple(found.frames)
        if not self._frames:
            raise PictureError(f"{self._path.name}, frame {index}: not a readable image")
        return self._frames[index - self._first]


def _durations(data: bytearray) -> list[int]:
    """Milliseconds of each frame."""
    at, found = 12, []
    while at + 8 <= len(data):
        kind, length = unpack_from("<4sI", data, at)
        if kind == b"ANMF" and at + 24 <= len(data):
            found.append(int.from_bytes(data[at + 20 : at + 23], "little"))
        elif kind == b"ANMF":
            found.append(0)
        at += 8 + length + length % 2
    return found
