"""How large an image file says that it is, read from its header before it is decoded.

A file of a megabyte may declare a billion pixels, which a decoder allocates before it finds out. What is read
is what the decoder itself goes by; where a file may say it more than once, the largest counts. Of JPEG, PNG,
BMP, TIFF, WebP, the Netpbm formats and JPEG 2000; no other is decoded.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from struct import Struct, error, unpack_from

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
    """Whether the end of a JPEG or PNG is missing: OpenCV fills it with gray or black and says nothing."""
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
        return _tiff(data)
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return _webp(data)
    if head.startswith(b"P7"):
        sides = [(name, int(side)) for name, side in _PAM.findall(data[:4096])]
        widths = [side for name, side in sides if name == b"WIDTH"]
        heights = [side for name, side in sides if name == b"HEIGHT"]
        return [(max(widths), max(heights))] if widths and heights else []
    if head[:1] == b"P":
        found = _PNM.match(data[:4096])
        return [(int(found[1]), int(found[2]))] if found else []
    if head[4:8] == b"jP  " or head.startswith(b"\xff\x4f\xff\x51"):
        # Right, bottom, left, top of the image on its canvas, in the codestream: what the box says is a copy.
        grids = [unpack_from(">4I", data, at.start() + 8) for at in re.finditer(b"\xff\x4f\xff\x51", data)]
        return [(max(right - left, 0), max(bottom - top, 0)) for right, bottom, left, top in grids]
    return []


def _jpeg(data: bytes | bytearray) -> Iterator[Size]:
    """Of the first frame header: a decoder refuses a second one."""
    at = 2
    while (at := data.find(b"\xff", at)) >= 0 and at + 4 <= len(data):
        marker = data[at + 1]
        if marker in (0x00, 0xFF) or marker in _JPEG_ALONE:
            at += 1 if marker == 0xFF else 2
        elif marker in _JPEG_FRAMES:
            height, width = unpack_from(">HH", data, at + 5)
            yield width, height
            return
        elif marker in (0xD9, 0xDA):  # the end, or pixels before any header
            return
        else:
            at += 2 + max(unpack_from(">H", data, at + 2)[0], 2)


def _bmp(data: bytes | bytearray) -> Iterator[Size]:
    if unpack_from("<I", data, 14)[0] == 12:
        yield unpack_from("<HH", data, 18)
    else:
        width, height = unpack_from("<ii", data, 18)
        yield abs(width), abs(height)  # a negative height begins at the top


def _tiff(data: bytes | bytearray) -> Iterator[Size]:
    """Of the first directory, that of a tile too: a tile is decoded whole, however little of it is seen."""
    order = "<" if data[:2] == b"II" else ">"
    big = data[2:4] in (b"+\0", b"\0+")
    at = unpack_from(f"{order}Q", data, 8)[0] if big else unpack_from(f"{order}I", data, 4)[0]
    if at >= len(data):
        return
    count = unpack_from(f"{order}Q" if big else f"{order}H", data, at)[0]
    entry = Struct(f"{order}HHQ8s" if big else f"{order}HHI4s")
    at += 8 if big else 2
    sides: dict[int, int] = {}
    for number in range(min(count, 65536)):
        tag, kind, _, raw = entry.unpack_from(data, at + number * entry.size)
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
