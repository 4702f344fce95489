"""Large files of MOT lines, in blocks: an hour of a crowd has too many lines to hold as texts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.sources.entrances.boxes import MOST_LINES, are_corners, usable

LARGE = 1 << 22
"""Bytes from which on a file is read in blocks."""
_BLOCK = 1 << 23
_PLAIN = b"0123456789.,-\n"
_WIDTHS = (7, 9, 10)
"""Columns of lines that can be nothing else than MOT."""
_LARGEST = 2**31


@dataclass(frozen=True, eq=False)
class PlainBoxes:
    """The boxes of a file of plain MOT lines, each of them usable.

    Attributes:
        frames: (N,) int32, from 0.
        ids: (N,) int32.
        boxes: (N, 4) float32 corner boxes in px; in frames of 4K the rounding is below 1/4,000 px.
        confidences: (N,) float32.
    """

    frames: NDArray[Any]
    ids: NDArray[Any]
    boxes: NDArray[Any]
    confidences: NDArray[Any]


def read_plain_boxes(path: str | Path) -> PlainBoxes | None:
    """The boxes of a large file; None of a small one, or where a line is not plain.

    Plain are lines of the same number of columns (7, or 9 or 10 whose last are -1), separated by commas, in
    frames that do not fall, with each identity once in a frame. Whatever else a file holds, `parse_mot` reads
    it, or says what is wrong.

    Raises:
        OSError: it cannot be read.
    """
    if not _is_large(path):
        return None
    with Path(path).open("rb") as file:
        count = sum(block.count(b"\n") for block in iter(lambda: file.read(_BLOCK), b""))
        found = PlainBoxes(
            np.empty(count, np.int32),
            np.empty(count, np.int32),
            np.empty((count, 4), np.float32),
            np.empty(count, np.float32),
        )
        file.seek(0)
        start, last = 0, 0.0
        for rows in _blocks(file):
            if rows is None or not _is_plain(rows, last) or start + len(rows) > count:
                return None
            end, last = start + len(rows), float(rows[-1, 0])
            found.frames[start:end], found.ids[start:end] = rows[:, 0] - 1, rows[:, 1]
            found.boxes[start:end], found.confidences[start:end] = rows[:, 2:6], rows[:, 6]
            start = end
    is_ambiguous = (found.boxes.max(axis=0) <= 1).any() or are_corners(found.boxes[:MOST_LINES].astype(float))
    return None if start < count or is_ambiguous or _has_twins(found) else found


def _is_large(path: str | Path) -> bool:
    try:
        return Path(path).stat().st_size >= LARGE
    except OSError:
        return False  # whoever reads it says what is wrong


def starts_plain(path: str | Path) -> bool:
    """True if a large file begins with plain MOT lines, so that it need not be read to know what it holds.

    Raises:
        OSError: it cannot be read.
    """
    if not _is_large(path):
        return False
    with Path(path).open("rb") as file:
        head, _, _ = file.read(1 << 16).rpartition(b"\n")
    rows = _numbers(head, head.count(b"\n") + 1, head.partition(b"\n")[0].count(b",") + 1)
    return rows is not None and _is_plain(rows, 0.0)


def _has_twins(found: PlainBoxes) -> bool:
    """True if an identity is in a frame twice."""
    keys = (found.frames.astype(np.int64) << 32) + found.ids
    keys.sort()
    return bool((keys[1:] == keys[:-1]).any())


def _blocks(file: BufferedReader) -> Iterator[Floats | None]:
    """(n, columns) the numbers of some lines; None where they are not plain."""
    rest, width = b"", 0
    while block := file.read(_BLOCK):
        whole, newline, tail = (rest + block).rpartition(b"\n")
        rest = tail
        if not newline:
            continue
        lines = whole.count(b"\n") + 1
        width = width or whole.partition(b"\n")[0].count(b",") + 1
        yield _numbers(whole, lines, width)
    if rest:
        yield None


def _numbers(text: bytes, lines: int, width: int) -> Floats | None:
    if width not in _WIDTHS or text.translate(None, _PLAIN):
        return None
    try:
        numbers = np.loadtxt(BytesIO(text), delimiter=",", ndmin=2)
    except ValueError:
        return None
    return numbers if numbers.shape == (lines, width) else None


def _is_plain(rows: Floats, last: float) -> bool:
    frames, ids = rows[:, 0], rows[:, 1]
    others = rows[:, 7:]
    return bool(
        np.isfinite(rows).all()
        and (rows[:, :2] % 1 == 0).all()
        and last <= frames[0]
        and (np.diff(frames) >= 0).all()
        and frames[0] >= 1
        and frames[-1] < _LARGEST
        and (np.abs(ids) < _LARGEST).all()
        and usable(rows[:, 2:6]).all()
        and (others == -1).all()
    )
