"""Cue: what another sensor measured of the target, from a file: range and bearing, a place on the ground.

Its quantities need not be fields of the state: the agent's `measures` says what each would be of a state.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from sys import maxsize
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Discriminator, Field, Tag

from bayesnet_track.observation.cue import (
    CueDeclaration,
    CueParameters,
    Floats,
    Hypotheses,
    Measurement,
    Reference,
)
from bayesnet_track.observation.planes import Plane, Planes

MAX_BYTES = 1 << 26
FRAME = "frame"
GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
"""A whole number with its digits in groups, or a number with three decimals."""


Sd = Annotated[
    Annotated[float, Field(gt=0), Tag("number")] | Annotated[str, Field(max_length=1000), Tag("text")],
    Discriminator(lambda value: "text" if isinstance(value, str) else "number"),
]
"""A number, or an expression as text, which the engine reads."""


class ReadingsParameters(CueParameters):
    """Parameters of the readings."""

    file: str = Field(
        default="",
        description="CSV file (path) with a column `frame` (from 0) and one for each quantity of `sd`; "
        "empty: nothing is measured.",
    )
    sd: dict[str, Sd] = Field(
        default={},
        description="Sd of each quantity's error, in its unit, angles in radians: a number, an expression of "
        "the state, or a distribution around 0 such as student_t(scale, degrees).",
    )
    delay: float = Field(
        default=0.0,
        ge=0,
        le=16,
        description="Frame intervals from the frame that a reading is of to the frame in which it arrives.",
    )


class ReadingsError(ValueError):
    """A file of readings that cannot be used; says file, line, what was found and what is allowed."""


Values = Mapping[str, float]


@dataclass(frozen=True)
class ReadingsFile:
    """Contents of a file of readings.

    Attributes:
        rows: frame -> quantity -> value.
        not_finite: frames of rows with a cell that is no finite number, such as `nan`: no reading.
        repeated: frames that come more than once, with the same values.
    """

    rows: Mapping[int, Values]
    not_finite: tuple[int, ...] = ()
    repeated: tuple[int, ...] = ()


NO_FILE = ReadingsFile({})


def read_readings(path: str, quantities: Sequence[str]) -> ReadingsFile:
    """The readings of a CSV file as it is now; an empty cell is none.

    Cells are separated by commas, semicolons or tabs, as those of the header are. Between semicolons or tabs
    a comma may stand for the decimal point.

    Raises:
        ReadingsError: it cannot be read, a column is missing or comes twice, a row has more cells than the
            header, a cell is no number, or a frame comes twice with different values.
    """
    header, rows, decimal = _cells(path, quantities)
    readings: dict[int, Values] = {}
    not_finite, repeated = list[int](), list[int]()
    for line, row in rows:
        cells = dict(zip(header, row, strict=False))
        filled_cells = {
            name: cells[name].replace(decimal, ".") for name in (FRAME, *quantities) if cells.get(name)
        }
        numbers = {name: _number(path, line, name, cell) for name, cell in filled_cells.items()}
        frame_number = numbers.pop(FRAME, math.nan)
        if not (math.isfinite(frame_number) and frame_number >= 0 and frame_number == int(frame_number)):
            raise ReadingsError(f"{path}:{line}: frame {cells.get(FRAME, '')!r}; a whole number from 0 on")
        frame, values = (
            int(frame_number),
            {name: value for name, value in numbers.items() if math.isfinite(value)},
        )
        if len(values) < len(numbers):
            not_finite.append(frame)
        if readings.get(frame, values) != values:
            raise ReadingsError(
                f"{path}:{line}: frame {frame} again, with {_shown(values)} after {_shown(readings[frame])}; "
                "one row a frame"
            )
        if frame in readings:
            repeated.append(frame)
        readings[frame] = values
    return ReadingsFile(readings, tuple(not_finite), tuple(repeated))


def _cells(path: str, quantities: Sequence[str]) -> tuple[list[str], list[tuple[int, list[str]]], str]:
    """The header; each row that is not empty with its line; what stands for the decimal point."""
    text = _text(path)
    try:
        lines = list(csv.reader(text, delimiter=_separator(text)))
    except csv.Error as error:
        raise ReadingsError(f"{path}: cannot be read: {error}") from error
    header = [name.strip("# ") for name in lines[0]] if lines else []  # NumPy writes it as a comment
    for name in (FRAME, *quantities):
        if header.count(name) != 1:
            fault = f"no column {name!r}" if name not in header else f"{header.count(name)} columns {name!r}"
            raise ReadingsError(f"{path}:1: {fault}; there are {', '.join(header) or 'none'}")
    rows = [(number, [cell.strip() for cell in row]) for number, row in enumerate(lines[1:], 2)]
    rows = [(number, row) for number, row in rows if any(row)]
    for number, row in rows:
        if any(row[len(header) :]):
            raise ReadingsError(
                f"{path}:{number}: {len(row)} cells under {len(header)} columns; between commas, numbers "
                "have a decimal point: separate the cells by semicolons if they have a decimal comma"
            )
    quantity_columns = [k for k, name in enumerate(header) if name in quantities]
    numbers = [(number, row[k]) for number, row in rows for k in quantity_columns if k < len(row)]
    commas = [one for one in numbers if "," in one[1]]
    points = any("." in cell for _, cell in numbers)
    if commas and (points or all(GROUPED.fullmatch(cell) for _, cell in commas)):
        line, cell = commas[0]
        raise ReadingsError(
            f"{path}:{line}: {cell!r}: the comma may be a decimal point or group digits; write numbers with "
            "a decimal point and without groups"
        )
    return header, rows, "," if commas else "."


def _text(path: str) -> list[str]:
    try:
        if not Path(path).is_file():
            raise ReadingsError(f"{path}: no such file of readings")
        if Path(path).stat().st_size > MAX_BYTES:
            raise ReadingsError(f"{path}: larger than {MAX_BYTES >> 20} MB")
        return Path(path).read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ReadingsError(f"{path}: cannot be read: {error}") from error


def _separator(lines: Sequence[str]) -> str:
    """Separator of the cells of the header: what is in it most often."""
    return max(",;\t", key=lines[0].count) if lines else ","


def _number(path: str, line: int, name: str, cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        raise ReadingsError(f"{path}:{line}: {name} {cell!r}; a number, or nothing") from None


def _shown(values: Values) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in values.items()) or "no reading"


def describe_unused(path: str, file: ReadingsFile, frames: range) -> Iterator[str]:
    """A sentence for each thing that a file holds and a run through `frames` does not use, or lacks in it.

    >>> file = ReadingsFile({frame: {"range": 1.0} for frame in range(60)})
    >>> list(describe_unused("radar.csv", file, range(30)))
    ['radar.csv: 30 of 60 readings are of frames that are not read (30 to 59); frames count from 0']
    """
    with_values = sorted(frame for frame, values in file.rows.items() if values)
    unread_frames = [frame for frame in with_values if frame not in frames]
    if not with_values:
        yield f"{path}: no reading in it"
    if unread_frames:
        yield (
            f"{path}: {len(unread_frames)} of {len(with_values)} readings are of frames that are not read "
            f"({_span(unread_frames)}); frames count from 0"
        )
    if file.not_finite:
        count = len(file.not_finite)
        yield f"{path}: {count} rows with numbers that are not finite ({_span(file.not_finite)}): no reading"
    if file.repeated:
        yield f"{path}: {len(file.repeated)} rows repeat a frame and its values ({_span(file.repeated)})"
    yield from _describe_rest(path, [frame for frame in with_values if frame in frames], frames)


def _describe_rest(path: str, reading_frames: Sequence[int], frames: range) -> Iterator[str]:
    """Notice of readings that end long before the frames do, by twice the largest gap between two of them."""
    if not reading_frames or frames.stop == maxsize:
        return
    gap = max((following - previous for previous, following in pairwise(reading_frames)), default=frames.step)
    if frames[-1] - reading_frames[-1] > 2 * gap:
        end = reading_frames[-1]
        yield f"{path}: the readings end at frame {end}; the run goes on to {frames[-1]} without any"


def _span(frames: Sequence[int]) -> str:
    """First and last of some frames."""
    low, high = min(frames), max(frames)
    return f"frame {low}" if low == high else f"{low} to {high}"


@dataclass(frozen=True)
class Readings:
    """The readings at work. They have no reference."""

    parameters: ReadingsParameters
    rows: Mapping[int, Values]
    needs: ClassVar[tuple[Plane, ...]] = ()
    context: ClassVar[float] = 0.0

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """Nothing."""
        return {}

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Nothing."""
        return old

    def measure(
        self, planes: Planes, hypotheses: Hypotheses, weights: Floats, reference: Reference
    ) -> Measurement | None:
        """The quantities of this frame, errors independent; None without any."""
        p, row = self.parameters, self.rows.get(planes.frame.index, {})
        names = tuple(name for name in p.sd if name in row)
        if not names:
            return None
        # Where one is an expression the engine puts all of them in.
        variance = np.array([1.0 if isinstance(p.sd[name], str) else p.sd[name] for name in names]) ** 2
        return Measurement(names, np.array([row[name] for name in names]), np.diag(variance), p.floor)


def _read(parameters: ReadingsParameters) -> ReadingsFile:
    return read_readings(parameters.file, tuple(parameters.sd)) if parameters.file else NO_FILE


def _noises(parameters: ReadingsParameters) -> dict[str, str]:
    sds = parameters.sd
    if not any(isinstance(sd, str) for sd in sds.values()):
        return {}
    return {name: sd if isinstance(sd, str) else repr(sd) for name, sd in sds.items()}


def _missing(parameters: ReadingsParameters) -> str | None:
    try:
        _read(parameters)
    except ReadingsError as error:
        return str(error)
    return None


def _make(parameters: ReadingsParameters) -> Readings:
    return Readings(parameters, _read(parameters).rows)


def _unused(parameters: ReadingsParameters, frames: range) -> tuple[str, ...]:
    if not parameters.file:
        return ()
    return tuple(describe_unused(parameters.file, _read(parameters), frames))


CUE = CueDeclaration(
    name="readings",
    summary="What another sensor measured, from a file.",
    parameters=ReadingsParameters,
    make=_make,
    cost_ms=0.05,
    is_appearance=False,
    missing=_missing,
    files=lambda parameters: (parameters.file,) if parameters.file else (),
    unused=_unused,
    gives=lambda parameters: tuple(parameters.sd),
    noises=_noises,
    measures=True,
)
