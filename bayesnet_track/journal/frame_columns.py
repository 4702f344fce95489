"""The lines of one frame as columns, and back: what a record of ``frames.npy.gz`` holds.

A column has a number per target, in the order of the targets; one of boxes has four rows of them. Numbers
are single precision (seven digits), but for a column with a value that this cannot hold; in a crowd, widths
and measures of information (`WIDTHS`) are half precision (three digits). What a target does
not have is `ABSENT`, a NaN of its own, and a column of which no target has anything is left out. So are
regions that are those of a Gaussian with the column `sd` about `map`.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import lru_cache
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.metrics import FrameMetrics, JoinMetrics, PartMetrics

Columns = Mapping[str, NDArray[Any]]
"""Name -> its values: ``frame`` and ``time_s`` (), boxes (4, T), ``cameras/NAME`` (13,), all others (T,)."""

_ABSENT_BITS = {2: 0x7F00, 4: 0x7FE0_0000, 8: 0x7FFC_0000_0000_0000}
"""By the bytes of a number: the same NaN in half, single and double precision."""
ABSENT = float(struct.unpack("<d", struct.pack("<Q", _ABSENT_BITS[8]))[0])
"""In place of a value that a target does not have."""

BOXES = {"box": "centre_box", "map": "map", "sd": "sd"}
"""Column -> field of four numbers."""
REGIONS = {"region50": 0.5, "region90": 0.9}
"""Column -> share of the centre's weight that lies in it."""
PER_NODE = (
    *("kl", "contribution", "agent_ud_px2", "strength", "features", "modes", "modes_predicted", "p_values"),
    *("log_predictive", "queries", "state", "category", "category_predicted"),
)
"""Fields of a number per node, mode, feature or query, besides `ud_nodes`: a column ``FIELD/NAME`` each."""
NUMBERS = ("score", "log_evidence", "surprise", "ess", "learn_rate")
OPTIONAL = ("quiet_px2", "existence", "hidden", "e_value")
WIDTHS = frozenset(
    {"sd", "ud_px2", "ud_nodes", "quiet_px2", "surprise", "ess", "learn_rate", "kl", "contribution"}
    | {"agent_ud_px2", "strength", "p_values"}
)
"""Columns, by what stands before a slash, that say how sure the belief is and what told it so; beside them
the sd of each field of the state. Places, scores and evidence are none of them."""
_LARGEST, _LEAST = 3e38, 1.2e-38
_LARGEST_HALF, _LEAST_HALF = 65_000.0, 6.2e-5
_BETWEEN = 1e-4
"""Of a region, px and parts of its sd: as far as it may be from a Gaussian's to count as that."""


CAMERA_NUMBERS = (
    *("targets", "detections", "place_nis", "place_dof", "place_noise", "size_nis", "size_dof", "size_noise"),
    *("x_px", "y_px", "xx", "xy", "yy"),
)
"""Numbers of a camera that sees targets on the ground, in the order of its column, ``cameras/NAME``.

`targets` are those expected in its image, `detections` the sum of the probabilities w that one is a target's.
Of places (x, y) and of sizes (w, h): the sum of w nu' S^-1 nu of innovations nu, their degrees of freedom,
and the part of these that the detections' noise is of S. Last the mean innovation of places, px, weighted by
w S^-1, and the sums of these weights, px^-2.
"""


def columns_of(lines: Sequence[FrameMetrics], hypotheses: bool = True) -> dict[str, NDArray[Any]]:
    """The columns of the lines of one frame, at least one.

    Without `hypotheses`, as of a crowd, there is no `cloud`, and `WIDTHS` have three digits.
    """
    return narrowed(all_columns(lines, hypotheses), hypotheses)


def all_columns(lines: Sequence[FrameMetrics], hypotheses: bool = True) -> dict[str, NDArray[Any]]:
    """The same in double precision, also columns that say nothing."""
    first = lines[0]
    columns: dict[str, NDArray[Any]] = {
        "frame": np.array(first.frame, dtype="<i8"),
        "time_s": np.array(first.time_s, dtype="<f8"),
        "target": texts(line.target for line in lines),
    }
    columns |= {name: _four([getattr(line, field) for line in lines]) for name, field in BOXES.items()}
    columns["ud_px2"] = np.array([line.ud_px2 for line in lines])
    columns |= per_node("ud_nodes", [line.ud_nodes for line in lines])
    columns["quiet_px2"] = _optional([line.quiet_px2 for line in lines])
    columns["status"] = texts(line.status for line in lines)
    columns |= {name: np.array([getattr(line, name) for line in lines], dtype=float) for name in NUMBERS}
    columns["particles"] = np.array([line.particles for line in lines], dtype="<i4")
    columns["active"] = texts(" ".join(line.active) for line in lines)
    columns["silent"] = texts(" ".join(line.silent) for line in lines)
    for name in PER_NODE:
        columns |= per_node(name, [getattr(line, name) for line in lines])
    for name, share in REGIONS.items():
        region = _four([getattr(line, name) for line in lines])
        if not _is_gaussian(region, columns["map"], columns["sd"], share):
            columns[name] = region
    columns["angle"] = np.array([line.angle for line in lines])
    columns |= {name: _optional([getattr(line, name) for line in lines]) for name in OPTIONAL[1:]}
    joins = ["" if line.join is None else json.dumps(asdict(line.join)) for line in lines]
    columns["join"] = texts(joins)
    columns |= identity_column([line.identities for line in lines])
    columns |= _parts(lines)
    if hypotheses:
        columns |= _clouds(lines)
    return columns


def narrowed(columns: dict[str, NDArray[Any]], precise: bool = True) -> dict[str, NDArray[Any]]:
    """Without the columns that say nothing, floats in single precision where that holds them.

    Unless `precise`, `WIDTHS` are in half precision where that holds them.
    """
    floats = [name for name, column in columns.items() if column.dtype.kind == "f" and column.ndim]
    rows = [columns[name].reshape(-1, columns[name].shape[-1]) for name in floats]
    doubles = np.concatenate(rows, axis=0, dtype=np.float64)
    size = np.abs(doubles)
    beyond = ((size > _LARGEST) & (size < np.inf)) | ((size < _LEAST) & (size > 0.0))
    is_wide: list[bool] = np.any(beyond, axis=1).tolist()
    finest = ((size > _LARGEST_HALF) & (size < np.inf)) | ((size < _LEAST_HALF) & (size > 0.0))
    is_fine: list[bool] = np.any(finest, axis=1).tolist()
    is_empty: list[bool] = np.all(is_absent(doubles), axis=1).tolist()
    with np.errstate(over="ignore"):
        single = doubles.astype("<f4")
    narrow = {name: column for name, column in columns.items() if column.dtype.kind != "f" or not column.ndim}
    start = 0
    for name, row in zip(floats, rows, strict=True):
        end = start + len(row)
        if not all(is_empty[start:end]) and (name != "angle" or row.any()):
            numbers = (doubles if any(is_wide[start:end]) else single)[start:end]
            if not precise and _is_width(name) and not any(is_fine[start:end]):
                numbers = numbers.astype("<f2")
            narrow[name] = numbers.reshape(columns[name].shape)
        start = end
    for name in ("silent", "join"):
        if name in narrow and not any(narrow[name].tolist()):
            del narrow[name]
    return {name: narrow[name] for name in columns if name in narrow}


def lines_of(columns: Columns) -> Iterator[FrameMetrics]:
    """The lines that the columns are of, in their order.

    Raises:
        KeyError, ValueError, TypeError, IndexError: the columns are not those of a frame.
    """
    frame, time_s = int(columns["frame"]), float(columns["time_s"])
    targets = strings(columns["target"])
    count = len(targets)
    boxes = {field: _fours(columns[name], count) for name, field in BOXES.items()}
    for name in REGIONS:
        boxes[name] = _fours(region_of(columns, name), count)
    values: dict[str, Sequence[Any]] = {name: _single(columns, name, count) for name in ("ud_px2", *NUMBERS)}
    values |= {name: _nullable(columns, name, count) for name in OPTIONAL}
    names_by_field = _names_by_field(tuple(columns))
    for name in ("ud_nodes", *PER_NODE):
        values[name] = _mappings(columns, names_by_field.get(name, ()), count)
    values |= {name: _words(columns, name, count) for name in ("active", "silent")}
    values |= boxes
    values["status"] = strings(columns["status"])
    values["particles"] = columns["particles"].tolist()
    values["angle"] = _single(columns, "angle", count) if "angle" in columns else [0.0] * count
    values["join"] = _joins(columns, count)
    values["identities"] = _identities_of(columns, count)
    values["parts"] = _parts_of(columns, count)
    values["cloud"] = _clouds_of(columns, count)
    if {*map(len, values.values())} != {count}:
        raise ValueError("columns of different lengths")
    names = tuple(values)
    for target, row in zip(targets, zip(*values.values(), strict=True), strict=True):
        yield FrameMetrics(frame=frame, time_s=time_s, target=target, **dict(zip(names, row, strict=True)))


def region_of(columns: Columns, name: str) -> NDArray[np.float64]:
    """(4, T) a region of `REGIONS`, which is that of a Gaussian where the column is left out."""
    if name in columns:
        return np.asarray(columns[name], dtype=np.float64)
    return _gaussian(columns["map"], columns["sd"], REGIONS[name])


def is_absent(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Mask of the values that a column of floats does not have."""
    nothing = np.isnan(values)
    if nothing.any():
        size = values.dtype.itemsize
        nothing &= values.view(f"<u{size}") == _ABSENT_BITS[size]
    return np.asarray(nothing)


def texts(values: Iterable[str]) -> NDArray[np.bytes_]:
    """(T,) as UTF-8."""
    return np.array([value.encode("utf-8") for value in values])


def strings(column: NDArray[Any]) -> list[str]:
    """The texts of a column, such as those of its targets."""
    return [value.decode("utf-8") for value in column.tolist()]


def _four(rows: Sequence[Sequence[float]]) -> NDArray[np.float64]:
    return np.ascontiguousarray(np.array(rows, dtype=np.float64).reshape(len(rows), 4).T)


def _fours(column: NDArray[Any], count: int) -> list[tuple[float, ...]]:
    if column.shape != (4, count):
        raise ValueError(f"a box of shape {column.shape}, not (4, {count})")
    return [*map(tuple, column.astype(np.float64).T.tolist())]


def _gaussian(centre: NDArray[Any], sd: NDArray[Any], share: float) -> NDArray[np.float64]:
    reach = NormalDist().inv_cdf((1.0 + share) / 2.0) * np.asarray(sd[:2], dtype=np.float64)
    middle = np.asarray(centre[:2], dtype=np.float64)
    return np.stack([middle - reach, middle + reach], axis=1).reshape(4, -1)


def _is_gaussian(region: NDArray[Any], centre: NDArray[Any], sd: NDArray[Any], share: float) -> bool:
    distance = np.abs(region - _gaussian(centre, sd, share))
    return bool((distance <= _BETWEEN * (1.0 + np.repeat(sd[:2], 2, axis=0))).all())


def _is_width(name: str) -> bool:
    first = name.partition("/")[0]
    return first in WIDTHS or (first == "state" and name.endswith("_sd"))


def _optional(values: Sequence[float | None]) -> NDArray[np.float64]:
    return np.array([ABSENT if value is None else value for value in values], dtype=np.float64)


def per_node(field: str, rows: Sequence[Mapping[str, float]]) -> dict[str, NDArray[Any]]:
    """The columns ``FIELD/NAME`` of a field that has numbers by name."""
    names = sorted({name for row in rows for name in row})
    return {f"{field}/{name}": np.array([row.get(name, ABSENT) for row in rows], float) for name in names}


def _single(columns: Columns, name: str, count: int) -> list[Any]:
    column = columns[name]
    if column.shape != (count,):
        raise ValueError(f"{name} of shape {column.shape}, not ({count},)")
    values: list[Any] = column.astype(np.float64).tolist()
    return values


def _nullable(columns: Columns, name: str, count: int) -> list[float | None]:
    if name not in columns:
        return [None] * count
    values = _single(columns, name, count)
    if not any(map(math.isnan, values)):
        return values
    absent = is_absent(columns[name]).tolist()
    return [None if nothing else value for nothing, value in zip(absent, values, strict=True)]


@lru_cache(maxsize=256)
def _names_by_field(names: tuple[str, ...]) -> dict[str, list[tuple[str, str]]]:
    """Field -> the columns ``FIELD/NAME`` of it, each with its name."""
    columns: dict[str, list[tuple[str, str]]] = {}
    for name in names:
        field, slash, key = name.partition("/")
        if slash:
            columns.setdefault(field, []).append((name, key))
    return columns


def _mappings(columns: Columns, names: Sequence[tuple[str, str]], count: int) -> list[dict[str, float]]:
    mappings: list[dict[str, float]] = [{} for _ in range(count)]
    for name, key in names:
        for row, value in zip(mappings, _nullable(columns, name, count), strict=True):
            if value is not None:
                row[key] = value
    return mappings


def _words(columns: Columns, name: str, count: int) -> list[tuple[str, ...]]:
    if name not in columns:
        return [()] * count
    return [tuple(text.split()) for text in strings(columns[name])]


def identity_column(identities: Sequence[Mapping[str, float]]) -> dict[str, NDArray[Any]]:
    """The column of who may be whom; none where nobody is doubtful."""
    if not any(identities):
        return {}
    rounded = [{name: round(share, 4) for name, share in shares.items()} for shares in identities]
    return {"identities": texts(json.dumps(shares) if shares else "" for shares in rounded)}


def _identities_of(columns: Columns, count: int) -> list[dict[str, float]]:
    if "identities" not in columns:
        return [{}] * count
    return [json.loads(text) if text else {} for text in strings(columns["identities"])]


def _joins(columns: Columns, count: int) -> list[JoinMetrics | None]:
    if "join" not in columns:
        return [None] * count
    return [_join(text) if text else None for text in strings(columns["join"])]


def _join(text: str) -> JoinMetrics:
    values = json.loads(text)
    return JoinMetrics(**{**values, "others": tuple(values["others"])})


def _parts(lines: Sequence[FrameMetrics]) -> dict[str, NDArray[Any]]:
    columns: dict[str, NDArray[Any]] = {}
    for name in sorted({name for line in lines for name in line.parts}):
        parts = [line.parts.get(name, _NO_PART) for line in lines]
        columns[f"parts/{name}/box"] = _four([part.centre_box for part in parts])
        columns[f"parts/{name}/sd"] = _four([part.sd for part in parts])
        columns[f"parts/{name}/ud_px2"] = np.array([part.ud_px2 for part in parts])
        columns[f"parts/{name}/status"] = texts(part.status for part in parts)
    return columns


def _parts_of(columns: Columns, count: int) -> list[dict[str, PartMetrics]]:
    rows: list[dict[str, PartMetrics]] = [{} for _ in range(count)]
    for column in columns:
        if not (column.startswith("parts/") and column.endswith("/status")):
            continue
        name = column[len("parts/") : -len("/status")]
        boxes, sds = (_fours(columns[f"parts/{name}/{key}"], count) for key in ("box", "sd"))
        uds = _single(columns, f"parts/{name}/ud_px2", count)
        for row, box, sd, ud, status in zip(rows, boxes, sds, uds, strings(columns[column]), strict=True):
            if status:
                row[name] = PartMetrics(box, sd, ud, status)
    return rows


def _clouds(lines: Sequence[FrameMetrics]) -> dict[str, NDArray[Any]]:
    """`cloud` (4, all of them) and how many of them are of each target."""
    boxes = np.array([box for line in lines for box in line.cloud], dtype=np.int64).reshape(-1, 4).T
    if not boxes.size:
        return {}
    kind = "<i2" if np.abs(boxes).max() < 2**15 else "<i8"
    counts = np.array([len(line.cloud) for line in lines], dtype="<i4")
    return {"cloud": np.ascontiguousarray(boxes.astype(kind)), "cloud_count": counts}


def _clouds_of(columns: Columns, count: int) -> list[tuple[tuple[int, ...], ...]]:
    if "cloud" not in columns:
        return [()] * count
    ends = np.cumsum(columns["cloud_count"]).tolist()
    boxes = [*map(tuple, columns["cloud"].T.tolist())]
    if len(ends) != count or ends[-1] != len(boxes) or columns["cloud_count"].min() < 0:
        raise ValueError("hypotheses that are of no target")
    return [tuple(boxes[first:end]) for first, end in zip([0, *ends], ends, strict=False)]


_NO_PART = PartMetrics((0.0,) * 4, (0.0,) * 4, 0.0, "")
