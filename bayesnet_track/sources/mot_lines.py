"""The lines of MOT files: frame, identity, box, and what else a line holds, checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Ints

COLUMNS = "frame,id,left,top,width,height,confidence,..."
LEAST, MOST = 6, 10
LARGEST = 2**53
"""Beyond it float64 does not tell whole numbers apart."""


class NotTextError(ValueError):
    """A file that is not text; says which."""


@dataclass(frozen=True, eq=False)
class MotLines:
    """The lines of a MOT file that are not empty, as they stand there.

    Attributes:
        name: the file, for messages.
        numbers: (N,) which line of the file each is, from 1.
        frames: (N,) indices of frames, from 0: one less than in the file.
        ids: (N,) identities.
        boxes: (N, 4) corner boxes left, top, width, height in px.
        rest: (N, 4) the columns 7 to 10; NaN where a line ends before them.
    """

    name: str
    numbers: Ints
    frames: Ints
    ids: Ints
    boxes: Floats
    rest: Floats

    def __len__(self) -> int:
        return len(self.frames)

    def place(self, row: int) -> str:
        """File and line of a row, for messages."""
        return f"{self.name}:{self.numbers[row]}"

    def only(self, keep: NDArray[np.bool_]) -> MotLines:
        """The rows with `keep` (N,)."""
        return MotLines(
            self.name,
            self.numbers[keep],
            self.frames[keep],
            self.ids[keep],
            self.boxes[keep],
            self.rest[keep],
        )


def read_text(path: str | Path) -> str:
    """A whole file as text.

    Raises:
        OSError: it cannot be read.
        NotTextError: it is not text.
    """
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise NotTextError(f"{path}: not a text file") from None


def parse_mot(text: str, name: str = "<mot>") -> MotLines:
    """The lines of a MOT text; `name` stands in error messages. Lines may be in any order, or none.

    Numbers are separated by commas, or else by tabs or spaces: frame (from 1), identity, left, top, width,
    height, and up to four more.

    Raises:
        ValueError: a line is not 6 to 10 such numbers, frame or identity is not a whole number, or the box is
            not finite or empty; says file and line.

    >>> parse_mot("2,7,10,20,41,31,1").frames.tolist()
    [1]
    """
    filled = [(n, line) for n, line in enumerate(text.split("\n"), start=1) if line.strip()]
    rows = np.full((len(filled), MOST), np.nan)
    for row, (number, line) in zip(rows, filled, strict=True):
        values = _numbers(line.strip(), f"{name}:{number}")
        row[: len(values)] = values
    return MotLines(
        name,
        np.array([number for number, _ in filled], dtype=np.int64),
        rows[:, 0].astype(np.int64) - 1,
        rows[:, 1].astype(np.int64),
        rows[:, 2:6],
        rows[:, 6:],
    )


def _numbers(line: str, place: str) -> list[float]:
    words = [word.strip() for word in line.split(",")] if "," in line else line.split()
    if not words[-1]:  # a comma at the end of the line
        words.pop()
    values = [_number(word, place) for word in words]
    if not LEAST <= len(values) <= MOST:
        raise ValueError(f"{place}: {len(values)} numbers; expected {LEAST} to {MOST} ({COLUMNS})")
    for value, what in zip(values, ("frame", "id"), strict=False):
        if not (value.is_integer() and abs(value) < LARGEST):
            raise ValueError(f"{place}: {what} {value:g} is not a whole number")
    if values[0] < 1:
        raise ValueError(f"{place}: frame {values[0]:g}; frames of MOT files count from 1")
    box = values[2:6]
    if not np.isfinite(box).all() or min(box[2:]) <= 0:
        shown = ",".join(f"{value:g}" for value in box)
        raise ValueError(f"{place}: box {shown}; expected finite numbers, width and height above 0")
    return values


def _number(word: str, place: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise ValueError(f"{place}: {word[:40]!r} is not a number; expected {COLUMNS}") from None
