"""Image files as a source: their order and their times; also a single file that holds several images."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.image_files import read_pixels
from bayesnet_track.observation.image_size import PictureError
from bayesnet_track.sources.entrances.levels import Levels, ValueRange
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.entrances.stacks import IMAGE_INTERVAL_S, stack_of
from bayesnet_track.sources.paths import natural_key
from bayesnet_track.sources.readers import Damage, Picture

_LAST_NUMBER = re.compile(r"^(.*?)(\d+)(\D*)$")


class ImageReader:
    """Images in natural order (2 before 10).

    Images have no clock: one image is one interval, counted as 1/25 s. Where all names differ only in their
    last number and the numbers grow, the numbers are the times, in units of their usual (median) step: of
    00001, 00002, 00007 the times are 0, 1, 6. Of a single file with several images each is a picture.

    Raises:
        SourceError: a file of several images cannot be read.
    """

    gap_from = 1.5

    def __init__(self, text: str, paths: Sequence[Path], value_range: ValueRange | None = None) -> None:
        self.paths = sorted(paths, key=natural_key)
        self.value_range, self._is_first = value_range, True
        self._levels = Levels(text, value_range)
        self.stack = stack_of(self.paths[0]) if len(self.paths) == 1 else None
        self.times = times_of(self.paths) if self.stack is None else self.stack.times
        self.frame_interval_s = IMAGE_INTERVAL_S if self.stack is None else self.stack.interval_s
        self.declared_frames: int | None = len(self.times)

    def __iter__(self) -> Iterator[Picture | Damage]:
        for index, time in enumerate(self.times):
            yield Picture(index, time, time * self.frame_interval_s, partial(self._pixels, index))

    def _pixels(self, index: int) -> tuple[NDArray[np.uint8], bool]:
        path = self.paths[0 if self.stack else index]
        if self.stack is not None:
            return _named(path, self._levels, self.stack.read(index))
        data, image = read_pixels(path)
        if self._is_first:
            say_orientation(path.name, data)
        self._is_first = False
        return _named(path, self._levels, image)

    def close(self) -> None:
        """Nothing stays open between images."""


def say_orientation(name: str, data: bytes) -> None:
    """Say that a camera's note on how to turn its image is not applied: pixels count as they are stored.

    `data` are the bytes of the file: OpenCV takes no path that is not text.
    """
    import cv2

    encoded = np.frombuffer(data, dtype=np.uint8)
    stored = cv2.imdecode(encoded, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    shown = cv2.imdecode(encoded, cv2.IMREAD_COLOR)
    if stored is None or shown is None or np.array_equal(stored, shown):
        return
    (rows, columns), (shown_rows, shown_columns) = stored.shape[:2], shown.shape[:2]
    notice(
        f"{name}: the file notes how its image is to be turned (EXIF orientation): viewers and "
        f"cv2.imread show {shown_columns}x{shown_rows} px, frames and boxes are of the {columns}x{rows} px "
        "that are stored"
    )


def read_image(path: Path) -> tuple[NDArray[np.uint8], bool]:
    """The image at `path` as ((H, W, 3) uint8 BGR, has_color), by the rules of `to_bgr`.

    Raises:
        PictureError: it cannot be read, is too large (`image_size`), is cut off, is one of several in its
            file, or holds values other than 8 or 16 bit.
    """
    return _named(path, Levels(path.name), read_pixels(path)[1])


def _named(path: Path, levels: Levels, image: Array) -> tuple[NDArray[np.uint8], bool]:
    try:
        return levels(image)
    except PictureError as error:
        raise PictureError(f"{path.name}: {error}") from error


def times_of(paths: Sequence[Path]) -> list[float]:
    """The times of images in natural order, from 0, in units of the usual step of their numbers.

    >>> times_of([Path("00001.png"), Path("00002.png"), Path("00007.png"), Path("00008.png")])
    [0.0, 1.0, 6.0, 7.0]
    >>> times_of([Path("a.png"), Path("b.png")])
    [0.0, 1.0]
    """
    named = [_LAST_NUMBER.match(path.stem) for path in paths]
    plain = [float(index) for index in range(len(paths))]
    if (
        len(
            {
                (path.parent, m.group(1), m.group(3)) if m else None
                for path, m in zip(paths, named, strict=True)
            }
        )
        != 1
    ):
        return plain
    numbers = [int(m.group(2)) for m in named if m]
    steps = [after - before for before, after in pairwise(numbers)]
    if len(numbers) != len(paths) or not steps or min(steps) <= 0:
        return plain
    usual = sorted(steps)[(len(steps) - 1) // 2]
    return [(number - numbers[0]) / usual for number in numbers]
