"""Detections and scans given by a program: what of them can be used, and in which row it stands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.compiled import Engine
from bayesnet_track.graph.checked import CheckedGraph, CheckedTarget
from bayesnet_track.graph.expressions.distributions import period_of
from bayesnet_track.graph.expressions.terms import Call, Variable
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import centre_from_xyxy, xyxy_from_centre
from bayesnet_track.observation.detector import GIVEN, Detections, Scan, fetched
from bayesnet_track.runtime.arguments import frames_of
from bayesnet_track.runtime.frame_clock import image_users
from bayesnet_track.runtime.results import FrameSource
from bayesnet_track.sources.detection_files import FileDetector, file_detector, names_boxes
from bayesnet_track.sources.entrances.boxes import describe_unusable, usable
from bayesnet_track.sources.entrances.notices import few, notice
from bayesnet_track.sources.scan_files import ScanFile, SensorColumns, scan_file
from bayesnet_track.sources.sources import DETECTION_SUFFIXES, SUFFIX

LENGTHS = frozenset({"hypot", "sqrt", "abs"})
"""Functions whose values are never negative."""


def sensor_columns(graph: CheckedGraph) -> dict[str, SensorColumns]:
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
            if isinstance(term := terms.get(name), Call) and term.function in LENGTHS
        ),
    )


def given_detector(graph: CheckedGraph, path: str | Path) -> FileDetector | ScanFile:
    """Contents of a file of detections for a graph: boxes, or the quantities of its sensors.

    Raises:
        OSError: the file cannot be read.
        ValueError: it does not fit; says file, line and column.
    """
    sensors = sensor_columns(graph)
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
    if detections is None:
        raise ValueError(
            "no source: a video, a folder of images; without one, a file of detections, whose times then "
            "stand for frames"
        )
    suffixes = {SUFFIX} if sensor_columns(graph) else DETECTION_SUFFIXES
    if Path(detections).suffix.lower() not in suffixes:
        contents = (
            f"frame or time_s and {', '.join(_quantities(graph))}" if sensor_columns(graph) else "boxes"
        )
        raise ValueError(
            f"{detections}: the file whose times stand for frames is named "
            f"*{' or *'.join(sorted(suffixes))}, with {contents}"
        )
    is_csv = Path(detections).suffix.lower() == SUFFIX
    if (
        is_csv
        and not sensor_columns(graph)
        and Path(detections).is_file()
        and not names_boxes(Path(detections))
    ):
        raise ValueError(
            f"{detections}: the file whose times stand for frames has columns of boxes, such as "
            "frame,id,left,top,width,height in its header line, or is named *.txt"
        )
    return detections


def _quantities(graph: CheckedGraph) -> list[str]:
    """The quantities of all sensors of a graph, each once."""
    return list(
        dict.fromkeys(name for sensor in sensor_columns(graph).values() for name in sensor.quantities)
    )


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
    is_times = Path(times).suffix.lower() in DETECTION_SUFFIXES
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
    unread = sorted(frame for frame in detector.found if frame not in frames)
    if unread:
        notice(
            f"{detections}: the rows of {len(unread)} of {len(detector.found)} frames are not read: "
            f"{few(unread)}; frames count from 0"
        )


def read_scans(
    detections: Any, sensors: Mapping[str, SensorColumns]
) -> tuple[dict[str, Scan], dict[str, Any]]:
    """Scans that a program gives for a frame: agent -> scan, and agent -> the usable rows (n,).

    Raises:
        TypeError: it is no mapping of sensors, or one of them no mapping of quantities.
        ValueError: an unknown sensor or quantity, columns of different lengths, or numbers in another unit.
    """
    names = ", ".join(sensors)
    if not isinstance(detections, Mapping):
        first = next(iter(sensors))
        example = ", ".join(f'"{quantity}": [..]' for quantity in sensors[first].quantities)
        raise TypeError(
            f'detections of sensors are a mapping, such as {{"{first}": {{{example}}}}}, not of type '
            f"{type(detections).__name__}"
        )
    scans, rows = {}, {}
    for agent, columns in detections.items():
        if agent not in sensors:
            raise ValueError(f"detections of {agent!r}; the graph's sensors are {names}")
        scans[agent], rows[agent] = _read_scan(columns, agent, sensors[agent])
    return scans, rows


def _read_scan(scan: Any, agent: str, columns: SensorColumns) -> tuple[Scan, Any]:
    quantities = ", ".join(columns.quantities)
    if not isinstance(scan, Mapping):
        raise TypeError(f"{agent}: a mapping of {quantities} to columns is needed, not {type(scan).__name__}")
    unknown = [column for column in scan if column not in (*columns.quantities, "score")]
    missing = [column for column in columns.quantities if column not in scan]
    if unknown or missing:
        fault = f"no {missing[0]!r}" if missing else f"unknown {unknown[0]!r}"
        raise ValueError(f"{agent}: {fault}; it measures {quantities}, and may have a score")
    try:
        cells = {name: np.atleast_1d(np.asarray(column, dtype=np.float64)) for name, column in scan.items()}
    except (TypeError, ValueError) as error:
        raise ValueError(f"{agent}: real numbers are needed: {error}") from error
    shapes = {name: column.shape for name, column in cells.items()}
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
        left_out = np.flatnonzero(~usable).tolist()
        notice(
            f"{agent}: {len(left_out)} of {count} detections are not finite or outside of `within`, and left "
            f"out: row {few(left_out)}"
        )
    return Scan(values[usable], scores[usable]), np.flatnonzero(usable)


KINDS = {"c": "complex numbers", "b": "True and False", "U": "texts", "S": "texts"}
"""Kinds of arrays that NumPy makes numbers of, and which hold none."""
LEAST_AREA_PX = 1.0
"""No graph takes smaller boxes."""


@dataclass(frozen=True, eq=False)
class GivenDetections:
    """Detections that can be used.

    Attributes:
        detections: centre boxes, scores and labels.
        rows: (N,) the row of each among all that were given.
        count: number of rows that were given.
        name: what notices call them.
    """

    detections: Detections
    rows: NDArray[np.int64]
    count: int
    name: str = "detections"

    def kept(self, fits: NDArray[np.bool_]) -> GivenDetections:
        """Detections for which `fits` (N,) is true."""
        if fits.all():
            return self
        detections, labels = self.detections, self.detections.labels
        fitting_labels = tuple(labels[row] for row in np.flatnonzero(fits))
        return GivenDetections(
            Detections(detections.boxes[fits], detections.scores[fits], fitting_labels),
            self.rows[fits],
            self.count,
            self.name,
        )

    def without(self, fits: NDArray[np.bool_], describe: Callable[[Sequence[int]], str]) -> GivenDetections:
        """Detections for which `fits` (N,) is true; a notice describes the rows of the others."""
        if fits.all():
            return self
        notice(describe(self.rows[~fits].tolist()))
        return self.kept(fits)

    def inside(self, width: int, height: int) -> GivenDetections:
        """Detections that touch a frame of this size, px; a notice names the others."""
        boxes = self.detections.boxes
        beside = np.abs(2.0 * boxes[:, :2] - (width - 1, height - 1)) >= boxes[:, 2:] + (width, height)
        touching = self.without(
            np.asarray(~beside.any(axis=1)),
            lambda rows: _left_out(
                self.name, f"outside of the frames of {width}x{height} px", rows, self.count,
                "; DetectionsTracker(size=(width, height)) sets their size where no frame is given",
            ),
        )  # fmt: skip
        return touching.without(
            touching.detections.boxes[:, 2:].prod(axis=1) >= LEAST_AREA_PX,
            lambda rows: _left_out(
                self.name, "smaller than 1 px²", rows, self.count, _advice(touching.detections.boxes)
            ),
        )


def _advice(boxes: Floats) -> str:
    """The reason why boxes are so small: perhaps all of them are in parts of the frame."""
    corners = xyxy_from_centre(boxes)
    if (corners >= 0).all() and (corners <= 1).all():
        return (
            "; all coordinates are from 0 to 1, as parts of the frame (xyxyn): multiply x by its width and y "
            "by its height, px"
        )
    return "; xyxy counts pixels"


def read_given(detections: Any, graph: CheckedGraph, name: str = "detections") -> GivenDetections:
    """The usable rows of an object with `xyxy`, `confidence`, and `data`; a notice names the others.

    A `Results` of ultralytics is read by its `boxes` and `names`. Notices call the object by its `name`.

    Raises:
        TypeError: it has no `xyxy`.
        ValueError: boxes that are not (n, 4) numbers, confidences beyond 0..1, no class names for a graph
            with `labels`, or not one confidence or name for each box.
    """
    detections = _with_corners(detections)
    corners = _corners(detections)
    count = len(corners)
    scores, labels = _scores(detections, count), _labels(detections, count, graph)
    with np.errstate(invalid="ignore"):
        sizes = corners[:, 2:] - corners[:, :2]
    fits = usable(np.concatenate([corners[:, :2], sizes], axis=1))
    boxes = centre_from_xyxy(np.where(fits[:, None], corners, 0.0))
    all_rows = GivenDetections(Detections(boxes, scores, labels), np.arange(count), count, name)
    finite_boxes = all_rows.without(fits, lambda rows: f"{name}: {describe_unusable(count, rows, 'row')}")
    confidences = finite_boxes.detections.scores
    if not ((confidences > -1e-6) & (confidences < 1 + 1e-6) | ~np.isfinite(confidences)).all():
        raise ValueError(
            "detections: confidence goes beyond 0..1; scale it, or give None where it is unknown"
        )
    return finite_boxes.without(
        np.isfinite(confidences), lambda rows: _left_out(name, "without a number as confidence", rows, count)
    )


def _left_out(name: str, fault: str, rows: Sequence[int], count: int, advice: str = "") -> str:
    noun, verb = ("box" if count == 1 else "boxes"), ("is" if len(rows) == 1 else "are")
    return f"{name}: {len(rows)} of {count} {noun} {verb} {fault} and left out: row {few(rows)}{advice}"


def _with_corners(detections: Any) -> Any:
    """The object itself, or the boxes of an ultralytics `Results` under the names that supervision has."""
    boxes: Any = None if hasattr(detections, "xyxy") else getattr(detections, "boxes", None)
    if not all(hasattr(boxes, name) for name in ("xyxy", "conf", "cls")):
        return detections
    corners, scores, classes = (fetched(array) for array in (boxes.xyxy, boxes.conf, boxes.cls))
    names = [str(detections.names.get(int(number), int(number))) for number in classes]
    return SimpleNamespace(xyxy=corners, confidence=scores, data={"class_name": names})


def _corners(detections: Any) -> Floats:
    if not hasattr(detections, "xyxy"):
        raise TypeError(
            "detections have xyxy (n, 4) and confidence (n,), as supervision.Detections has; "
            f"{type(detections).__name__} has no xyxy: types.SimpleNamespace(xyxy=…, confidence=…) will do"
        )
    corners = _numbers("xyxy", detections.xyxy)
    if corners.shape == (0,):  # an empty list
        corners = corners.reshape(0, 4)
    if corners.ndim != 2 or corners.shape[1] != 4:
        raise ValueError(
            f"detections: xyxy of shape {corners.shape}; allowed: (n, 4), a row left, top, right, bottom for "
            "each box"
        )
    return corners


def _scores(detections: Any, count: int) -> Floats:
    confidence = getattr(detections, "confidence", None)
    scores = np.ones(count) if confidence is None else _numbers("confidence", confidence)
    _check_one_each("confidence", scores.shape, count)
    return scores


def _labels(detections: Any, count: int, graph: CheckedGraph) -> tuple[str, ...]:
    data = getattr(detections, "data", None)
    if data is not None and not isinstance(data, Mapping):
        raise ValueError(
            f"detections: data is of type {type(data).__name__}; allowed: a dict, whose class_name has a "
            'name for each box: data={"class_name": names}, or None'
        )
    names = (data or {}).get("class_name")
    if names is not None:
        _check_one_each('data["class_name"]', np.shape(names), count)
        return tuple(map(str, names))
    confusion = next((pair for plate in graph.targets.values() for pair in plate.confusions.items()), None)
    if confusion is not None and count:
        agent, category = confusion
        raise ValueError(
            f'detections without data["class_name"]; agent {agent} of the graph takes labels as evidence of '
            f"{category}: give a name for each box, an empty one where it is unknown"
        )
    births = (plate.spec.birth for plate in graph.targets.values())
    accepted = [label for birth in births if birth is not None for label in birth.labels]
    if accepted and count:
        raise ValueError(f'detections without data["class_name"]; the graph takes {", ".join(accepted)} only')
    return ("",) * count


def _numbers(name: str, column: Any) -> Floats:
    """The values as float64: NaN where they are masked."""
    try:
        if isinstance(column, np.ma.MaskedArray):
            return np.asarray(np.ma.filled(np.ma.asarray(column, dtype=np.float64), np.nan))
        values = np.asarray(column)
        if values.dtype.kind in KINDS:
            raise TypeError(KINDS[values.dtype.kind])
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"detections: {name} holds something else than real numbers: {error}") from error


def _check_one_each(name: str, shape: tuple[int, ...], count: int) -> None:
    if shape != (count,):
        boxes = "box" if count == 1 else "boxes"
        raise ValueError(
            f"detections: {name} of shape {shape} for {count} {boxes}; allowed: ({count},), one for each row "
            "of xyxy; leave it out or give None where it is unknown"
        )
