"""Files of detections that are no boxes: a CSV of what sensors measured, and the times of it as a source.

A row is one detection: its `frame` (from 0) or `time_s`, a column for each quantity, and, if wanted, `sensor`
(the agent's name) and `score`. A row whose quantities are all empty says that the sensor looked and saw
nothing; where it has no row it did not look.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.detector import Scan
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.entrances.notices import few, notice
from bayesnet_track.sources.mot_lines import read_text
from bayesnet_track.sources.timing import Picture

FRAME, TIME, SENSOR, SCORE = "frame", "time_s", "sensor", "score"
SIDE = 16
"""Pixels of the black frames of a source without images."""

MOST_TURNS = 2.0
"""An angle beyond so many turns is in another unit."""


@dataclass(frozen=True, eq=False)
class SensorColumns:
    """Quantities that a sensor measures, and their ranges.

    Attributes:
        quantities: names of its K columns.
        low: (K,) least values that it gives.
        high: (K,) largest ones.
        periods: (K,) of angles; infinite of others.
        lengths: quantities that are lengths: never negative.
    """

    quantities: tuple[str, ...]
    low: Floats
    high: Floats
    periods: Floats
    lengths: frozenset[str] = frozenset()

    def refuse(self, values: Sequence[float]) -> tuple[str, str] | None:
        """(quantity, what is wrong with it) of a detection (K,) that is in another unit; None of others."""
        for name, value, period in zip(self.quantities, values, self.periods.tolist(), strict=True):
            if name in self.lengths and value < 0:
                return name, f"{name} is {value:g}; its measure is never negative"
            if period < math.inf and abs(value) > MOST_TURNS * period / 2 + 1e-6:
                unit = "radians" if abs(period - 2 * math.pi) < 1e-9 else f"units of {period:g} a turn"
                return name, f"{name} is {value:g}; angles are in {unit}, as its measure has them"
        return None

    def inside(self, values: Floats) -> NDArray[np.bool_]:
        """(N,) detections (N, K) between the least and the largest values, of angles any turn of them."""
        turns = self.periods < np.inf
        period = np.where(turns, self.periods, 1.0)
        turned = np.where(turns, self.low + (values - self.low) % period, values)
        slack = 1e-9 * (1.0 + np.abs(self.high))
        return np.asarray(((turned >= self.low - slack) & (turned <= self.high + slack)).all(axis=1))


@dataclass(frozen=True, eq=False)
class ScanFile:
    """Detections of sensors from a file.

    Attributes:
        found: number of a frame -> agent -> what it saw.
        by_time: whether rows have `time_s`: frames are then the different times, in their order.
    """

    found: Mapping[int, Mapping[str, Scan]] = field(default_factory=dict)
    by_time: bool = False

    def scans(self, frame: Frame) -> Mapping[str, Scan]:
        """Scans of a frame, as `observation.detector.Scanner`."""
        return self.found.get(frame.index, {})


def scan_file(path: str | Path, sensors: Mapping[str, SensorColumns]) -> ScanFile:
    """The detections of a CSV file for these sensors; a notice says which are left out.

    Raises:
        OSError: the file cannot be read.
        ValueError: a column is missing, two sensors measure the same without a column `sensor`, or a cell
            cannot be used; says file, line and column.
    """
    return parse_scans(read_text(path), sensors, str(path))


def parse_scans(text: str, sensors: Mapping[str, SensorColumns], name: str = "<detections>") -> ScanFile:
    """The detections of a CSV text; see `scan_file`.

    >>> radar = SensorColumns(("range",), np.zeros(1), np.full(1, 99.0), np.full(1, np.inf))
    >>> found = parse_scans("frame,range\\n0,5\\n0,7\\n3,", {"radar": radar}).found
    >>> found[0]["radar"].values.tolist(), len(found[3]["radar"])
    ([[5.0], [7.0]], 0)
    """
    header, rows = _table(text, name)
    clock = _clock(header, name)
    _check_columns(header, sensors, name)
    named = SENSOR in header
    if not named:
        _refuse_alike(sensors, name)
    times = [_number(row, clock, f"{name}:{line}") for line, row in rows]
    index = _indices(times, rows, clock, name)
    scans: dict[int, dict[str, list[tuple[int, list[float], float]]]] = {}
    not_finite = list[int]()
    for (line, row), moment in zip(rows, times, strict=True):
        for agent in _agents_of(row, sensors, named, f"{name}:{line}"):
            looks = scans.setdefault(index[moment], {}).setdefault(agent, [])
            values = _values(row, sensors[agent], f"{name}:{line}")
            if values is None:
                continue
            if not all(map(math.isfinite, values)):
                not_finite.append(line)
                continue
            if (wrong := sensors[agent].refuse(values)) is not None:
                place = f"{name}:{line}:{header.index(wrong[0]) + 1}"
                raise ValueError(f"{place}: {wrong[1]}")
            looks.append((line, values, _score(row, f"{name}:{line}")))
    if not_finite:
        fault = "row has a number that is" if len(not_finite) == 1 else "rows have numbers that are"
        notice(f"{name}: {len(not_finite)} {fault} not finite, and left out: line {few(not_finite)}")
    return ScanFile(_scans(scans, sensors, name), clock == TIME)


def _times_of(path: str | Path) -> tuple[list[int], list[float], str]:
    """Numbers and times of the frames of a file, and the column that they are from; raises as `scan_file`."""
    name = str(path)
    header, rows = _table(read_text(path), name)
    clock = _clock(header, name)
    times = [_number(row, clock, f"{name}:{line}") for line, row in rows]
    index = _indices(times, rows, clock, name)
    order = sorted(index)
    return [index[time] for time in order], order, clock


class ScanReader:
    """Black frames at the times of a file of detections, as a source; one interval is 1 s by `time_s`."""

    gap_from = math.inf
    is_live = False

    def __init__(self, text: str) -> None:
        self._numbers, times, clock = _times_of(text)
        self.frame_interval_s = 1.0 if clock == TIME else 1 / 25
        self._times = [time - times[0] for time in times] if clock == TIME else times
        self._seconds = times if clock == TIME else [time * self.frame_interval_s for time in times]
        self.declared_frames: int | None = self._numbers[-1] + 1 if self._numbers else 0

    def __iter__(self) -> Iterator[Picture]:
        image = np.zeros((SIDE, SIDE, 3), np.uint8)
        for number, time, seconds in zip(self._numbers, self._times, self._seconds, strict=True):
            yield Picture(number, time, seconds, lambda: (image, True))

    def close(self) -> None:
        """Nothing stays open."""


Row = Mapping[str, str]


def _table(text: str, name: str) -> tuple[list[str], list[tuple[int, Row]]]:
    lines = text.splitlines()
    if not lines:
        raise ValueError(f"{name}: empty; a header with frame or time_s and the quantities is needed")
    separator = max(",;\t", key=lines[0].count)
    table = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)]
    header = [cell.strip("# \ufeff") for cell in table[0]]
    _clock(header, name)  # before what is below: a file of another kind has no such column
    rows: list[tuple[int, Row]] = []
    for line, cells in enumerate(table[1:], 2):
        if not any(cells):
            continue
        if len(cells) > len(header):
            raise ValueError(
                f"{name}:{line}:{len(header) + 1}: {len(cells)} cells under {len(header)} columns; numbers "
                "have a decimal point, or cells are separated by semicolons"
            )
        cells += [""] * (len(header) - len(cells))
        decimal = "," if separator != "," else "."
        rows.append((line, {k: v.replace(decimal, ".") for k, v in zip(header, cells, strict=True)}))
    if not rows:
        raise ValueError(f"{name}: no row below the header")
    return header, rows


def _clock(header: Sequence[str], name: str) -> str:
    clocks = [column for column in (FRAME, TIME) if column in header]
    if len(clocks) != 1:
        fault = "neither a column 'frame' nor 'time_s'" if not clocks else "both columns 'frame' and 'time_s'"
        raise ValueError(f"{name}:1: {fault}; one of them is needed; there are {', '.join(header)}")
    twice = [column for column in header if header.count(column) > 1]
    if twice:
        raise ValueError(
            f"{name}:1:{header.index(twice[0]) + 1}: {header.count(twice[0])} columns {twice[0]!r}"
        )
    return clocks[0]


def _check_columns(header: Sequence[str], sensors: Mapping[str, SensorColumns], name: str) -> None:
    for agent, columns in sensors.items():
        for quantity in columns.quantities:
            if quantity not in header:
                raise ValueError(
                    f"{name}:1: no column {quantity!r}, which {agent} measures; there are {', '.join(header)}"
                )
    known_columns = {
        FRAME,
        TIME,
        SENSOR,
        SCORE,
        *(column for each in sensors.values() for column in each.quantities),
    }
    unused = [column for column in header if column not in known_columns]
    if unused:
        noun = "column is" if len(unused) == 1 else "columns are"
        notice(f"{name}: {len(unused)} {noun} not used: {few(unused)}")


def _refuse_alike(sensors: Mapping[str, SensorColumns], name: str) -> None:
    for first, first_columns in sensors.items():
        for second, second_columns in sensors.items():
            if first < second and set(first_columns.quantities) & set(second_columns.quantities):
                shared = sorted(set(first_columns.quantities) & set(second_columns.quantities))[0]
                raise ValueError(
                    f"{name}:1: {first} and {second} both measure {shared!r}; a column 'sensor' has to say "
                    "which of them each row is of"
                )


def _number(row: Row, column: str, place: str) -> float:
    try:
        value = float(row[column])
    except ValueError:
        value = math.nan
    is_valid = column != FRAME or (math.isfinite(value) and value == int(value) and value >= 0)
    if not math.isfinite(value) or not is_valid:
        needed = "a whole number from 0 on" if column == FRAME else "seconds, a finite number"
        raise ValueError(f"{place}:{_column(row, column)}: {column} {row[column]!r}; {needed}")
    return value


def _column(row: Row, name: str) -> int:
    return [*row].index(name) + 1


def _indices(
    times: Sequence[float], rows: Sequence[tuple[int, Row]], clock: str, name: str
) -> dict[float, int]:
    """Time -> number of its frame; rows of `time_s` have to be in order."""
    if clock == FRAME:
        return {time: int(time) for time in times}
    for (line, row), previous, current in zip(rows[1:], times, times[1:], strict=False):
        if current < previous:
            place = f"{name}:{line}:{_column(row, TIME)}"
            raise ValueError(
                f"{place}: time_s {current:g} after {previous:g}; rows are in the order of their times"
            )
    return {time: number for number, time in enumerate(sorted(set(times)))}


def _agents_of(row: Row, sensors: Mapping[str, SensorColumns], named: bool, place: str) -> list[str]:
    """The sensors that a row is of: the one that it names, else those of whose quantities it has any."""
    if named:
        agent = row[SENSOR]
        if agent not in sensors:
            position = f"{place}:{_column(row, SENSOR)}"
            raise ValueError(f"{position}: sensor {agent!r}; the graph has {', '.join(sensors)}")
        return [agent]
    measuring = [agent for agent, columns in sensors.items() if any(row[name] for name in columns.quantities)]
    if not measuring and len(sensors) > 1:
        raise ValueError(
            f"{place}: no quantity; a column 'sensor' has to say which of {', '.join(sensors)} saw nothing"
        )
    return measuring or [*sensors]


def _values(row: Row, columns: SensorColumns, place: str) -> list[float] | None:
    """The quantities of a row; None where all are empty."""
    cells = {name: row[name] for name in columns.quantities}
    if not any(cells.values()):
        return None
    values = []
    for name, cell in cells.items():
        if not cell:
            filled = ", ".join(quantity for quantity, text in cells.items() if text)
            raise ValueError(f"{place}:{_column(row, name)}: {name} is empty, and {filled} is given")
        try:
            values.append(float(cell))
        except ValueError:
            raise ValueError(f"{place}:{_column(row, name)}: {name} {cell!r}; a number, or nothing") from None
    return values


def _score(row: Row, place: str) -> float:
    text = row.get(SCORE, "")
    if not text:
        return 1.0
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"{place}:{_column(row, SCORE)}: score {text!r}; a number from 0 to 1, or nothing")
    return value


def _scans(
    rows_of_frames: Mapping[int, Mapping[str, list[tuple[int, list[float], float]]]],
    sensors: Mapping[str, SensorColumns],
    name: str,
) -> dict[int, dict[str, Scan]]:
    beyond: dict[str, list[int]] = {}
    counts = dict.fromkeys(sensors, 0)
    scans: dict[int, dict[str, Scan]] = {}
    for number, looks in rows_of_frames.items():
        for agent, rows in looks.items():
            columns = sensors[agent]
            counts[agent] += len(rows)
            values = np.array([quantities for _, quantities, _ in rows], dtype=np.float64)
            values = values.reshape(-1, len(columns.quantities))
            keep = columns.inside(values)
            beyond.setdefault(agent, []).extend(
                line for (line, _, _), is_kept in zip(rows, keep, strict=True) if not is_kept
            )
            scores = np.array([score for _, _, score in rows])
            scans.setdefault(number, {})[agent] = Scan(values[keep], scores[keep])
    for agent, lines in beyond.items():
        if lines:
            notice(
                f"{name}: {len(lines)} of {counts[agent]} detections of {agent} lie outside of its `within`, "
                f"and are left out: line {few(lines)}"
            )
    for agent, count in counts.items():
        if not count:
            notice(f"{name}: no detection of {agent}")
    return scans
