"""Sensors of a graph: what their detections have to be, from a file and from a program."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from bayesnet_track.engine.compiled import Engine
from bayesnet_track.graph.checked import CheckedGraph, CheckedTarget
from bayesnet_track.graph.expressions.periods import period_of
from bayesnet_track.graph.expressions.terms import Call, Variable
from bayesnet_track.observation.detector import GIVEN, Scan
from bayesnet_track.runtime.arguments import frames_of
from bayesnet_track.runtime.results import FrameSource
from bayesnet_track.runtime.updates.frame_clock import image_users
from bayesnet_track.sources.detection_files import FileDetector, file_detector
from bayesnet_track.sources.entrances.notices import few, notice
from bayesnet_track.sources.scan_files import ScanFile, SensorColumns, scan_file
from bayesnet_track.sources.sources import SUFFIX

LENGTHS = frozenset({"hypot", "sqrt", "abs"})
"""Functions whose values are never negative."""


def sensors_of(graph: CheckedGraph) -> dict[str, SensorColumns]:
    """The agents of a graph that are given detections of quantities, and what these are."""
    return {agent: _columns(plate, agent) for plate in graph.targets.values() for agent in plate.inverses}


def _columns(plate: CheckedTarget, agent: str) -> SensorColumns:
    parameters: Any = plate.parameters[agent]
    quantities = tuple(parameters.sd)
    measures = plate.measures.get(agent)
    terms = {} if measures is None else measures.terms
    constants = {} if measures is None else measures.constants
    limits = np.array([parameters.within[name] for name in quantities], dtype=np.float64)
    return SensorColumns(
        quantities,
        limits[:, 0],
        limits[:, 1],
        np.array([period_of(terms.get(name, Variable(name)), constants) for name in quantities]),
        frozenset(
            name
            for name in quantities
            if isinstance(one := terms.get(name), Call) and one.function in LENGTHS
        ),
    )


def given_detector(graph: CheckedGraph, path: str | Path) -> FileDetector | ScanFile:
    """What a file of detections holds for a graph: boxes, or the quantities of its sensors.

    Raises:
        OSError: the file cannot be read.
        ValueError: it does not fit; says file, line and column.
    """
    sensors = sensors_of(graph)
    if not sensors:
        return file_detector(path)
    boxes = [
        name
        for name, plate in graph.targets.items()
        if not plate.inverses and plate.spec.birth is not None and plate.spec.birth.detector.detector == GIVEN
    ]
    if boxes:
        raise ValueError(
            f"{path}: {next(iter(sensors))} measures quantities, and {boxes[0]} is born from boxes; one file "
            "has either"
        )
    return scan_file(path, sensors)


def source_or_times(
    source: str | PathLike[str] | FrameSource | None,
    graph: CheckedGraph,
    detections: str | PathLike[str] | None,
) -> str | PathLike[str] | FrameSource:
    """The source, or without one the file of detections, whose times stand for it; raises ValueError."""
    if source is not None:
        return source
    if detections is None or not sensors_of(graph):
        raise ValueError(
            "no source: a video, a folder of images; without one, detections of quantities for a graph with "
            "sensors, whose times then stand for frames"
        )
    if not str(detections).lower().endswith(SUFFIX):
        raise ValueError(
            f"{detections}: the file whose times stand for frames is a CSV, named *{SUFFIX}, with frame or "
            f"time_s and {', '.join(_quantities(graph))}"
        )
    return detections


def _quantities(graph: CheckedGraph) -> list[str]:
    """The quantities of all sensors of a graph, each once."""
    return list(dict.fromkeys(name for one in sensors_of(graph).values() for name in one.quantities))


def check_scans(
    graph: CheckedGraph,
    engine: Engine,
    source: FrameSource,
    detector: FileDetector | ScanFile | None,
    detections: str | PathLike[str] | None,
    has_video: bool,
) -> None:
    """Refuse a source without images for what needs them, and times that are not the source's.

    Raises:
        ValueError: says which.
    """
    origin = getattr(source, "origin", None)
    times = origin.text if origin is not None and origin.kind == "plain" else ""
    is_times = times.lower().endswith(SUFFIX)
    if is_times:
        if users := image_users(engine):
            raise ValueError(
                f"{times} has no images, and the graph {graph.spec.name} looks at them "
                f"({', '.join(users)}); give a video as the source"
            )
        if has_video:
            raise ValueError(f"video: {times} has no images to draw on; leave it out")
    if not isinstance(detector, ScanFile):
        return
    is_own = is_times and detections is not None and str(detections) == times
    if detector.by_time and not is_own:
        raise ValueError(
            f"{detections}: rows by time_s are their own source; leave the source out, or give a column "
            "'frame' with the numbers of its frames"
        )
    frames = frames_of(source)
    outside = sorted(one for one in detector.found if one not in frames)
    if outside:
        notice(
            f"{detections}: the rows of {len(outside)} of {len(detector.found)} frames are not read: "
            f"{few(outside)}; frames count from 0"
        )


def read_scans(given: Any, sensors: Mapping[str, SensorColumns]) -> tuple[dict[str, Scan], dict[str, Any]]:
    """What a program gives for a frame: agent -> scan, and agent -> the rows (n,) of what can be used.

    Raises:
        TypeError: it is no mapping of sensors, or one of them no mapping of quantities.
        ValueError: an unknown sensor or quantity, columns of different lengths, or numbers in another unit.
    """
    names = ", ".join(sensors)
    if not isinstance(given, Mapping):
        first = next(iter(sensors))
        example = ", ".join(f'"{one}": [..]' for one in sensors[first].quantities)
        raise TypeError(
            f'detections of sensors are a mapping, such as {{"{first}": {{{example}}}}}, not of type '
            f"{type(given).__name__}"
        )
    scans, rows = {}, {}
    for agent, seen in given.items():
        if agent not in sensors:
            raise ValueError(f"detections of {agent!r}; the graph's sensors are {names}")
        scans[agent], rows[agent] = _read_scan(seen, agent, sensors[agent])
    return scans, rows


def _read_scan(seen: Any, agent: str, columns: SensorColumns) -> tuple[Scan, Any]:
    quantities = ", ".join(columns.quantities)
    if not isinstance(seen, Mapping):
        raise TypeError(f"{agent}: a mapping of {quantities} to columns is needed, not {type(seen).__name__}")
    unknown = [one for one in seen if one not in (*columns.quantities, "score")]
    missing = [one for one in columns.quantities if one not in seen]
    if unknown or missing:
        fault = f"no {missing[0]!r}" if missing else f"unknown {unknown[0]!r}"
        raise ValueError(f"{agent}: {fault}; it measures {quantities}, and may have a score")
    try:
        cells = {name: np.atleast_1d(np.asarray(one, dtype=np.float64)) for name, one in seen.items()}
    except (TypeError, ValueError) as error:
        raise ValueError(f"{agent}: real numbers are needed: {error}") from error
    shapes = {name: one.shape for name, one in cells.items()}
    count = len(cells[columns.quantities[0]])
    for name, shape in shapes.items():
        if shape != (count,):
            raise ValueError(f"{agent}: {name} of shape {shape} beside {columns.quantities[0]} of ({count},)")
    values = np.stack([cells[name] for name in columns.quantities], axis=1)
    scores = cells.get("score", np.ones(count))
    if not ((scores >= 0) & (scores <= 1)).all():
        raise ValueError(f"{agent}: score goes beyond 0..1")
    finite = np.isfinite(values).all(axis=1)
    for row in np.flatnonzero(finite).tolist():
        if (wrong := columns.refuse(values[row].tolist())) is not None:
            raise ValueError(f"{agent}: row {row}: {wrong[1]}")
    usable = np.array(finite, dtype=np.bool_)
    usable[finite] = columns.inside(values[finite])
    if not usable.all():
        left = np.flatnonzero(~usable).tolist()
        notice(
            f"{agent}: {len(left)} of {count} detections are not finite or outside of `within`, and left "
            f"out: row {few(left)}"
        )
    return Scan(values[usable], scores[usable]), np.flatnonzero(usable)
