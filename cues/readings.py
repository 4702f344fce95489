"""Cue: what another sensor measured of the target, from a file: range and bearing, a place on the ground.

Its quantities need not be fields of the state: the agent's `measures` says what each would be of a state.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

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


class ReadingsParameters(CueParameters):
    """Parameters of the readings."""

    file: str = Field(
        default="",
        description="CSV file (path) with a column `frame` (from 0) and one for each quantity of `sd`; "
        "empty: nothing is measured.",
    )
    sd: dict[str, Annotated[float, Field(gt=0)]] = Field(
        default={}, description="Sd of each quantity's error, in its unit; angles in radians."
    )


class ReadingsError(ValueError):
    """A file of readings that cannot be used; says file, line, what was found and what is allowed."""


Rows = Mapping[int, Mapping[str, float]]


@lru_cache(maxsize=16)
def read_readings(path: str, quantities: tuple[str, ...]) -> Rows:
    """Frame -> quantity -> value; an empty cell is none.

    Raises:
        ReadingsError: it cannot be read, a column is missing, a cell is no number, or a frame comes twice.
    """
    try:
        if not Path(path).is_file():
            raise ReadingsError(f"{path}: no such file of readings")
        if Path(path).stat().st_size > MAX_BYTES:
            raise ReadingsError(f"{path}: larger than {MAX_BYTES >> 20} MB")
        with Path(path).open(encoding="utf-8", newline="") as file:
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ReadingsError(f"{path}: cannot be read: {error}") from error
    header = [name.strip() for name in rows[0]] if rows else []
    missing = [name for name in (FRAME, *quantities) if name not in header]
    if missing:
        raise ReadingsError(f"{path}:1: no column {missing[0]!r}; there are {', '.join(header) or 'none'}")
    found: dict[int, dict[str, float]] = {}
    for number, row in enumerate(rows[1:], 2):
        if not any(cell.strip() for cell in row):
            continue
        cells = dict(zip(header, (cell.strip() for cell in row), strict=False))
        values = {name: _number(path, number, name, cells.get(name, "")) for name in (FRAME, *quantities)}
        frame = values.pop(FRAME)
        if frame is None or frame < 0 or frame != int(frame):
            raise ReadingsError(f"{path}:{number}: frame {cells.get(FRAME, '')!r}; a whole number from 0 on")
        if int(frame) in found:
            raise ReadingsError(f"{path}:{number}: frame {int(frame)} again; one row a frame")
        found[int(frame)] = {name: value for name, value in values.items() if value is not None}
    return found


def _number(path: str, line: int, name: str, cell: str) -> float | None:
    if not cell:
        return None
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ReadingsError(f"{path}:{line}: {name} {cell!r}; a finite number, or nothing")
    return value


@dataclass(frozen=True)
class Readings:
    """The readings at work. They have no reference."""

    parameters: ReadingsParameters
    rows: Rows
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
        variance = np.array([p.sd[name] for name in names]) ** 2
        return Measurement(names, np.array([row[name] for name in names]), np.diag(variance), p.floor)


def _read(parameters: ReadingsParameters) -> Rows:
    return read_readings(parameters.file, tuple(parameters.sd)) if parameters.file else {}


def _missing(parameters: ReadingsParameters) -> str | None:
    try:
        _read(parameters)
    except ReadingsError as error:
        return str(error)
    return None


def _make(parameters: ReadingsParameters) -> Readings:
    return Readings(parameters, _read(parameters))


CUE = CueDeclaration(
    name="readings",
    summary="What another sensor measured, from a file.",
    parameters=ReadingsParameters,
    make=_make,
    cost_ms=0.05,
    is_appearance=False,
    missing=_missing,
    files=lambda parameters: (parameters.file,) if parameters.file else (),
    gives=lambda parameters: tuple(parameters.sd),
    measures=True,
)
