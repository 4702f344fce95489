"""Detections as a program has them: what of them can be used, and in which row it stands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import centre_from_xyxy, xyxy_from_centre
from bayesnet_track.observation.detector import Detections
from bayesnet_track.sources.entrances.boxes import describe_unusable, usable
from bayesnet_track.sources.entrances.notices import few, notice

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
    """

    detections: Detections
    rows: NDArray[np.int64]
    count: int

    def kept(self, fits: NDArray[np.bool_]) -> GivenDetections:
        """Detections for which `fits` (N,) is true."""
        if fits.all():
            return self
        one, labels = self.detections, self.detections.labels
        chosen = tuple(labels[row] for row in np.flatnonzero(fits))
        return GivenDetections(
            Detections(one.boxes[fits], one.scores[fits], chosen), self.rows[fits], self.count
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
        apart = np.abs(2.0 * boxes[:, :2] - (width - 1, height - 1)) >= boxes[:, 2:] + (width, height)
        found = self.without(
            np.asarray(~apart.any(axis=1)),
            lambda rows: _left_out(
                f"outside of the frames of {width}x{height} px", rows, self.count,
                "; DetectionsTracker(size=(width, height)) sets their size where no frame is given",
            ),
        )  # fmt: skip
        return found.without(
            found.detections.boxes[:, 2:].prod(axis=1) >= LEAST_AREA_PX,
            lambda rows: _left_out("smaller than 1 px²", rows, self.count, _advice(found.detections.boxes)),
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


def read_given(detections: Any, graph: CheckedGraph) -> GivenDetections:
    """The usable rows of an object with `xyxy`, `confidence`, and `data`; a notice names the others.

    Raises:
        TypeError: it has no `xyxy`.
        ValueError: boxes that are not (n, 4) numbers, confidences beyond 0..1, no class names for a graph
            with `labels`, or not one confidence or name for each box.
    """
    corners = _corners(detections)
    count = len(corners)
    scores, labels = _scores(detections, count), _labels(detections, count, graph)
    with np.errstate(invalid="ignore"):
        sizes = corners[:, 2:] - corners[:, :2]
    fits = usable(np.concatenate([corners[:, :2], sizes], axis=1))
    boxes = centre_from_xyxy(np.where(fits[:, None], corners, 0.0))
    every = GivenDetections(Detections(boxes, scores, labels), np.arange(count), count)
    found = every.without(fits, lambda rows: f"detections: {describe_unusable(count, rows, 'row')}")
    known = found.detections.scores
    if not ((known > -1e-6) & (known < 1 + 1e-6) | ~np.isfinite(known)).all():
        raise ValueError(
            "detections: confidence goes beyond 0..1; scale it, or give None where it is unknown"
        )
    return found.without(
        np.isfinite(known), lambda rows: _left_out("without a number as confidence", rows, count)
    )


def _left_out(what: str, rows: Sequence[int], count: int, advice: str = "") -> str:
    noun, verb = ("box" if count == 1 else "boxes"), ("is" if len(rows) == 1 else "are")
    return f"detections: {len(rows)} of {count} {noun} {verb} {what} and left out: row {few(rows)}{advice}"


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
    given = getattr(detections, "confidence", None)
    scores = np.ones(count) if given is None else _numbers("confidence", given)
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
    births = (plate.spec.birth for plate in graph.targets.values())
    wanted = [label for birth in births if birth is not None for label in birth.labels]
    if wanted and count:
        raise ValueError(f'detections without data["class_name"]; the graph takes {", ".join(wanted)} only')
    return ("",) * count


def _numbers(name: str, given: Any) -> Floats:
    """The values as float64: NaN where they are masked."""
    try:
        if isinstance(given, np.ma.MaskedArray):
            return np.asarray(np.ma.filled(np.ma.asarray(given, dtype=np.float64), np.nan))
        values = np.asarray(given)
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
