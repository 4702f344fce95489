"""Image files of one image, decoded after their headers are checked; masks of likelihoods of a place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Array, Floats
from bayesnet_track.observation.image_headers import (
    MAX_BYTES,
    PictureError,
    check_size,
    declared_size,
    is_cut_off,
    refuse_pages,
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


@dataclass(frozen=True, eq=False)
class Mask:
    """The gray values of an image file.

    Attributes:
        path: the file.
        sha256: of its bytes, in hexadecimal.
        gray: (H, W) uint8.
    """

    path: Path
    sha256: str
    gray: NDArray[np.uint8]

    def __str__(self) -> str:
        """File and size."""
        rows, columns = self.gray.shape
        return f"{self.path.name}, {columns}x{rows} px"

    def __call__(self, x: Floats, y: Floats) -> Floats:
        """Grey value / 255 at points of the frame, between the four pixels around each (bilinear).

        Pixels have their centres at whole numbers; beyond the outermost ones counts the nearest point of the
        border. NaN where a coordinate is.
        """
        rows, columns = self.gray.shape
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        known = ~(np.isnan(x) | np.isnan(y))
        x = np.clip(np.where(known, x, 0.0), 0.0, columns - 1.0)
        y = np.clip(np.where(known, y, 0.0), 0.0, rows - 1.0)
        left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
        right, bottom = np.minimum(left + 1, columns - 1), np.minimum(top + 1, rows - 1)
        over, down = x - left, y - top
        above = self.gray[top, left] * (1.0 - over) + self.gray[top, right] * over
        below = self.gray[bottom, left] * (1.0 - over) + self.gray[bottom, right] * over
        return np.where(known, (above * (1.0 - down) + below * down) / 255.0, np.nan)


def read_mask(path: Path) -> Mask:
    """The mask in an image file: 8 bits, colour counts as its gray value.

    Raises:
        PictureError: it cannot be read, is no image, is cut off, or is too large (`image_size`).
    """
    import cv2

    if path.exists() and not path.is_file():  # a pipe might never end
        raise PictureError(f"{path.name}: no plain file")
    data, image = read_pixels(path)
    if image.dtype != np.uint8:
        raise PictureError(f"{path.name}: values of {8 * image.itemsize} bits; allowed: 8 bits")
    if image.ndim == 3 and image.shape[2] == 4:
        raise PictureError(f"{path.name}: transparency; allowed: gray or colour without an alpha channel")
    if image.ndim == 3 and image.shape[2] == 3:
        image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    gray = np.ascontiguousarray(image.reshape(image.shape[:2]), dtype=np.uint8)
    return Mask(path, sha256(data).hexdigest(), gray)


class AnyMask(Mapping[str, Mask]):
    """One for every name, of a single pixel: to show a graph, not run it."""

    def __getitem__(self, name: str) -> Mask:
        """A white pixel."""
        return Mask(Path(name), "", np.full((1, 1), 255, dtype=np.uint8))

    def __iter__(self) -> Iterator[str]:
        """Nothing: there is one for every name."""
        return iter(())

    def __len__(self) -> int:
        """0."""
        return 0

    def __contains__(self, name: object) -> bool:
        """Always."""
        return True
