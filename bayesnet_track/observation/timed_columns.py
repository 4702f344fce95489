"""Columns of a CSV file by frame or by time: what is known of every frame beside its image.

A file has a column `frame` (whole numbers from 0) or `time_s` (seconds), in rising order, and one for each
quantity. A value between two rows is interpolated, or that of the nearest or the last row.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from sys import maxsize
from typing import Literal

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.planes import BEFORE

MAX_BYTES = 1 << 26
KEYS = ("frame", "time_s")
LARGE_GAP = 5.0
"""A gap is said that is so many times the usual distance of two rows."""

Between = Literal["linear", "nearest", "previous"]


class ColumnsError(ValueError):
    """A file of columns that cannot be used; says file, line, what was found and what is allowed."""


@dataclass(frozen=True, eq=False)
class TimedColumns:
    """Columns by frame or by time.

    Attributes:
        path: the file.
        key: `frame` or `time_s`.
        at: (R,) rising values of the key.
        columns: name -> (R,) values.
    """

    path: str
    key: str
    at: Floats
    columns: Mapping[str, Floats]

    def value(self, name: str, frame: int, time_s: float, between: Between = "linear") -> float:
        """The value of a column in a frame; before the first row and after the last one that row's.

        >>> poses = TimedColumns("p.csv", "frame", np.array([0.0, 4.0]), {"pan": np.array([1.0, 3.0])})
        >>> [poses.value("pan", 1, 0.0, how) for how in ("linear", "nearest", "previous")]
        [1.5, 1.0, 1.0]

        Raises:
            ColumnsError: the file goes by `time_s`, and the frame has no time.
        """
        place = float(frame) if self.key == "frame" else time_s
        if not math.isfinite(place):
            fault = f"goes by time_s, and frame {frame} has no time"
            raise ColumnsError(f"{self.path}: {fault}; allowed: a column frame instead")
        values = self.columns[name]
        if between == "linear":
            return float(np.interp(place, self.at, values))
        row = int(np.searchsorted(self.at, place, side="right")) - 1
        if between == "nearest" and row + 1 < len(values):
            row += row < 0 or self.at[row + 1] - place < place - self.at[row]
        return float(values[max(row, 0)])

    def gaps(self, frames: range, seconds_per_frame: float = math.nan) -> Iterator[str]:
        """A sentence for each thing that a run through these frames lacks in the file.

        Of a file by `time_s` only where the frames' interval is known.
        """
        first, final = (
            float(frames.start),
            float(frames[-1]) if frames and frames.stop < maxsize else math.nan,
        )
        if self.key == "time_s":
            first, final = first * seconds_per_frame, final * seconds_per_frame
        if first < self.at[0]:
            yield f"{self.path}: no row before {self.key} {self.at[0]:g}; its values hold from {first:g} on"
        if final > self.at[-1]:
            yield f"{self.path}: no row after {self.key} {self.at[-1]:g}; its values hold until {final:g}"
        steps = np.diff(self.at)
        if len(steps):
            row, median_step = int(np.argmax(steps)), float(np.median(steps))
            if steps[row] > LARGE_GAP * median_step:
                ends = f"{self.at[row]:g} and {self.at[row + 1]:g}"
                yield (
                    f"{self.path}: no row between {self.key} {ends}, where values are bridged; rows are "
                    f"usually {median_step:g} apart"
                )


@dataclass(frozen=True, eq=False)
class TimedInput:
    """One column of a file, as it is used.

    Attributes:
        columns: the file.
        column: the column's name.
        between: its value between two rows.
    """

    columns: TimedColumns
    column: str
    between: Between = "linear"

    def value(self, frame: int, time_s: float) -> float:
        """Its value in a frame; raises as `TimedColumns.value`."""
        return self.columns.value(self.column, frame, time_s, self.between)


def values_at(
    inputs: Mapping[str, TimedInput], frames: tuple[int, int], times_s: tuple[float, float]
) -> dict[str, float]:
    """Values of inputs in a frame, and in the one before it under the name with `_before`.

    `frames` and `times_s` are those of the frame and of the one before it.

    Raises:
        ColumnsError: a file goes by time, and a frame has none.
    """
    values = {name: timed_input.value(frames[0], times_s[0]) for name, timed_input in inputs.items()}
    return values | {
        f"{name}{BEFORE}": timed_input.value(frames[1], times_s[1]) for name, timed_input in inputs.items()
    }


def read_timed_columns(path: str, names: Sequence[str]) -> TimedColumns:
    """The columns of a CSV file; cells are separated by commas, semicolons or tabs.

    Raises:
        ColumnsError: it cannot be read, has no `frame` or `time_s` or both, a column is missing or comes
            twice, a cell is no finite number, or the rows are not in rising order.
    """
    header, rows = _rows(path)
    keys = [key for key in KEYS if key in header]
    if len(keys) != 1:
        fault = "both frame and time_s" if keys else "no column frame or time_s"
        raise ColumnsError(f"{path}:1: {fault}; allowed: one of them; there are {_listed(header)}")
    key = keys[0]
    for name in (key, *names):
        if header.count(name) != 1:
            fault = f"no column {name!r}" if name not in header else f"{header.count(name)} columns {name!r}"
            raise ColumnsError(f"{path}:1: {fault}; there are {_listed(header)}")
    if not rows:
        raise ColumnsError(f"{path}: no row below the header; allowed: one or more")
    places = {name: header.index(name) for name in (key, *names)}
    values = {
        name: np.array([_number(path, line, name, row, index) for line, row in rows])
        for name, index in places.items()
    }
    key_values = values.pop(key)
    if key == "frame" and ((key_values < 0) | (key_values != np.floor(key_values))).any():
        wrong = int(np.argmax((key_values < 0) | (key_values != np.floor(key_values))))
        raise ColumnsError(f"{path}:{rows[wrong][0]}: frame {key_values[wrong]:g}; a whole number from 0 on")
    if (np.diff(key_values) <= 0).any():
        wrong = int(np.argmax(np.diff(key_values) <= 0)) + 1
        fault = f"{key} {key_values[wrong]:g} after {key_values[wrong - 1]:g}"
        raise ColumnsError(
            f"{path}:{rows[wrong][0]}: {fault}; allowed: rows in rising order, one for each {key}"
        )
    return TimedColumns(path, key, key_values, values)


def _rows(path: str) -> tuple[list[str], list[tuple[int, list[str]]]]:
    try:
        if not Path(path).is_file():
            kind = "a folder; allowed: a CSV file" if Path(path).is_dir() else "no such file"
            raise ColumnsError(f"{path}: {kind}")
        if Path(path).stat().st_size > MAX_BYTES:
            raise ColumnsError(f"{path}: larger than {MAX_BYTES >> 20} MB")
        text = Path(path).read_text(encoding="utf-8-sig").splitlines()
        separator = max(",;\t", key=text[0].count) if text else ","
        lines = list(csv.reader(text, delimiter=separator))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ColumnsError(f"{path}: cannot be read: {error}") from error
    header = [name.strip("# ") for name in lines[0]] if lines else []  # NumPy writes it as a comment
    return header, [(number, row) for number, row in enumerate(lines[1:], 2) if any(map(str.strip, row))]


def _number(path: str, line: int, name: str, row: Sequence[str], index: int) -> float:
    cell = row[index].strip() if index < len(row) else ""
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ColumnsError(f"{path}:{line}: {name} {cell!r}; a finite number with a decimal point")
    return value


def _listed(header: Sequence[str]) -> str:
    return ", ".join(header) or "none"
