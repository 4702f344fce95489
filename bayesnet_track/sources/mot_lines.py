"""Files of boxes with frames and identities, checked: MOT, VisDrone, KITTI, CSV with a header line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.sources.entrances.box_rows import COLUMNS, LARGEST, Rows, read_layout, read_plain
from bayesnet_track.sources.entrances.boxes import describe_unusable, usable
from bayesnet_track.sources.entrances.column_names import KITTI, Layout, is_kitti, layout_of
from bayesnet_track.sources.entrances.line_forms import (
    are_polygons,
    is_mot_of_8,
    refuse_corners,
    refuse_scores,
    refuse_shares,
)
from bayesnet_track.sources.entrances.notices import few, notice
from bayesnet_track.sources.entrances.text_lines import Lines, NotTextError, read_text, split_lines

__all__ = ["COLUMNS", "LARGEST_FRAME", "MotLines", "NotTextError", "parse_mot", "read_text"]

LARGEST_FRAME = 10**8
"""The last frame of files of which every frame is a row."""


@dataclass(frozen=True, eq=False)
class MotLines:
    """The boxes of a file, as they stand there.

    Attributes:
        name: the file, for messages.
        numbers: (N,) which line of the file each is in, from 1.
        frames: (N,) indices of frames, from 0.
        ids: (N,) identities; if a file names them by texts, numbers from 1 in the order of their first lines.
        boxes: (N, 4) corner boxes left, top, width, height in px, finite and with an area.
        rest: (N, 4) the columns 7 to 10 of MOT, the first a confidence; NaN where there are none.
        classes: (N,) names of classes, numbers as texts; empty where there is none.
    """

    name: str
    numbers: Ints
    frames: Ints
    ids: Ints
    boxes: Floats
    rest: Floats
    classes: NDArray[np.str_]

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
            self.classes[keep],
        )


def parse_mot(text: str, name: str = "<mot>", is_given: bool = False) -> MotLines:
    """The boxes of a text; `name` stands in messages. Lines may be in any order, or none.

    Words are separated by semicolons, commas, tabs or spaces. Without a header line a line is MOT: frame
    (from 1), identity, left, top, width, height, and up to four more (confidence, class, visibility, or as
    VisDrone has them); or of KITTI's tracking labels. A header line names the columns, in any order.
    Boxes that are not finite or have no area, and rows whose confidence is not finite, are left out with a
    notice. With `is_given` the lines are MOT, whatever else they look like.

    Raises:
        ValueError: a line is not of this form, frame or identity is not a whole number, or the lines can be
            read in two ways; says file and line.

    >>> parse_mot("2,7,10,20,41,31,1").frames.tolist()
    [1]
    """
    lines = split_lines(text, name)
    layout = _layout(lines)
    read = read_plain(lines) if layout is None else read_layout(lines, layout)
    if not is_given:
        refuse_shares(read.values[:, 2:6], name)
        if layout is None:
            _refuse_others(read, name)
    return _checked(read, name)


def _layout(lines: Lines) -> Layout | None:
    if lines.header is not None:
        return layout_of(lines.header, lines.name)
    _, words = next(iter(lines), (0, []))
    return KITTI if is_kitti(words) else None


def _refuse_others(read: Rows, name: str) -> None:
    """Raise ValueError where numbers without a header are, or can be, something else than MOT."""
    rows = read.values
    has_8 = len(rows) and (~np.isnan(rows[:, :8])).all() and np.isnan(rows[:, 8]).all()
    if has_8 and not is_mot_of_8(rows[:, :8], name) and are_polygons(rows[:, :8]):
        raise ValueError(
            f"{name}: lines of 8 numbers that are polygons (x1,y1,..,x4,y4), which have no frames; expected "
            f"{COLUMNS}"
        )
    refuse_scores(rows[:, 2:6], name)
    refuse_corners(
        rows[:, 2:6],
        name,
        "a header line frame,id,left,top,width,height,confidence or frame,id,x1,y1,x2,y2,confidence "
        "(with the names of all columns)",
    )


def _checked(read: Rows, name: str) -> MotLines:
    numbers, boxes = np.array(read.numbers, dtype=np.int64), read.values[:, 2:6]
    total, keep = len(numbers), usable(boxes)
    if not keep.all():
        notice(f"{name}: {describe_unusable(total, numbers[~keep].tolist())}")
    odd = [row for row in read.odd if keep[row]]
    if odd:
        keep[odd] = False
        notice(
            f"{name}: {len(odd)} of {total} boxes are left out, whose confidence is not finite: line "
            f"{few(numbers[odd].tolist())}"
        )
    for row, what in sorted(read.wrong.items()):
        if keep[row]:
            raise ValueError(f"{name}:{numbers[row]}: {what}")
    frames = np.array(read.frames, dtype=np.int64) - read.first_frame
    for place in np.flatnonzero(keep & ((frames < 0) | (frames >= LARGEST))).tolist():
        raise ValueError(f"{name}:{numbers[place]}: {_explain_frame(read.frames[place], read.first_frame)}")
    ids = np.array(read.ids, dtype=np.int64)
    found = MotLines(name, numbers, frames, ids, boxes, read.values[:, 6:], read.classes)
    return found if keep.all() else found.only(keep)


def _explain_frame(frame: int, first: int) -> str:
    if frame != 0 or first == 0:
        return f"frame {frame}; expected a whole number from {first} on"
    return (
        "frame 0; frames of MOT files count from 1: add 1 to each, or call the column frame_index in a "
        "header line (frame_index,id,left,top,width,height,confidence), which counts from 0"
    )
