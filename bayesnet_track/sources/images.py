"""Image files as a source: their order, their times, and how any image becomes 8-bit BGR."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.observation.image_size import PictureError, read_pixels
from bayesnet_track.sources.paths import natural_key
from bayesnet_track.sources.readers import Damage, Picture

IMAGE_INTERVAL_S = 1.0 / 25.0
ROWS_AT_ONCE = 256
_LAST_NUMBER = re.compile(r"^(.*?)(\d+)(\D*)$")


class ImageReader:
    """Images in natural order (2 before 10).

    Images have no clock: one image is one interval, counted as 1/25 s. Where all names differ only in their
    last number and the numbers grow, the numbers are the times, in units of their usual (median) step: of
    00001, 00002, 00007 the times are 0, 1, 6.
    """

    gap_from = 1.5
    frame_interval_s = IMAGE_INTERVAL_S

    def __init__(self, text: str, paths: Sequence[Path]) -> None:
        self.paths = sorted(paths, key=natural_key)
        self.times = times_of(self.paths)
        self.declared_frames: int | None = len(self.paths)

    def __iter__(self) -> Iterator[Picture | Damage]:
        for index, (path, time) in enumerate(zip(self.paths, self.times, strict=True)):
            yield Picture(index, time, time * self.frame_interval_s, partial(read_image, path))

    def close(self) -> None:
        """Nothing stays open between images."""


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


def read_image(path: Path) -> tuple[NDArray[np.uint8], bool]:
    """The image at `path` as ((H, W, 3) uint8 BGR, has_color), by the rules of `to_bgr`.

    Raises:
        PictureError: it cannot be read, is too large (`image_size`), is cut off, or holds values other than
            8 or 16 bit.
    """
    _, image = read_pixels(path)
    try:
        return to_bgr(image)
    except PictureError as error:
        raise PictureError(f"{path.name}: {error}") from error


def to_bgr(image: NDArray[Any]) -> tuple[NDArray[np.uint8], bool]:
    """Any image as ((H, W, 3) uint8 BGR, has_color).

    - 16 bit to 8: ``round(value / 257)``, so that 0 stays 0 and 65535 becomes 255.
    - Gray (H, W) or (H, W, 1): three equal channels, has_color False.
    - Alpha (H, W, 4): laid over black, ``round(value * alpha / 255)``, since the colour below a transparent
      pixel is arbitrary.

    Raises:
        PictureError: values of another type, another number of channels, or no pixel.
    """
    channels = image.shape[-1] if image.ndim == 3 else 1
    known = image.dtype in (np.uint8, np.uint16) and image.ndim in (2, 3) and channels in (1, 3, 4)
    if not known or image.size == 0:
        raise PictureError(
            f"{image.dtype} values of shape {image.shape}; allowed: 8 or 16 bit, 1, 3 or 4 channels"
        )
    if image.dtype == np.uint8 and channels == 3:
        return np.ascontiguousarray(image), True
    bgr = np.empty((*image.shape[:2], 3), np.uint8)
    for top in range(0, len(bgr), ROWS_AT_ONCE):  # the steps between need several times its memory
        rows = slice(top, top + ROWS_AT_ONCE)
        bgr[rows] = _to_bgr(image[rows].reshape(-1, image.shape[1], channels))
    return bgr, channels != 1


def _to_bgr(rows: NDArray[Any]) -> NDArray[np.uint8]:
    if rows.dtype == np.uint16:
        rows = ((rows.astype(np.uint32) + 128) // 257).astype(np.uint8)
    if rows.shape[2] == 4:
        alpha = rows[..., 3:].astype(np.uint16)
        rows = ((rows[..., :3] * alpha + 127) // 255).astype(np.uint8)
    return rows
