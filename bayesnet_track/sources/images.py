"""Image files as a source: their order and times, files of several images, and sequences that names form."""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import accumulate, pairwise
from pathlib import Path
from struct import pack_into, unpack_from
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.image_files import (
    Pages,
    PictureError,
    check_size,
    declared_size,
    decode,
    may_hold_several,
    pages_of,
    read_pixels,
)
from bayesnet_track.sources.entrances.levels import Levels, ValueRange
from bayesnet_track.sources.entrances.notices import few, notice
from bayesnet_track.sources.paths import OTHER_IMAGES, SourceError, is_junk, natural_key
from bayesnet_track.sources.timing import Damage, Picture

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
        """Time of each, in intervals from 0."""

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
            _begin_with(self._data, place)
        size = declared_size(self._data if is_tiff else self._data[place : place + 4096])
        if size is None:
            raise PictureError(f"{name}: not a readable image")
        check_size(name, *size)
        return decode(name, np.frombuffer(self._data, np.uint8)[0 if is_tiff else place :])


def _begin_with(data: bytearray, directory: int) -> None:
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
        durations_ms = [ms if ms > LEAST_MS else USUAL_MS for ms in _durations(data)]
        usual_ms = sorted(durations_ms)[(len(durations_ms) - 1) // 2]
        self.interval_s = usual_ms / 1000.0
        self.times = [ms / usual_ms for ms in accumulate(durations_ms[:-1], initial=0)]
        self._first, self._frames = 0, ()

    def read(self, index: int) -> Array:
        """The pixels of a frame; raises PictureError."""
        import cv2

        if not self._first <= index < self._first + len(self._frames):
            data = np.frombuffer(self._data, np.uint8)
            try:
                _, animation = cv2.imdecodeanimation(data, start=index, count=self._at_once)
            except cv2.error as failed:
                raise PictureError(f"{self._path.name}: {str(failed).strip()}") from failed
            self._first, self._frames = index, tuple(animation.frames)
        if not self._frames:
            raise PictureError(f"{self._path.name}, frame {index}: not a readable image")
        return self._frames[index - self._first]


def _durations(data: bytearray) -> list[int]:
    """Milliseconds of each frame."""
    offset, durations = 12, []
    while offset + 8 <= len(data):
        kind, length = unpack_from("<4sI", data, offset)
        if kind == b"ANMF" and offset + 24 <= len(data):
            durations.append(int.from_bytes(data[offset + 20 : offset + 23], "little"))
        elif kind == b"ANMF":
            durations.append(0)
        offset += 8 + length + length % 2
    return durations


LEAST_ALIKE, MOST_STRAYS = 3, 3
"""Names that make a usual form, and how many of them there are to a stray one at least."""
_LAST_NUMBER = re.compile(r"^(.*?)(\d+)(\D*)$")


def check_names(text: str, paths: Sequence[Path]) -> None:
    """Refuse images of a folder that are two sequences; say so of a pattern, which was chosen.

    Sequences of which the names differ in digits alone may be one, with the time in the names: a notice.

    Raises:
        SourceError: names both sequences, and patterns for them.
    """
    sequences = overlapping_sequences(paths)
    if not sequences:
        return
    words = ", ".join(f"{name} ({count} images)" for name, count in list(sequences.items())[:3])
    folder = Path(text) if Path(text).is_dir() else None
    is_like = len({re.sub(r"\d+", "0", name) for name in sequences}) == 1
    if folder is None or is_like:
        notice(
            f"{text}: {len(sequences)} sequences with the same numbers are read one after the other: {words}"
        )
        return
    place = paths[0].parent
    patterns = " or ".join(f"'{place / name}'" for name in list(sequences)[:2])
    raise SourceError(
        text,
        f"{len(sequences)} sequences with the same numbers in one folder: {words}",
        "images of one camera in a folder",
        f"give one of them, {patterns}, or all in the order of their names, '{place / '*'}'",
    )


def overlapping_sequences(paths: Sequence[Path]) -> dict[str, int]:
    """Pattern -> images, of the sequences that share numbers with another one; empty where none do.

    >>> overlapping_sequences([Path(name) for name in ("l_1.png", "l_2.png", "r_1.png", "r_2.png")])
    {'l_*.png': 2, 'r_*.png': 2}
    >>> overlapping_sequences([Path("a_1.png"), Path("a_2.png"), Path("b_3.png"), Path("b_4.png")])
    {}
    """
    numbers: dict[tuple[str, str], list[int]] = defaultdict(list)
    for path in paths:
        named = _LAST_NUMBER.match(path.stem)
        if named is not None:
            numbers[f"{named[1]}*{named[3]}{path.suffix}", str(path.parent)].append(int(named[2]))
    sequences = {key: values for key, values in numbers.items() if len(values) > 1}
    counts: dict[int, int] = defaultdict(int)
    for values in sequences.values():
        for value in set(values):
            counts[value] += 1
    shared = {value for value, times in counts.items() if times > 1}
    # Numbers at the end of one part and the start of the next one may meet by chance.
    return {
        name: len(values)
        for (name, _), values in sequences.items()
        if 2 * len(shared.intersection(values)) > len(values)
    }


def say_strays(text: str, paths: Sequence[Path]) -> None:
    """Say which images are named otherwise than most are, as a cover or a copy `0003 (1).png`: frames, too.

    Names are of one form where they differ in digits alone.
    """
    forms = [re.sub(r"\d+", "0", path.stem) for path in paths]
    common_form, count = Counter(forms).most_common(1)[0]
    strays = [path.name for path, form in zip(paths, forms, strict=True) if form != common_form]
    if strays and "0" in common_form and count >= LEAST_ALIKE and len(strays) <= count / MOST_STRAYS:
        like = next(path.name for path, form in zip(paths, forms, strict=True) if form == common_form)
        notice(
            f"{text}: {len(strays)} of {len(paths)} images are named otherwise than {like} and the others, "
            f"and are frames in the order of names: {few(strays)}; move away what is no frame"
        )


def say_other_images(text: str, folder: Path) -> None:
    """Say which images of a folder are of a format that is not read."""
    unread = sorted(
        path.name for path in folder.iterdir() if path.suffix.lower() in OTHER_IMAGES and not is_junk(path)
    )
    if unread:
        notice(f"{text}: not read, as of a format that is not read in a folder of images: {few(unread)}")


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
    upright = cv2.imdecode(encoded, cv2.IMREAD_COLOR)
    if stored is None or upright is None or np.array_equal(stored, upright):
        return
    (rows, columns), (shown_rows, shown_columns) = stored.shape[:2], upright.shape[:2]
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
    steps = [later - earlier for earlier, later in pairwise(numbers)]
    if len(numbers) != len(paths) or not steps or min(steps) <= 0:
        return plain
    median_step = sorted(steps)[(len(steps) - 1) // 2]
    return [(number - numbers[0]) / median_step for number in numbers]
