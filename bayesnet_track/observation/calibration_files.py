"""Calibration files as plain data: OpenCV XML, YAML and JSON, other YAML and JSON, and TOML.

Each gives nested dicts and lists with numbers, strings and matrices. What the entries mean is `calibrations`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


class CalibrationError(ValueError):
    """A calibration file that cannot be read, or does not say which camera it is of."""

    @classmethod
    def of(cls, location: str, fault: str, remedy: str = "", mend: str = "") -> CalibrationError:
        """`location`, what was found there, what is allowed, how to mend it."""
        parts = [fault, f"allowed: {remedy}" if remedy else "", mend]
        return cls(f"{location}: " + "; ".join(part for part in parts if part))


def numbers(value: Any) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    """The array that a value holds: numbers, lists of them, {rows, cols, data}; None where it is none.

    >>> numbers({"rows": 1, "cols": 2, "data": [3, 4]}).tolist()
    [[3.0, 4.0]]
    >>> numbers("wide") is None
    True
    """
    if isinstance(value, Mapping):
        if value.keys() >= {"sizes", "dt", "data"}:
            return numbers(value["data"])
        if not {"rows", "cols", "data"} <= value.keys():
            return None
        data = numbers(value["data"])
        rows, columns = value["rows"], value["cols"]
        is_shape = isinstance(rows, int | float) and isinstance(columns, int | float)
        if data is None or not is_shape or data.size != rows * columns:
            return None
        return data.reshape(int(rows), int(columns))
    if isinstance(value, str | bytes | bool) or value is None:
        return None
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
