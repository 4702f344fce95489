"""A tracker of detections with the `update` of Roboflow's `trackers`, for pipelines that already detect."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.passes import overlapping_pairs
from bayesnet_track.engine.rows.row_metrics import RowMetrics
from bayesnet_track.engine.starts import start_targets
from bayesnet_track.engine.step import Engine, State, make_engine, step
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.text.wording import plural
from bayesnet_track.numerics.boxes import centre_from_xyxy
from bayesnet_track.observation.detector import GIVEN, NOTHING, Detections, DetectorState
from bayesnet_track.observation.planes import Frame, FramePair
from bayesnet_track.sources.images import to_bgr

NO_TARGET = -1
"""The `tracker_id` of a detection that belongs to no target, or to one that is not confirmed yet."""

LEAST_OVERLAP = 0.3


@dataclass
class _Fed:
    """A detector that finds what it is given."""

    now: Detections = field(default=NOTHING)

    def start(self) -> DetectorState:
        return {}

    def detect(self, frames: FramePair, state: DetectorState) -> tuple[Detections, DetectorState]:
        return self.now, state


class DetectionsTracker:
    """Give the detections of each frame the identities of targets, by a graph whose births use `detections`.

    Args:
        graph: name or path of the graph, or the graph itself.
        size: width and height of the frames in px, where `update` is given none.
        seed: seed of all randomness.

    Raises:
        GraphError: every error of the graph.

    Example::

        tracker = DetectionsTracker("kalman_detections", size=(640, 480))
        detections = tracker.update(detections)  # an object like supervision's Detections
        detections.tracker_id                    # (n,) int: the target of each box, -1 for none
    """

    def __init__(
        self,
        graph: str | PathLike[str] | GraphSpec | CheckedGraph = "kalman_detections",
        size: tuple[int, int] = (1920, 1080),
        seed: int = 0,
    ) -> None:
        self._graph, self._seed = load_graph(graph), seed
        self._blank: NDArray[np.uint8] = np.zeros((size[1], size[0], 3), np.uint8)
        self.reset()

    def reset(self) -> None:
        """Forget all targets: another video begins."""
        self._fed = _Fed()
        self._engine: Engine = make_engine(self._graph, self._seed, detectors={GIVEN: self._fed})
        self._state: State | None = None
        self._index = 0
        self._metrics: Sequence[FrameMetrics] = ()

    @property
    def targets(self) -> tuple[FrameMetrics, ...]:
        """What was measured of every target in the last frame, also of lost ones."""
        return tuple(self._metrics)

    def __repr__(self) -> str:
        """The graph, the frames so far, and the targets."""
        count = len(self._metrics)
        live = "; ".join(map(repr, self._metrics[:3])) + ("; …" if count > 3 else "")
        frames = f"{plural(self._index, 'frame')}, {plural(count, 'target')}"
        return f"<DetectionsTracker {self._graph.spec.name!r}, {frames}{': ' + live if live else ''}>"

    def update(self, detections: Any, frame: NDArray[np.uint8] | None = None) -> Any:
        """A copy of the detections with `tracker_id`, (n,) int64; `targets` has all that was measured.

        Args:
            detections: with `xyxy` (n, 4) in px and, if it has them, `confidence` (n,) in 0..1 and
                `data["class_name"]` (n,), which a graph with `labels` needs. Boxes outside of the frame are
                left out with a warning.
            frame: the BGR frame, for graphs that look at it.

        Raises:
            TypeError: detections without `xyxy`, such as an array.
            ValueError: boxes that are not (n, 4) finite numbers with an area, confidences beyond 0..1, no
                class names for a graph with `labels`, or not one confidence or name for each box; the
                tracker stays as it was.
        """
        boxes = _boxes(detections)
        self._fed.now = Detections(
            boxes, _scores(detections, len(boxes)), self._labels(detections, len(boxes))
        )
        image, has_color = to_bgr(self._blank if frame is None else np.array(frame))
        height, width = image.shape[:2]
        if (np.abs(2.0 * boxes[:, :2] - (width - 1, height - 1)) >= boxes[:, 2:] + (width, height)).any():
            message = f"boxes outside of the frames of {width}x{height} px are left out"
            warnings.warn(f"{message}; DetectionsTracker(size=(width, height)) sets their size", stacklevel=2)
        now = Frame(self._index, float(self._index), image, has_color, math.nan, None)
        if self._state is None:
            outcome = start_targets(self._graph, self._engine, now, [])
        else:
            outcome = step(self._engine, self._state, now)
        self._state, self._index, self._metrics = outcome.state, self._index + 1, outcome.metrics
        marked = copy.copy(detections)
        marked.tracker_id = owners(boxes, self._metrics)
        return marked

    def _labels(self, detections: Any, count: int) -> tuple[str, ...]:
        names = (getattr(detections, "data", None) or {}).get("class_name")
        if names is not None:
            _check_one_each('data["class_name"]', np.shape(names), count)
            return tuple(map(str, names))
        births = (plate.spec.birth for plate in self._graph.targets.values())
        wanted = [label for birth in births if birth is not None for label in birth.labels]
        if wanted and count:
            raise ValueError(
                f'detections without data["class_name"]; the graph takes {", ".join(wanted)} only'
            )
        return ("",) * count


def owners(boxes: NDArray[np.float64], targets: Sequence[FrameMetrics]) -> NDArray[np.int64]:
    """The target of each centre box (n, 4), best overlaps first; a target has one at most."""
    ids, places = _held(targets)
    found = np.full(len(boxes), NO_TARGET, dtype=np.int64)
    columns, rows, shares = overlapping_pairs(places, boxes)
    order = np.lexsort((columns, rows, -shares))
    best = order[shares[order] >= LEAST_OVERLAP]
    taken: set[int] = set()
    for row, column in zip(rows[best].tolist(), columns[best].tolist(), strict=True):
        if found[row] == NO_TARGET and column not in taken:
            found[row] = int(ids[column])
            taken.add(column)
    return found


def _held(targets: Sequence[FrameMetrics]) -> tuple[list[str], NDArray[np.float64]]:
    """Ids and (T, 4) centre boxes of the targets that are not lost."""
    if isinstance(targets, RowMetrics):
        return targets.held()
    held = [one for one in targets if one.status != "lost"]
    return [one.target for one in held], np.array([one.centre_box for one in held]).reshape(-1, 4)


def _scores(detections: Any, count: int) -> NDArray[np.float64]:
    given = getattr(detections, "confidence", None)
    scores = np.ones(count) if given is None else np.asarray(given, dtype=np.float64)
    _check_one_each("confidence", scores.shape, count)
    if not ((scores > -1e-6) & (scores < 1 + 1e-6)).all():
        raise ValueError(
            "detections: confidence goes beyond 0..1; scale it, or give None where it is unknown"
        )
    return scores


def _check_one_each(name: str, shape: tuple[int, ...], count: int) -> None:
    if shape != (count,):
        boxes = "box" if count == 1 else "boxes"
        raise ValueError(
            f"detections: {name} of shape {shape} for {count} {boxes}; allowed: ({count},), one for each row "
            "of xyxy; leave it out or give None where it is unknown"
        )


def _boxes(detections: Any) -> NDArray[np.float64]:
    if not hasattr(detections, "xyxy"):
        raise TypeError(
            "detections have xyxy (n, 4) and confidence (n,), as supervision.Detections has; "
            f"{type(detections).__name__} has no xyxy: types.SimpleNamespace(xyxy=…, confidence=…) will do"
        )
    corners = np.asarray(detections.xyxy, dtype=np.float64)
    if corners.shape == (0,):  # an empty list
        corners = corners.reshape(0, 4)
    if corners.ndim != 2 or corners.shape[1] != 4:
        raise ValueError(
            f"detections: xyxy of shape {corners.shape}; allowed: (n, 4), a row left, top, right, bottom for "
            "each box"
        )
    if not np.isfinite(corners).all() or (corners[:, 2:] <= corners[:, :2]).any():
        raise ValueError("detections: xyxy needs finite boxes left, top, right, bottom, with an area")
    return centre_from_xyxy(corners)
