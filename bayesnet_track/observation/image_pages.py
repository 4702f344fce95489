"""How many images an image file holds, and where: pages of TIFF and Netpbm, frames of animated PNG and WebP.

Decoders give the first one and say nothing of the others.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from math import prod
from struct import Struct, error, unpack_from
from typing import Literal

from bayesnet_track.observation.image_size import PictureError

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
        """How many."""
        return len(self.places)


def may_hold_several(head: bytes) -> bool:
    """Whether a file that begins so is of a format in which several images are pages or WebP frames."""
    return head[:4] in _TIFF or head[:2] in _NETPBM_KINDS or (head[:4] == b"RIFF" and head[8:12] == b"WEBP")


def pages_of(name: str, data: Bytes) -> Pages | None:
    """The images in a file where there are several; None where there is one, or it is no such file.

    Raises:
        PictureError: what the file says of its images fits two readings.
    """
    head = bytes(data[:16])
    try:
        if head[:4] in _TIFF:
            pages = Pages("TIFF", _tiff(name, data))
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


def _tiff(name: str, data: Bytes) -> tuple[int, ...]:
    """Offsets of the directories of whole images; raises PictureError, struct.error."""
    order = "<" if data[:2] == b"II" else ">"
    is_big = bytes(data[2:4]) in (b"+\0", b"\0+")
    pointer = Struct(f"{order}Q" if is_big else f"{order}I")
    count_of = Struct(f"{order}Q" if is_big else f"{order}H")
    entry = Struct(f"{order}HHQ8s" if is_big else f"{order}HHI4s")
    at = pointer.unpack_from(data, 8 if is_big else 4)[0]
    seen: set[int] = set()
    found: list[int] = []
    description = ""
    while at and at not in seen and at < len(data) and len(seen) < MOST_PAGES:
        seen.add(at)
        first = at + count_of.size
        end = first + min(count_of.unpack_from(data, at)[0], 65536) * entry.size
        tags = {}
        for tag, _, length, raw in entry.iter_unpack(data[first:end]):
            tags[tag] = (length, raw)
        subfile = tags.get(_SUBFILE_TYPE, (1, b"\0" * 4))[1][:4]
        if not unpack_from(f"{order}I", subfile)[0] & _SUBFILES:
            if not found and _DESCRIPTION in tags:
                length, raw = tags[_DESCRIPTION]
                start = pointer.unpack_from(raw)[0]
                description = bytes(data[start : start + length]).decode("utf-8", "replace")
            found.append(at)
        at = pointer.unpack_from(data, end)[0] if end + pointer.size <= len(data) else 0
    _check_axes(name, description, len(found))
    return tuple(found)


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
    several = {axis: size for axis, size in axes.items() if size > 1}
    if pages > 1 and prod(several.values()) == pages and (len(several) > 1 or "channels" in several):
        shape = ", ".join(f"{size} {axis}" for axis, size in several.items())
        raise PictureError(
            f"{name}: its {pages} pages are {shape} by its description, and which of them follow each other "
            "in time is open; allowed: one axis, time; save one channel and one slice as a stack of its own"
        )


def _animation_control(data: Bytes) -> int:
    """Frames that a PNG says it has in its animation; 1 without one."""
    at = 8
    while at + 8 <= len(data):
        length, kind = unpack_from(">I4s", data, at)
        if kind == b"acTL":
            return int(unpack_from(">I", data, at + 8)[0])
        if kind in (b"IDAT", b"IEND"):
            break
        at += 12 + length
    return 1


def _riff_chunks(data: Bytes) -> Iterator[bytes]:
    at = 12
    while at + 8 <= len(data):
        kind, length = unpack_from("<4sI", data, at)
        yield kind
        at += 8 + length + length % 2


def _netpbm(data: Bytes) -> Iterator[int]:
    """Where each image begins; an image whose header is none ends the file."""
    at = 0
    while at < len(data):
        head = bytes(data[at : at + 4096])
        found = _NETPBM.match(head)
        if found is None:
            return
        kind, width, height = found[1], int(found[2]), int(found[3])
        end, row = found.end() + 1, -(-width // 8)
        if kind != b"P4":
            largest = _LARGEST_VALUE.match(head, found.end())
            if largest is None:
                return
            end = largest.end()
            row = width * (3 if kind == b"P6" else 1) * (2 if int(largest[1]) > 255 else 1)
        yield at
        at += end + row * height
        while at < len(data) and bytes(data[at : at + 1]).isspace():
            at += 1
