"""Files of boxes with frames and identities, checked: MOT, VisDrone, KITTI, CSV with a header line."""

from __future__ import annotations

import codecs
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.sources.entrances.boxes import (
    are_polygons,
    describe_unusable,
    is_mot_of_8,
    refuse_corners,
    refuse_scores,
    refuse_shares,
    usable,
)
from bayesnet_track.sources.entrances.notices import few, notice
from bayesnet_track.sources.entrances.text_lines import (
    SHOWN,
    NotTextError,
    TextLines,
    explain_word,
    is_number,
    split_lines,
)
from bayesnet_track.sources.mot_blocks import (
    KITTI,
    MotColumns,
    NumberedRow,
    corner_boxes,
    is_kitti,
    layout_of,
)

PACKED = {
    b"PK\x03\x04": "a zip, or arrays of NumPy (.npz)",
    b"\x93NUMPY": "an array of NumPy (.npy)",
    b"\x1f\x8b": "packed by gzip",
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"\x80\x03": "a pickle of Python",
    b"\x80\x04": "a pickle of Python",
    b"\x80\x05": "a pickle of Python",
    b"\x89HDF": "HDF5",
    b"MATLAB": "a MAT file of MATLAB",
    b"SQLite": "a database of SQLite",
    b"%PDF": "a PDF",
}
"""How a file begins -> what it is."""


def name_bytes(data: bytes) -> str:
    """Kind of a file that is no text, in parentheses, by its first bytes; empty where that is not known."""
    return next((f" ({kind})" for start, kind in PACKED.items() if data.startswith(start)), "")


BOMS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


def read_text(path: str | Path) -> str:
    """A whole file as text: UTF-8, or UTF-16 with a byte order mark.

    Raises:
        OSError: it cannot be read.
        NotTextError: it is not text.
    """
    data = Path(path).read_bytes()
    encoding = next((name for mark, name in BOMS.items() if data.startswith(mark)), "utf-8")
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        raise NotTextError(f"{path}: not a text file{name_bytes(data)}") from None
    if "\0" in text:
        raise NotTextError(f"{path}: not a text file{name_bytes(data)}")
    return text


def exact_int(word: str) -> int | None:
    """A whole number of 64 bits, exactly: also 7.0 and 1e3; None for anything else.

    >>> exact_int("9223372036854775807"), exact_int("7.0"), exact_int("7.5")
    (9223372036854775807, 7, None)
    """
    if not word.isascii() or "_" in word:
        return None
    try:
        number = int(word)
    except ValueError:
        try:
            exact = Decimal(word.strip())
        except InvalidOperation:
            return None
        if not exact.is_finite() or exact.adjusted() > SHOWN or exact != exact.to_integral_value():
            return None
        number = int(exact)
    return number if -(2**63) <= number < 2**63 else None


COLUMNS = "frame,id,left,top,width,height,confidence,..."
LEAST, MOST = 6, 10
LARGEST = 2**53
"""Beyond it float64 does not tell whole numbers apart."""

NO_ID = -1
OF_IMAGES = frozenset({"image", "img", "picture", "file", "filename", "imagename", "path"})
"""Words in the name of a column that holds names of images."""
NOT_COUNTED = "DontCare"
"""KITTI's class of areas that are not labelled."""


@dataclass(frozen=True, eq=False)
class UncheckedRows:
    """Content of lines, unchecked.

    Attributes:
        numbers: of the lines.
        frames: as in the file.
        ids: the identities.
        values: (N, 10) the columns of MOT; NaN where there are none.
        classes: (N,) names of classes; empty where there is none.
        wrong: row -> what is wrong with its frame or identity.
        odd: rows with a confidence that is not finite.
        first_frame: the number of the first frame.
    """

    numbers: Sequence[int]
    frames: Sequence[int]
    ids: Sequence[int]
    values: Floats
    classes: NDArray[np.str_]
    wrong: dict[int, str]
    odd: list[int]
    first_frame: int = 1


def read_plain(lines: TextLines) -> UncheckedRows:
    """Lines of 6 to 10 numbers in the order of MOT; raises ValueError, which says file and line."""
    numbers, frames, ids = array("q"), array("q"), array("q")
    is_plain = lines.is_plain
    wrong: dict[int, str] = {}
    odd: list[int] = []
    values, missing = array("d"), [float("nan")] * MOST
    for number, words in lines:
        place = f"{lines.name}:{number}"
        try:
            row = [float(word) for word in words]
        except ValueError:
            raise explain_word(words, place, COLUMNS) from None
        if not is_plain and not all(map(is_number, words)):
            raise explain_word(words, place, COLUMNS)
        if not LEAST <= len(row) <= MOST:
            raise ValueError(f"{place}: {len(row)} numbers; expected {LEAST} to {MOST} ({COLUMNS})")
        for into, word, quantity in ((frames, words[0], "frame"), (ids, words[1], "id")):
            try:
                into.append(int(word))
            except (ValueError, OverflowError):
                parsed = exact_int(word)
                into.append(0 if parsed is None else parsed)
                if parsed is None:
                    wrong.setdefault(len(numbers), f"{quantity} {word.strip()[:40]} is not a whole number")
        if len(row) > LEAST and not isfinite(row[LEAST]):
            odd.append(len(numbers))
        values.extend(row)
        values.extend(missing[len(row) :])
        numbers.append(number)
    rows = np.array(values, dtype=np.float64).reshape(-1, MOST)
    return UncheckedRows(numbers, frames, ids, rows, _classes_of(rows), wrong, odd)


def _classes_of(rows: Floats) -> NDArray[np.str_]:
    """(N,) the classes in column 8 of MOT with 8 or 9 columns and of VisDrone; empty where it holds others.

    Columns 8 to 10 of MOT with 10 columns are a place in the world, or -1.
    """
    none = np.full(len(rows), "")
    column, visible, tenth = rows[:, 7], rows[:, 8], rows[:, 9]
    is_given = ~np.isnan(column)
    classes = column[is_given]
    is_class = (
        len(classes) and (classes % 1 == 0).all() and (classes >= -1).all() and (classes < LARGEST).all()
    )
    ten = ~np.isnan(tenth)
    if not is_class or not (
        np.isin(tenth[ten], (-1, 0, 1, 2)).all() and np.isin(visible[ten], (-1, 0, 1)).all()
    ):
        return none
    class_numbers, places = np.unique(np.where(is_given, column, -1), return_inverse=True)
    return np.array([str(int(number)) if number >= 0 else "" for number in class_numbers])[places]


def read_layout(lines: TextLines, layout: MotColumns) -> UncheckedRows:
    """Lines whose columns hold what the layout says; raises ValueError, which says file and line."""
    columns = layout.columns
    at_frame, at_id = columns.get("frame", columns.get("index")), columns.get("id")
    if at_frame is None:
        line = lines.first - 1
        unknown = f" (unknown: {few(layout.unused)})" if layout.unused else ""
        images = next((column for column in layout.unused if OF_IMAGES & {*column.split("_")}), "")
        replaced = f"replace each name in {images} by the image's place in the folder, and " if images else ""
        raise ValueError(
            f"{lines.name}:{line}: no column of the header is called frame{unknown}; {replaced}call the "
            f"frame numbers frame if they count from 1, frame_index if they count from 0; expected {COLUMNS}"
        )
    numbers: list[int] = []
    frames: list[int] = []
    id_words: list[str] = []
    class_words: list[str] = []
    values: list[list[float]] = []
    sizes: list[list[float]] = []
    doubled: list[NumberedRow] = []
    wrong: dict[int, str] = {}
    odd: list[int] = []
    lost = 0
    for number, short in lines:
        place = f"{lines.name}:{number}"
        if not layout.width <= max(len(short), layout.width) <= layout.most or len(short) <= max(
            at_frame, at_id or 0
        ):
            raise ValueError(f"{place}: {len(short)} columns; expected {layout.width}")
        words = short + [""] * (layout.most - len(short))
        if "status" in columns and words[columns["status"]].strip() == "lost":
            lost += 1
            continue
        at_confidence = columns.get("confidence")
        picked = [words[k].strip() for k in layout.box]
        picked.append(words[at_confidence].strip() if at_confidence is not None else "")
        beside = [words[k].strip() for k in layout.sizes or ()]
        if not all(word == "" or is_number(word) for word in [*picked, *beside]):
            raise explain_word([word for word in [*picked, *beside] if word], place, ",".join(columns))
        frame = exact_int(words[at_frame])
        if frame is None:
            wrong[len(numbers)] = f"frame {words[at_frame].strip()[:40]} is not a whole number"
        values.append([float(word or "nan") for word in picked])
        sizes.append([float(word or "nan") for word in beside])
        if layout.rivals:
            doubled.append((number, words))
        if picked[-1] and not isfinite(values[-1][-1]):
            odd.append(len(numbers))
        frames.append(frame or 0)
        id_words.append("" if at_id is None else words[at_id].strip())
        class_words.append(words[columns["class"]].strip() if "class" in columns else "")
        numbers.append(number)
    if layout.unused:
        notice(f"{lines.name}: columns that are not used: {few(layout.unused)}")
    if lost:
        whose = "box of a target that is lost is" if lost == 1 else "boxes of targets that are lost are"
        notice(f"{lines.name}: {lost} {whose} left out")
    rows = np.full((len(numbers), MOST), np.nan)
    if values:
        rows[:, 2:7] = values
    _check_rivals(layout, doubled, lines.name)
    if layout.sizes is not None and values:
        rows[:, 2:6] = corner_boxes(rows[:, 2:6], np.array(sizes), numbers, lines.name)
    elif layout.has_corners:
        rows[:, 4:6] -= rows[:, 2:4]
    elif layout.has_centers:
        rows[:, 2:4] -= rows[:, 4:6] / 2
    classes = np.array([_class_name(word) for word in class_words], dtype=np.str_)
    if layout is KITTI:
        rows[classes == NOT_COUNTED, 6] = 0.0
    return UncheckedRows(numbers, frames, _ids_of(id_words), rows, classes, wrong, odd, layout.first_frame)


def _check_rivals(layout: MotColumns, rows: Sequence[NumberedRow], name: str) -> None:
    """Raise ValueError where two columns say differently which frame or which target a row is of."""
    for (read, column), (rival, beside) in layout.rivals:
        pairs = [(words[column].strip(), words[beside].strip()) for _, words in rows]
        forward = dict(pairs)
        back = {second: first for first, second in pairs}
        if len(forward) != len(set(pairs)) or len(back) != len(set(pairs)):
            line = next(
                number
                for (number, _), (first, second) in zip(rows, pairs, strict=True)
                if forward[first] != second or back[second] != first
            )
            raise ValueError(
                f"{name}:{line}: the header fits two readings: the columns {read!r} and {rival!r} part the "
                "rows in different ways; remove the one that is not meant, or rename it"
            )


def _class_name(word: str) -> str:
    number = exact_int(word)
    return word if number is None else str(number) if number >= 0 else ""


def _ids_of(words: Sequence[str]) -> list[int]:
    """The identities; those that are not all whole numbers are numbered as they come."""
    identities = [exact_int(word) for word in words]
    if all(identity is not None for identity in identities):
        return [identity for identity in identities if identity is not None]
    if not any(words):
        return [NO_ID] * len(words)
    numbers = {word: number for number, word in enumerate(dict.fromkeys(filter(None, words)), start=1)}
    return [numbers.get(word, NO_ID) for word in words]


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


def _layout(lines: TextLines) -> MotColumns | None:
    if lines.header is not None:
        return layout_of(lines.header, lines.name)
    _, words = next(iter(lines), (0, []))
    return KITTI if is_kitti(words) else None


def _refuse_others(read: UncheckedRows, name: str) -> None:
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


def _checked(read: UncheckedRows, name: str) -> MotLines:
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
    for row, fault in sorted(read.wrong.items()):
        if keep[row]:
            raise ValueError(f"{name}:{numbers[row]}: {fault}")
    frames = np.array(read.frames, dtype=np.int64) - read.first_frame
    for place in np.flatnonzero(keep & ((frames < 0) | (frames >= LARGEST))).tolist():
        raise ValueError(f"{name}:{numbers[place]}: {_explain_frame(read.frames[place], read.first_frame)}")
    ids = np.array(read.ids, dtype=np.int64)
    lines = MotLines(name, numbers, frames, ids, boxes, read.values[:, 6:], read.classes)
    return lines if keep.all() else lines.only(keep)


def _explain_frame(frame: int, first: int) -> str:
    if frame != 0 or first == 0:
        return f"frame {frame}; expected a whole number from {first} on"
    return (
        "frame 0; frames of MOT files count from 1: add 1 to each, or call the column frame_index in a "
        "header line (frame_index,id,left,top,width,height,confidence), which counts from 0"
    )
