"""Reading image files of one image: nothing is decoded before its size and its pages are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.image_pages import refuse_pages
from bayesnet_track.observation.image_size import (
    MAX_BYTES,
    PictureError,
    check_size,
    declared_size,
    is_cut_off,
)


def read_checked(path: Path) -> bytes:
    """The bytes of an image file of a size that may be decoded.

    Raises:
        PictureError: it cannot be read, is of no known format, is larger than `MAX_BYTES` or `MAX_PIXELS`, or
            holds several images.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1) if path.stat().st_size <= MAX_BYTES else None
    except OSError as failed:
        raise PictureError(f"{path.name}: {failed.strerror}") from failed
    if data is None or len(data) > MAX_BYTES:
        raise PictureError(f"{path.name}: an image file has at most {MAX_BYTES >> 20} MB; this one is larger")
    size = declared_size(data)
    if size is None:
        raise PictureError(f"{path.name}: not a readable image")
    check_size(path.name, *size)
    refuse_pages(path.name, data)
    return data


def read_pixels(path: Path) -> tuple[bytes, Array]:
    """The bytes of an image file, and the pixels in it as they are: (H, W) or (H, W, C).

    Raises:
        PictureError: as of `read_checked`; or it is cut off, or cannot be decoded.
    """
    data = read_checked(path)
    if is_cut_off(data):
        raise PictureError(f"{path.name}: the image is cut off")
    return data, decode(path.name, np.frombuffer(data, dtype=np.uint8))


def decode(name: str, data: NDArray[np.uint8]) -> Array:
    """The pixels of the first image in the bytes of a file, as they are; raises PictureError."""
    import cv2

    try:
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except cv2.error as failed:
        raise PictureError(f"{name}: {str(failed).strip()}") from failed
    if image is None:
        raise PictureError(f"{name}: not a readable image")
    return np.asarray(image)
