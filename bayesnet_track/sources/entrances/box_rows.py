"""Rows of boxes as they stand in lines of text, not yet checked."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.sources.entrances.column_names import KITTI, Layout
from bayesnet_track.sources.entrances.double_columns import NumberedRow, check_rivals, corner_boxes
from bayesnet_track.sources.entrances.notices import few, notice
from bayesnet_track.sources.entrances.text_lines import Lines, explain_word, is_number, whole

COLUMNS = "frame,id,left,top,width,height,confidence,..."
LEAST, MOST = 6, 10
LARGEST = 2**53
"""Beyond it float64 does not tell whole numbers apart."""

NO_ID = -1
NOT_COUNTED = "DontCare"
"""KITTI's class of areas that are not labelled."""


@dataclass(frozen=True, eq=False)
class Rows:
    """What stands in lines, unchecked.

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


def read_plain(lines: Lines) -> Rows:
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
        for into, word, what in ((frames, words[0], "frame"), (ids, words[1], "id")):
            try:
                into.append(int(word))
            except (ValueError, OverflowError):
                found = whole(word)
                into.append(0 if found is None else found)
                if found is None:
                    wrong.setdefault(len(numbers), f"{what} {word.strip()[:40]} is not a whole number")
        if len(row) > LEAST and not isfinite(row[LEAST]):
            odd.append(len(numbers))
        values.extend(row)
        values.extend(missing[len(row) :])
        numbers.append(number)
    rows = np.array(values, dtype=np.float64).reshape(-1, MOST)
    return Rows(numbers, frames, ids, rows, _classes_of(rows), wrong, odd)


def _classes_of(rows: Floats) -> NDArray[np.str_]:
    """(N,) the classes in column 8 of MOT with 8 or 9 columns and of VisDrone; empty where it holds others.

    Columns 8 to 10 of MOT with 10 columns are a place in the world, or -1.
    """
    none = np.full(len(rows), "")
    column, visible, tenth = rows[:, 7], rows[:, 8], rows[:, 9]
    given = ~np.isnan(column)
    held = column[given]
    is_class = len(held) and (held % 1 == 0).all() and (held >= -1).all() and (held < LARGEST).all()
    ten = ~np.isnan(tenth)
    if not is_class or not (
        np.isin(tenth[ten], (-1, 0, 1, 2)).all() and np.isin(visible[ten], (-1, 0, 1)).all()
    ):
        return none
    found, places = np.unique(np.where(given, column, -1), return_inverse=True)
    return np.array([str(int(one)) if one >= 0 else "" for one in found])[places]


def read_layout(lines: Lines, layout: Layout) -> Rows:
    """Lines whose columns hold what the layout says; raises ValueError, which says file and line."""
    columns = layout.columns
    at_frame, at_id = columns.get("frame", columns.get("index")), columns.get("id")
    if at_frame is None:
        line = lines.first - 1
        raise ValueError(f"{lines.name}:{line}: the header names no frame; expected {COLUMNS}")
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
        frame = whole(words[at_frame])
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
    check_rivals(layout, doubled, lines.name)
    if layout.sizes is not None and values:
        rows[:, 2:6] = corner_boxes(rows[:, 2:6], np.array(sizes), numbers, lines.name)
    elif layout.has_corners:
        rows[:, 4:6] -= rows[:, 2:4]
    classes = np.array([_class_name(word) for word in class_words], dtype=np.str_)
    if layout is KITTI:
        rows[classes == NOT_COUNTED, 6] = 0.0
    return Rows(numbers, frames, _ids_of(id_words), rows, classes, wrong, odd, layout.first_frame)


def _class_name(word: str) -> str:
    number = whole(word)
    return word if number is None else str(number) if number >= 0 else ""


def _ids_of(words: Sequence[str]) -> list[int]:
    """The identities; those that are not all whole numbers are numbered as they come."""
    found = [whole(word) for word in words]
    if all(one is not None for one in found):
        return [one for one in found if one is not None]
    if not any(words):
        return [NO_ID] * len(words)
    numbers = {word: number for number, word in enumerate(dict.fromkeys(filter(None, words)), start=1)}
    return [numbers.get(word, NO_ID) for word in words]
