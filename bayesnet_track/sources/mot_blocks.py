"""Columns of a file of boxes, by header line or benchmark layout, and large files of MOT lines, in blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.sources.entrances.boxes import MOST_LINES, are_corners, usable
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.entrances.text_lines import Line

NAMES = {
    "frame": ("frame", "frame_id", "frame_number", "frame_no", "frameid"),
    "index": ("frame_index", "frame_idx"),
    "id": ("id", "track_id", "tracker_id", "object_id", "obj_id", "target_id", "trackid", "target", "track"),
    "left": ("bb_left", "bbox_left", "left", "xmin", "x_min", "x1", "x", "l"),
    "top": ("bb_top", "bbox_top", "top", "ymin", "y_min", "y1", "y", "t"),
    "center_x": ("x_center", "center_x", "xcenter", "cx", "xc", "x_c"),
    "center_y": ("y_center", "center_y", "ycenter", "cy", "yc", "y_c"),
    "width": ("bb_width", "bbox_width", "width", "w"),
    "height": ("bb_height", "bbox_height", "height", "h"),
    "right": ("bb_right", "bbox_right", "right", "xmax", "x_max", "x2"),
    "bottom": ("bb_bottom", "bbox_bottom", "bottom", "ymax", "y_max", "y2"),
    "confidence": ("confidence", "conf", "score", "considered", "consider", "flag"),
    "class": (
        "class",
        "class_name",
        "class_id",
        "cls",
        "category",
        "object_category",
        "label",
        "kind",
        "type",
    ),
    "status": ("status",),
}
"""What a column holds -> the names that say so, the most certain first. `index` counts frames from 0."""

SILENT = {
    "x",
    "y",
    "z",
    "visibility",
    "vis",
    "truncation",
    "occlusion",
    "truncated",
    "occluded",
    "alpha",
    "class_id",
}
OWN = {"time_s", "angle", "ud_px2", "quiet_px2", "log_evidence", "surprise", "ess", "particles"}
OWN |= {"learn_rate", "active", "sd_x", "sd_y", "sd_w", "sd_h", "color", "colour"}
CORNERS = ("x1", "y1", "x2", "y2", "x3", "y3", "x4", "y4")
HEADERS = "frame,id,left,top,width,height,confidence,class, or x1,y1,x2,y2 for corners"


@dataclass(frozen=True)
class MotColumns:
    """Columns of a line by index from 0; None for one that is not there.

    Attributes:
        columns: what -> index, by the keys of `NAMES`.
        first_frame: the number of the first frame: 0 or 1.
        width: number of words of a line, at least.
        most: at most.
        unused: names of columns that nothing is known of.
        rivals: pairs of columns, by name and index, that both say which frame or which target it is.
    """

    columns: dict[str, int]
    first_frame: int
    width: int
    most: int
    unused: tuple[str, ...] = ()
    rivals: tuple[tuple[tuple[str, int], tuple[str, int]], ...] = ()

    @property
    def box(self) -> tuple[int, int, int, int]:
        """The four numbers of the box."""
        c = self.columns
        first = ("center_x", "center_y") if self.has_centers else ("left", "top")
        sides = ("right", "bottom") if self.has_corners else ("width", "height")
        return c[first[0]], c[first[1]], c[sides[0]], c[sides[1]]

    @property
    def has_corners(self) -> bool:
        """True if right and bottom are given."""
        return {"right", "bottom"} <= self.columns.keys()

    @property
    def has_centers(self) -> bool:
        """True if the place is that of the centre, and left and top are not given."""
        return not {"left", "top"} & self.columns.keys()

    @property
    def sizes(self) -> tuple[int, int] | None:
        """Width and height beside the corners: of the image, or of the box once more."""
        c = self.columns
        return (c["width"], c["height"]) if self.has_corners and {"width", "height"} <= c.keys() else None


KITTI = MotColumns(
    {"index": 0, "id": 1, "class": 2, "left": 6, "top": 7, "right": 8, "bottom": 9, "confidence": 17},
    first_frame=0,
    width=17,
    most=18,
)
"""Labels of KITTI's tracking benchmark, of 17 columns, and results of 18: text classes, corners, frame 0."""


def layout_of(header: Line, name: str) -> MotColumns:
    """The layout that a header line names.

    Raises:
        ValueError: no box is named; says file and line.

    >>> layout_of((1, ["frame", "id", "x1", "y1", "x2", "y2"]), "a.csv").box
    (2, 3, 4, 5)
    """
    number, words = header
    names = [plain_name(word) for word in words]
    twice = [column_name for k, column_name in enumerate(names) if column_name and column_name in names[:k]]
    if twice:
        raise ValueError(f"{name}:{number}: the header names {twice[0]!r} twice")
    columns = {}
    for quantity, aliases in NAMES.items():
        column = next((names.index(column_name) for column_name in aliases if column_name in names), None)
        if column is not None:
            columns[quantity] = column
    is_centered = {"center_x", "center_y", "width", "height"} <= columns.keys() and "left" not in columns
    needed = (("left",), ("top",), ("width", "right"), ("height", "bottom"))
    missing = [" or ".join(pair) for pair in needed if not is_centered and not columns.keys() & set(pair)]
    if not missing and not ({"width", "height"} <= columns.keys() or {"right", "bottom"} <= columns.keys()):
        missing = ["width and height"]
    if missing:
        raise ValueError(
            f"{name}:{number}: a header line ({','.join(words)[:60]}) in which no column is called "
            f"{', '.join(missing)}; rename the columns ({HEADERS}), or remove the line"
        )
    rivals = tuple(_rivals(names))
    if "index" in columns and "frame" in columns:
        del columns["index"]
    is_own = {"time_s", "target", "status"} <= set(names)
    unused = (
        column_name
        for k, column_name in enumerate(names)
        if column_name and k not in columns.values() and column_name not in SILENT | OWN
    )
    first_frame = 0 if is_own or "index" in columns else 1
    return MotColumns(columns, first_frame, len(words), len(words), tuple(unused), rivals)


def _rivals(names: Sequence[str]) -> Iterator[tuple[tuple[str, int], tuple[str, int]]]:
    """Each column that names a frame or an identity after the one that is read, beside that one."""
    for quantity in ("frame", "id"):
        read, *rivals = [alias for alias in NAMES[quantity] if alias in names] or [""]
        for rival in rivals:
            yield (read, names.index(read)), (rival, names.index(rival))


def plain_name(word: str) -> str:
    """A column's name as `NAMES` has it."""
    return word.strip().strip("\"'<>").strip().lower().replace(" ", "_").replace("-", "_")


def is_kitti(words: Sequence[str]) -> bool:
    """True if a line is of KITTI's tracking labels: 17 or 18 words, the third a class by name."""
    return len(words) in (17, 18) and words[2].replace("_", "").isalpha()


ROUNDED_PX = 1.5
"""Corners that are rounded, or that count the last pixel, differ by less from left + width."""
REACH = 1.1
"""Boxes reach so far, in parts of the image, where a column is the image's size."""

NumberedRow = tuple[int, Sequence[str]]
"""The number of a line, and its words."""


def corner_boxes(box: Floats, sizes: Floats, numbers: Sequence[int], name: str) -> Floats:
    """Boxes left, top, width, height (N, 4) of corners (N, 4), where width and height (N, 2) stand beside.

    Width and height are those of the boxes, or of the image, as in CSV files of TensorFlow's object
    detection. Corners that are parts of the image are then multiplied by its size.

    Raises:
        ValueError: they can be neither; says both readings.

    >>> corner_boxes(np.array([[30.0, 40, 60, 80]]), np.array([[30.0, 40]]), [2], "a.csv").tolist()
    [[30.0, 40.0, 30.0, 40.0]]
    """
    spans = box[:, 2:] - box[:, :2]
    boxes = np.column_stack([box[:, :2], spans])
    with np.errstate(invalid="ignore", over="ignore"):
        is_usable = usable(boxes) & np.all(sizes > 0, axis=1)
        is_box = np.all(np.abs(spans - sizes) <= ROUNDED_PX, axis=1)
        fits = np.all((box[:, 2:] <= REACH * sizes) & (box[:, :2] < sizes), axis=1)
    if not is_usable.any() or is_box[is_usable].all():
        return boxes
    wrong = np.flatnonzero(is_usable & ~is_box)
    if fits[is_usable].mean() < 0.9:
        row = int(next((index for index in wrong if not fits[index]), wrong[0]))
        left, top, right, bottom = box[row]
        raise ValueError(
            f"{name}:{numbers[row]}: the columns fit two readings: corners ({left:g},{top:g} to "
            f"{right:g},{bottom:g}: {spans[row, 0]:g}x{spans[row, 1]:g} px), and left, top, width, height "
            f"({sizes[row, 0]:g}x{sizes[row, 1]:g} px); remove the columns of one of them"
        )
    image_sizes = sorted({(w, h) for w, h in sizes[is_usable].tolist()})
    size_text = f"{image_sizes[0][0]:g}x{image_sizes[0][1]:g} px" + (
        f" and {len(image_sizes) - 1} more" if image_sizes[1:] else ""
    )
    message = (
        f"{name}: boxes are read by their corners; width and height are the size of the image ({size_text})"
    )
    shares = bool(
        (box[is_usable] <= 1).all() and (box[is_usable] >= 0).all() and (box[is_usable] % 1 != 0).any()
    )
    notice(f"{message}, and corners, which are from 0 to 1, are multiplied by it" if shares else message)
    return boxes * np.tile(sizes, 2) if shares else boxes


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
        boxes = PlainBoxes(
            np.empty(count, np.int32),
            np.empty(count, np.int32),
            np.empty((count, 4), np.float32),
            np.empty(count, np.float32),
        )
        file.seek(0)
        start, last_frame = 0, 0.0
        for rows in _blocks(file):
            if rows is None or not _is_plain(rows, last_frame) or start + len(rows) > count:
                return None
            end, last_frame = start + len(rows), float(rows[-1, 0])
            boxes.frames[start:end], boxes.ids[start:end] = rows[:, 0] - 1, rows[:, 1]
            boxes.boxes[start:end], boxes.confidences[start:end] = rows[:, 2:6], rows[:, 6]
            start = end
    is_ambiguous = (boxes.boxes.max(axis=0) <= 1).any() or are_corners(boxes.boxes[:MOST_LINES].astype(float))
    return None if start < count or is_ambiguous or _has_twins(boxes) else boxes


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


def _has_twins(boxes: PlainBoxes) -> bool:
    """True if an identity is in a frame twice."""
    keys = (boxes.frames.astype(np.int64) << 32) + boxes.ids
    keys.sort()
    return bool((keys[1:] == keys[:-1]).any())


def _blocks(file: BufferedReader) -> Iterator[Floats | None]:
    """(n, columns) the numbers of some lines; None where they are not plain."""
    remainder, width = b"", 0
    while block := file.read(_BLOCK):
        complete, newline, tail = (remainder + block).rpartition(b"\n")
        remainder = tail
        if not newline:
            continue
        lines = complete.count(b"\n") + 1
        width = width or complete.partition(b"\n")[0].count(b",") + 1
        yield _numbers(complete, lines, width)
    if remainder:
        yield None


def _numbers(text: bytes, lines: int, width: int) -> Floats | None:
    if width not in _WIDTHS or text.translate(None, _PLAIN):
        return None
    numbers = np.empty((lines, width))
    if not _parser()(np.frombuffer(text, np.uint8), numbers):
        try:
            numbers = np.loadtxt(BytesIO(text), delimiter=",", ndmin=2)
        except ValueError:
            return None
    return numbers if numbers.shape == (lines, width) else None


@cache
def _parser() -> Callable[[NDArray[np.uint8], Floats], bool]:
    from bayesnet_track.numerics.compiled import compiled  # here, because Numba takes long to import

    return compiled(_parse)


_ZERO, _NINE, _MINUS, _POINT, _COMMA, _NEWLINE = b"09-.,\n"
_MOST_DIGITS = 15
"""Of a number whose digits are a whole number of float64, and so is the power of ten that it is divided by:
one division then rounds as the best reader does."""
_POWERS = 10.0 ** np.arange(_MOST_DIGITS + 1)


def _parse(text: NDArray[np.uint8], numbers: Floats) -> bool:
    """Fill in the numbers (n, columns) of as many lines; False where one is longer, or no number."""
    rows, columns = numbers.shape
    place, end = 0, text.shape[0]
    for row in range(rows):
        for column in range(columns):
            sign = 1.0
            if place < end and text[place] == _MINUS:
                sign, place = -1.0, place + 1
            mantissa, digits, decimals = 0, 0, -1
            while place < end and text[place] != _COMMA and text[place] != _NEWLINE:
                byte = text[place]
                if byte == _POINT and decimals < 0:
                    decimals = digits
                elif _ZERO <= byte <= _NINE and digits < _MOST_DIGITS:
                    mantissa, digits = 10 * mantissa + (byte - _ZERO), digits + 1
                else:
                    return False
                place += 1
            ends_line = place == end or text[place] == _NEWLINE
            if (
                digits == 0
                or ends_line != (column == columns - 1)
                or (place == end) != (ends_line and row == rows - 1)
            ):
                return False
            numbers[row, column] = sign * mantissa / _POWERS[digits - decimals if decimals >= 0 else 0]
            place += 1
    return True


def _is_plain(rows: Floats, last_frame: float) -> bool:
    frames, ids = rows[:, 0], rows[:, 1]
    extras = rows[:, 7:]
    return bool(
        np.isfinite(rows).all()
        and (rows[:, :2] % 1 == 0).all()
        and last_frame <= frames[0]
        and (np.diff(frames) >= 0).all()
        and frames[0] >= 1
        and frames[-1] < _LARGEST
        and (np.abs(ids) < _LARGEST).all()
        and usable(rows[:, 2:6]).all()
        and (extras == -1).all()
    )
