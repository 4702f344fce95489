"""Calibration files as plain data: OpenCV XML, YAML and JSON, other YAML and JSON, and TOML.

Each gives nested dicts and lists with numbers, strings and matrices. What the entries mean is `calibrations`.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

MOST_BYTES = 20_000_000
FORMATS = "OpenCV XML, YAML or JSON; YAML; JSON; TOML, as of aniposelib"
_AT = re.compile(r"\((\d+)\):\s*(.*?)(?: in function .*)?\s*$", re.DOTALL)
_LINE = re.compile(r"\(at line (\d+), column (\d+)\)")


class CalibrationError(ValueError):
    """A calibration file that cannot be read, or does not say which camera it is of."""

    @classmethod
    def of(cls, where: str, found: str, allowed: str = "", mend: str = "") -> CalibrationError:
        """`where`, what was found there, what is allowed, how to mend it."""
        parts = [found, f"allowed: {allowed}" if allowed else "", mend]
        return cls(f"{where}: " + "; ".join(part for part in parts if part))


def read_tree(path: Path) -> tuple[dict[str, Any], str]:
    """Entries of a calibration file, and its text.

    Raises:
        CalibrationError: no such file, no text, too large, another format, or one with an error in it.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise CalibrationError.of(str(path), f"{path.stat().st_size} bytes", f"up to {MOST_BYTES}")
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise CalibrationError.of(str(path), str(error.strerror or error), "a calibration file") from error
    except UnicodeDecodeError as error:
        raise CalibrationError.of(str(path), "no text", FORMATS) from error
    tree = _parse(path, text)
    if not isinstance(tree, dict) or not tree:
        found = "no entries" if not tree else f"a {type(tree).__name__} instead of named entries"
        raise CalibrationError.of(str(path), found, FORMATS)
    return tree, text


def _parse(path: Path, text: str) -> Any:
    start = text.lstrip()[:12]
    if start.startswith(("<", "%YAML")):
        return _storage(path, text)
    if start.startswith(("{", "[")) and path.suffix.lower() != ".toml":
        try:
            content = json.loads(text, object_pairs_hook=_distinct)
        except json.JSONDecodeError as error:
            where = f"{path}:{error.lineno}:{error.colno}"
            raise CalibrationError.of(where, f"no JSON: {error.msg}", FORMATS) from error
        except (ValueError, RecursionError) as error:
            raise CalibrationError.of(str(path), f"no JSON: {error}", FORMATS) from error
        return {str(n): item for n, item in enumerate(content)} if isinstance(content, list) else content
    if path.suffix.lower() == ".toml":
        try:
            return tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            place = _LINE.search(str(error))
            where = f"{path}:{place[1]}:{place[2]}" if place else str(path)
            message = _LINE.sub("", str(error)).strip()
            raise CalibrationError.of(where, f"no TOML: {message}", FORMATS) from error
    return _yaml(path, text)


def _distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{twice!r} stands there twice")
    return entries


def _yaml(path: Path, text: str) -> Any:
    import yaml

    try:
        return yaml.safe_load(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f"{path}:{mark.line + 1}:{mark.column + 1}" if mark else str(path)
        raise CalibrationError.of(where, f"no YAML: {error.problem}", FORMATS) from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise CalibrationError.of(str(path), f"no YAML: {error}", FORMATS) from error


def _storage(path: Path, text: str) -> dict[str, Any]:
    """Entries of OpenCV's XML or YAML."""
    import cv2

    try:
        storage = cv2.FileStorage(text, cv2.FileStorage_READ | cv2.FileStorage_MEMORY)
        root = storage.root()
        return {name: _node(storage.getNode(name)) for name in root.keys()}  # noqa: SIM118 (a cv2.FileNode)
    except (cv2.error, TypeError, ValueError, SystemError) as error:
        place = _AT.search(str(error))
        where = f"{path}:{place[1]}" if place else str(path)
        kind = "XML" if text.lstrip().startswith("<") else "YAML"
        message = f": {place[2]}" if place else ""
        raise CalibrationError.of(where, f"it is not OpenCV {kind}{message}", FORMATS) from error


def _node(node: Any) -> Any:
    if node.isMap():
        names = list(node.keys())
        if {"dt", "data"} <= set(names):
            matrix = node.mat()
            return np.zeros(0) if matrix is None else np.asarray(matrix, dtype=np.float64)
        return {name: _node(node.getNode(name)) for name in names}
    if node.isSeq():
        return [_node(node.at(place)) for place in range(node.size())]
    if node.isInt() or node.isReal():
        return float(node.real())
    return str(node.string()) if node.isString() else None


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
        whole = isinstance(rows, int | float) and isinstance(columns, int | float)
        if data is None or not whole or data.size != rows * columns:
            return None
        return data.reshape(int(rows), int(columns))
    if isinstance(value, str | bytes | bool) or value is None:
        return None
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None


def line_of(text: str, key: str) -> int | None:
    """Line of a key that stands once in a text, from 1; None where it stands more often.

    >>> line_of("a: 1\\nrotation: 2\\n", "rotation")
    2
    """
    word = re.compile(rf"(?<![\w.-]){re.escape(key)}(?![\w.-])")
    lines = [n for n, line in enumerate(text.splitlines(), 1) if word.search(line)]
    closing = [n for n in lines if f"</{key}" in text.splitlines()[n - 1]]
    lines = [n for n in lines if n not in closing] or lines
    return lines[0] if len(lines) == 1 else None
