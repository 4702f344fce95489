"""Image files: headers checked before anything is decoded; masks of likelihoods of a place.

A file of a megabyte may declare a billion pixels, which a decoder allocates before it finds out. What is read
is what the decoder itself goes by; where a file may say it more than once, the largest counts. Of JPEG, PNG,
BMP, TIFF, WebP, the Netpbm formats and JPEG 2000; no other is decoded.

Of several images in a file decoders give the first one and say nothing of the others.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from math import prod
from pathlib import Path
from struct import Struct, error, unpack_from
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Array, Floats

MAX_PIXELS = 1 << 27
"""Pixels of a picture, of a video as of an image file: 134 million."""
MAX_BYTES = 1 << 29
"""Bytes of an image file: what a picture of so many pixels takes without compression, in colour and more."""

Size = tuple[int, int]
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_ALONE = frozenset({0x01, *range(0xD0, 0xD9)})
_PNM = re.compile(rb"P[1-6](?:\s+|\s*#[^\n]*\n)+(\d{1,18})(?:\s+|\s*#[^\n]*\n)+(\d{1,18})")
_PAM = re.compile(rb"^(WIDTH|HEIGHT)\s+(\d{1,18})", re.MULTILINE)
_TIFF_WIDTHS, _TIFF_HEIGHTS = (256, 322), (257, 323)  # of the image, of a tile
_TIFF_TYPES = {1: 1, 3: 2, 4: 4, 16: 8}


def check_size(name: str, width: int, height: int) -> None:
    """Refuse a picture of more than `MAX_PIXELS`; raises PictureError."""
    if width * height > MAX_PIXELS:
        raise PictureError(
            f"{name}: {width}x{height} px; allowed: {MAX_PIXELS:,} pixels; scale it down before"
        )


def declared_size(data: bytes | bytearray) -> Size | None:
    """Width and height of an image in px as its header has it; None where it is none that is known.

    >>> declared_size(b"P5 # a comment" + bytes([10]) + b"640 480 255 ")
    (640, 480)
    """
    try:
        sizes = list(_sizes(data))
    except error:  # the header is cut off
        return None
    if not sizes:
        return None
    return max(width for width, _ in sizes), max(height for _, height in sizes)


def is_cut_off(data: bytes) -> bool:
    """True if the end of a JPEG or PNG is missing, which OpenCV fills with gray or black without a word."""
    if data.startswith(b"\xff\xd8"):
        return data.rfind(b"\xff\xd9") < max(data.rfind(b"\xff\xda"), 2)
    return data.startswith(b"\x89PNG") and b"IEND" not in data[-64:]


def _sizes(data: bytes | bytearray) -> Iterable[Size]:
    head = bytes(data[:16])
    if head.startswith(b"\x89PNG\r\n\x1a\n"):
        return [unpack_from(">II", data, 16)]
    if head.startswith(b"\xff\xd8\xff"):
        return _jpeg(data)
    if head.startswith(b"BM"):
        return _bmp(data)
    if head[:4] in (b"II*\0", b"II+\0", b"MM\0*", b"MM\0+"):
        return _tiff_sizes(data)
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return _webp(data)
    if head.startswith(b"P7"):
        sides = [(name, int(side)) for name, side in _PAM.findall(data[:4096])]
        widths = [side for name, side in sides if name == b"WIDTH"]
        heights = [side for name, side in sides if name == b"HEIGHT"]
        return [(max(widths), max(heights))] if widths and heights else []
    if head[:1] == b"P":
        header = _PNM.match(data[:4096])
        return [(int(header[1]), int(header[2]))] if header else []
    if head[4:8] == b"jP  " or head.startswith(b"\xff\x4f\xff\x51"):
        # Right, bottom, left, top of the image on its canvas, in the codestream: what the box says is a copy.
        grids = [
            unpack_from(">4I", data, marker.start() + 8) for marker in re.finditer(b"\xff\x4f\xff\x51", data)
        ]
        return [(max(right - left, 0), max(bottom - top, 0)) for right, bottom, left, top in grids]
    return []


def _jpeg(data: bytes | bytearray) -> Iterator[Size]:
    """Of the first frame header: a decoder refuses a second one."""
    offset = 2
    while (offset := data.find(b"\xff", offset)) >= 0 and offset + 4 <= len(data):
        marker = data[offset + 1]
        if marker in (0x00, 0xFF) or marker in _JPEG_ALONE:
            offset += 1 if marker == 0xFF else 2
        elif marker in _JPEG_FRAMES:
            height, width = unpack_from(">HH", data, offset + 5)
            yield width, height
            return
        elif marker in (0xD9, 0xDA):  # the end, or pixels before any header
            return
        else:
            offset += 2 + max(unpack_from(">H", data, offset + 2)[0], 2)


def _bmp(data: bytes | bytearray) -> Iterator[Size]:
    if unpack_from("<I", data, 14)[0] == 12:
        yield unpack_from("<HH", data, 18)
    else:
        width, height = unpack_from("<ii", data, 18)
        yield abs(width), abs(height)  # a negative height begins at the top


def _tiff_sizes(data: bytes | bytearray) -> Iterator[Size]:
    """Of the first directory, that of a tile too: a tile is decoded whole, however little of it is seen."""
    order = "<" if data[:2] == b"II" else ">"
    big = data[2:4] in (b"+\0", b"\0+")
    offset = unpack_from(f"{order}Q", data, 8)[0] if big else unpack_from(f"{order}I", data, 4)[0]
    if offset >= len(data):
        return
    count = unpack_from(f"{order}Q" if big else f"{order}H", data, offset)[0]
    entry = Struct(f"{order}HHQ8s" if big else f"{order}HHI4s")
    offset += 8 if big else 2
    sides: dict[int, int] = {}
    for number in range(min(count, 65536)):
        tag, kind, _, raw = entry.unpack_from(data, offset + number * entry.size)
        length = _TIFF_TYPES.get(kind)
        if tag in _TIFF_WIDTHS + _TIFF_HEIGHTS and length is not None and length <= len(raw):
            side = int.from_bytes(raw[:length], "little" if order == "<" else "big")
            sides[tag] = max(side, sides.get(tag, 0))
    if 256 in sides and 257 in sides:
        yield max(sides.get(tag, 0) for tag in _TIFF_WIDTHS), max(sides.get(tag, 0) for tag in _TIFF_HEIGHTS)


def _webp(data: bytes | bytearray) -> Iterator[Size]:
    kind = data[12:16]
    if kind == b"VP8X":
        yield 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    elif kind == b"VP8L":
        bits = unpack_from("<I", data, 21)[0]
        yield 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    elif kind == b"VP8 ":
        width, height = unpack_from("<HH", data, 26)
        yield width & 0x3FFF, height & 0x3FFF


class PictureError(ValueError):
    """One picture that cannot be decoded."""


Bytes = bytes | bytearray
_TIFF = (b"II*\0", b"II+\0", b"MM\0*", b"MM\0+")
_NETPBM_KINDS = (b"P4", b"P5", b"P6")
MOST_PAGES = 1 << 20
_SUBFILE_TYPE, _DESCRIPTION, _SUBFILES = 254, 270, 0b101  # a thumbnail or a mask of another page
_NETPBM = re.compile(rb"(P[456])(?:\s+|\s*#[^\n]*\n)+(\d{1,9})(?:\s+|\s*#[^\n]*\n)+(\d{1,9})")
_LARGEST_VALUE = re.compile(rb"(?:\s+|\s*#[^\n]*\n)+(\d{1,5})\s")
_AXES = {
    "channels": (r"\bchannels=(\d+)", r'\bSizeC="(\d+)"'),
    "slices": (r"\bslices=(\d+)", r'\bSizeZ="(\d+)"'),
    "times": (r"\bframes=(\d+)", r'\bSizeT="(\d+)"'),
}


@dataclass(frozen=True)
class Pages:
    """The images of a file.

    Attributes:
        kind: format of the file.
        places: of each image of a TIFF its directory, of a Netpbm file its header; of others their number.
    """

    kind: Literal["TIFF", "Netpbm", "PNG", "WebP"]
    places: tuple[int, ...]

    def __len__(self) -> int:
        """Number of images."""
        return len(self.places)


def may_hold_several(head: bytes) -> bool:
    """True if a file that begins so is of a format in which several images are pages or WebP frames."""
    return head[:4] in _TIFF or head[:2] in _NETPBM_KINDS or (head[:4] == b"RIFF" and head[8:12] == b"WEBP")


def pages_of(name: str, data: Bytes) -> Pages | None:
    """The images in a file where there are several; None where there is one, or it is no such file.

    Raises:
        PictureError: what the file says of its images fits two readings.
    """
    head = bytes(data[:16])
    try:
        if head[:4] in _TIFF:
            pages = Pages("TIFF", _tiff_pages(name, data))
        elif head.startswith(b"\x89PNG\r\n\x1a\n"):
            pages = Pages("PNG", tuple(range(_animation_control(data))))
        elif head[:4] == b"RIFF" and head[8:12] == b"WEBP":
            pages = Pages("WebP", tuple(range(sum(kind == b"ANMF" for kind in _riff_chunks(data)))))
        elif head[:2] in _NETPBM_KINDS:
            pages = Pages("Netpbm", tuple(_netpbm(data)))
        else:
            return None
    except error:  # cut off: the decoder says so
        return None
    return pages if len(pages) > 1 else None


def refuse_pages(name: str, data: Bytes) -> None:
    """Refuse a file of several images where one is needed; raises PictureError."""
    pages = pages_of(name, data)
    if pages is not None:
        raise PictureError(
            f"{name}: {len(pages)} images in one {pages.kind} file; allowed here: one image in a file; "
            "split it, or give it alone as the source"
        )


def _tiff_pages(name: str, data: Bytes) -> tuple[int, ...]:
    """Offsets of the directories of whole images; raises PictureError, struct.error."""
    order = "<" if data[:2] == b"II" else ">"
    is_big = bytes(data[2:4]) in (b"+\0", b"\0+")
    pointer = Struct(f"{order}Q" if is_big else f"{order}I")
    count_of = Struct(f"{order}Q" if is_big else f"{order}H")
    entry = Struct(f"{order}HHQ8s" if is_big else f"{order}HHI4s")
    offset = pointer.unpack_from(data, 8 if is_big else 4)[0]
    visited: set[int] = set()
    pages: list[int] = []
    description = ""
    while offset and offset not in visited and offset < len(data) and len(visited) < MOST_PAGES:
        visited.add(offset)
        first = offset + count_of.size
        end = first + min(count_of.unpack_from(data, offset)[0], 65536) * entry.size
        tags = {}
        for tag, _, length, raw in entry.iter_unpack(data[first:end]):
            tags[tag] = (length, raw)
        subfile = tags.get(_SUBFILE_TYPE, (1, b"\0" * 4))[1][:4]
        if not unpack_from(f"{order}I", subfile)[0] & _SUBFILES:
            if not pages and _DESCRIPTION in tags:
                length, raw = tags[_DESCRIPTION]
                start = pointer.unpack_from(raw)[0]
                description = bytes(data[start : start + length]).decode("utf-8", "replace")
            pages.append(offset)
        offset = pointer.unpack_from(data, end)[0] if end + pointer.size <= len(data) else 0
    _check_axes(name, description, len(pages))
    return tuple(pages)


def _check_axes(name: str, description: str, pages: int) -> None:
    """Refuse a stack whose description (ImageJ, OME) has more axes than time, or more images than pages."""
    axes = {}
    for axis, patterns in _AXES.items():
        sizes = (re.search(pattern, description) for pattern in patterns)
        axes[axis] = next((int(size[1][:9]) for size in sizes if size is not None), 1)
    images = re.search(r"^ImageJ=.*?^images=(\d+)", description, re.MULTILINE | re.DOTALL)
    if images is not None and int(images[1][:9]) > pages:
        raise PictureError(
            f"{name}: its description says images={images[1]}, and it has {pages} pages; "
            "allowed: a page for each image; save it anew as an image sequence"
        )
    long_axes = {axis: size for axis, size in axes.items() if size > 1}
    if pages > 1 and prod(long_axes.values()) == pages and (len(long_axes) > 1 or "channels" in long_axes):
        shape = ", ".join(f"{size} {axis}" for axis, size in long_axes.items())
        raise PictureError(
            f"{name}: its {pages} pages are {shape} by its description, and which of them follow each other "
            "in time is open; allowed: one axis, time; save one channel and one slice as a stack of its own"
        )


def _animation_control(data: Bytes) -> int:
    """Frames that a PNG says it has in its animation; 1 without one."""
    offset = 8
    while offset + 8 <= len(data):
        length, kind = unpack_from(">I4s", data, offset)
        if kind == b"acTL":
            return int(unpack_from(">I", data, offset + 8)[0])
        if kind in (b"IDAT", b"IEND"):
            break
        offset += 12 + length
    return 1


def _riff_chunks(data: Bytes) -> Iterator[bytes]:
    offset = 12
    while offset + 8 <= len(data):
        kind, length = unpack_from("<4sI", data, offset)
        yield kind
        offset += 8 + length + length % 2


def _netpbm(data: Bytes) -> Iterator[int]:
    """Offsets at which images begin; an image without a valid header ends the file."""
    offset = 0
    while offset < len(data):
        head = bytes(data[offset : offset + 4096])
        header = _NETPBM.match(head)
        if header is None:
            return
        kind, width, height = header[1], int(header[2]), int(header[3])
        end, row = header.end() + 1, -(-width // 8)
        if kind != b"P4":
            largest = _LARGEST_VALUE.match(head, header.end())
            if largest is None:
                return
            end = largest.end()
            row = width * (3 if kind == b"P6" else 1) * (2 if int(largest[1]) > 255 else 1)
        yield offset
        offset += end + row * height
        while offset < len(data) and bytes(data[offset : offset + 1]).isspace():
            offset += 1


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
        is_number = ~(np.isnan(x) | np.isnan(y))
        x = np.clip(np.where(is_number, x, 0.0), 0.0, columns - 1.0)
        y = np.clip(np.where(is_number, y, 0.0), 0.0, rows - 1.0)
        left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
        right, bottom = np.minimum(left + 1, columns - 1), np.minimum(top + 1, rows - 1)
        dx, dy = x - left, y - top
        upper = self.gray[top, left] * (1.0 - dx) + self.gray[top, right] * dx
        lower = self.gray[bottom, left] * (1.0 - dx) + self.gray[bottom, right] * dx
        return np.where(is_number, (upper * (1.0 - dy) + lower * dy) / 255.0, np.nan)


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
