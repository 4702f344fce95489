"""The detector contract: declaration, detections, detectors of plug-ins, what sensors saw in one frame.

A detector looks at the whole frame and needs no hypotheses: it starts targets and finds lost ones again. Like
a cue it comes in two halves, a *declaration* that is cheap to import and an *implementation* made from the
parameters. Detectors are found through the entry-point group ``bayesnet_track.detectors``; the built-in ones
use it too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import real_numbers
from bayesnet_track.observation.planes import Frame, FramePair
from bayesnet_track.observation.plugins import installed
from bayesnet_track.observation.settings import setting

ENTRY_POINT_GROUP = "bayesnet_track.detectors"

DetectorState = Mapping[str, NDArray[Any]]
"""What a detector remembers between frames: arrays by name, so that it can be stored; maybe none."""


class DetectorError(ValueError):
    """A detector that cannot work: its model file is wrong, or the source lacks what it needs."""


class DetectorParameters(BaseModel):
    """Base of a detector's parameters: unknown keys refused, values immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False, allow_inf_nan=False)

    min_score: float = Field(default=0.2, ge=0, le=1, description="Least score of a detection (0..1).")
    min_area_px: float = Field(default=50.0, ge=1, description="Least area of a detection's box (pixels).")
    max_area_share: float = Field(
        default=0.5, gt=0, le=1, description="Largest area of a detection's box (share of the frame)."
    )
    max_overlap: float = Field(
        default=0.5,
        ge=0,
        le=1,
        description="Of two boxes with a larger intersection over union only the better one is kept (0..1).",
    )
    max_count: int = Field(
        default=32, ge=1, le=10_000, description="Detections kept of a frame, the best (count)."
    )


class GivenParameters(DetectorParameters):
    """Parameters of detections that are given: whoever made them has said which count."""

    min_area_px: float = Field(default=1.0, ge=1, description="Least area of a detection's box (pixels).")
    max_area_share: float = Field(
        default=1.0, gt=0, le=1, description="Largest area of a detection's box (share of the frame)."
    )
    max_count: int = Field(
        default=10_000, ge=1, le=10_000, description="Detections kept of a frame, the best (count)."
    )


@dataclass(frozen=True, eq=False)
class Detections:
    """Detections of one frame, the best first.

    Attributes:
        boxes: (N, 4) float64 centre boxes x, y, w, h in pixels.
        scores: (N,) 0..1.
        labels: what each is, N texts; empty texts where the detector does not tell kinds apart.
        cut: finds that count like the others, left out because they exceed `max_count`.
    """

    boxes: Floats
    scores: Floats
    labels: tuple[str, ...]
    cut: int = 0

    def __len__(self) -> int:
        return len(self.boxes)


GIVEN = "detections"
"""The name, in a graph, of a detector that is given from outside: detections that stand in a file."""


def of_camera(detector: str, camera: str) -> str:
    """The name of a detector in the images of one of several cameras; its own name with no camera.

    >>> of_camera(GIVEN, "north"), of_camera(GIVEN, "")
    ('detections of north', 'detections')
    """
    return f"{detector} of {camera}" if camera else detector


NOTHING = Detections(np.empty((0, 4)), np.empty(0), ())
"""No detection."""


def check_detections(detections: Detections) -> Detections:
    """A detector's answer with boxes and scores as float64 arrays: a detector is a guest's code.

    Raises:
        ValueError: anything but real numbers: (N, 4) boxes with area and N scores, all finite, and N labels.
    """
    boxes, scores = real_numbers(detections.boxes), real_numbers(detections.scores)
    for name, values in (("boxes", boxes), ("scores", scores)):
        if isinstance(values, str):
            raise ValueError(f"{name} of type {values}; allowed: real numbers")
    assert not isinstance(boxes, str) and not isinstance(scores, str)
    labels = tuple(detections.labels)
    if boxes.ndim != 2 or boxes.shape[1] != 4 or scores.shape != (len(boxes),) or len(labels) != len(boxes):
        counts = f"scores of shape {scores.shape}, {len(labels)} labels"
        raise ValueError(f"boxes of shape {boxes.shape}, {counts}; allowed: (N, 4), (N,), N")
    if not (np.isfinite(boxes).all() and np.isfinite(scores).all() and (boxes[:, 2:] > 0).all()):
        raise ValueError("boxes or scores that are not finite, or boxes without area")
    return Detections(boxes, scores, labels, int(detections.cut))


@runtime_checkable
class Detector(Protocol):
    """A detector at work: pure functions of frames and state. Holds no state of its own."""

    def start(self) -> DetectorState:
        """The state before the first frame."""

    def detect(self, frames: FramePair, state: DetectorState) -> tuple[Detections | None, DetectorState]:
        """Detections in the current frame, and the state for the next one.

        None says that it did not look: nobody is missed in such a frame.

        Arrays of `state` are not written to. Frames come in order, and may be left out; a frame of another
        size than the last one starts the detector anew.

        Raises:
            NoDepth: it needs depth and the frame has none.
            DetectorError: it cannot work on this frame.
        """


@runtime_checkable
class LearningDetector(Detector, Protocol):
    """A detector of one target's appearance, which it can be shown."""

    def learn(self, frames: FramePair, box: Floats, state: DetectorState) -> DetectorState:
        """The state that looks for what is inside the centre box (4,) of the current frame."""

    def knows_target(self, state: DetectorState) -> bool:
        """False when it has nothing to look for yet and so finds nothing."""


@dataclass(frozen=True)
class DetectorDeclaration:
    """Properties of a detector that are known without loading it.

    Attributes:
        name: the word that names it.
        summary: one line of what it sees.
        parameters: model of its parameters (a subclass of `DetectorParameters`), each with description, unit.
        make: parameters -> implementation; imports what is heavy; raises DetectorError.
        needs_color: True when it finds nothing in a gray source.
        needs_depth: True when it needs a second eye or a point map.
        cost_ms: declared price of a frame of 640x480 px (rules weigh with it, so that a run never depends on
            a clock).
        files: parameters -> paths of the files that it reads, such as a network's; runs record their SHA-256.
    """

    name: str
    summary: str
    parameters: type[DetectorParameters]
    make: Callable[[Any], Detector]
    needs_color: bool = False
    needs_depth: bool = False
    cost_ms: float = 10.0
    files: Callable[[Any], tuple[str, ...]] | None = None

    def check_source(self, has_color: bool, has_depth: bool) -> None:
        """Refuse a source in which it can find nothing; raises DetectorError."""
        if self.needs_color and not has_color:
            raise DetectorError(f"{self.name} needs colour, and the source is gray")
        if self.needs_depth and not has_depth:
            raise DetectorError(f"{self.name} needs depth, and the source is one eye")


def installed_detectors(named: Iterable[str] = ()) -> Mapping[str, DetectorDeclaration]:
    """The built-in detectors, and the allowed ones of `named` that other packages bring; by name, sorted.

    One that cannot be loaded is left out with a warning; see `plugins`.
    """
    return installed(ENTRY_POINT_GROUP, DetectorDeclaration, "detector", named)


def detectors_of_graphs(named: Iterable[str] = ()) -> Mapping[str, DetectorDeclaration]:
    """Detectors that a graph may name: those of `installed_detectors`, and `GIVEN`."""
    declaration = DetectorDeclaration(
        name=GIVEN,
        summary="What a file of detections holds.",
        parameters=GivenParameters,
        make=_not_given,
        cost_ms=0.0,
    )
    return {**installed_detectors(named), GIVEN: declaration}


def _not_given(parameters: DetectorParameters) -> Detector:
    way = setting("--detections", "FILE")
    raise DetectorError(f"the graph has births by {GIVEN}, and no file of them is given ({way})")


def detections_of(found: Any) -> Detections:
    """The detections of one frame that another library's detector gave, the best first.

    Args:
        found: `supervision.Detections` (xyxy, confidence, class_id, data["class_name"]), a `Results` of
            ultralytics (its boxes with xyxy, conf, cls; names), or any object with `xyxy`: (N, 4) left, top,
            right, bottom, px, where 0 is the edge of the first pixel. Arrays, or tensors on any device.

    Labels are class names; numbers as text where there are no names; empty where there are no classes. A
    detection without confidence has score 1, as a file's has.

    Raises:
        ValueError: no `xyxy`, or boxes, confidences or classes that do not fit; says which.
    """
    boxes = getattr(found, "boxes", None)
    boxes = found if boxes is None else boxes
    corners = getattr(boxes, "xyxy", None)
    if corners is None:
        raise ValueError(f"{type(found).__name__} without xyxy; allowed: (N, 4) left, top, right, bottom, px")
    corners = fetched(corners).reshape(-1, 4) if np.size(corners) == 0 else fetched(corners)
    if corners.ndim != 2 or corners.shape[1] != 4:
        raise ValueError(f"xyxy of shape {corners.shape}; allowed: (N, 4)")
    scores = _of_each(boxes, ("confidence", "conf"), len(corners))
    scores = np.ones(len(corners)) if scores is None else scores
    if not ((scores >= 0) & (scores <= 1)).all():
        raise ValueError(f"confidence {scores.min():g} .. {scores.max():g}; allowed: 0 .. 1")
    sides = corners[:, 2:] - corners[:, :2]
    centres = np.concatenate([corners[:, :2] + sides / 2 - 0.5, sides], axis=1)
    order = np.argsort(-scores, kind="stable")
    labels = _labels(found, boxes, len(corners))
    return check_detections(Detections(centres[order], scores[order], tuple(labels[k] for k in order)))


def fetched(values: Any) -> Floats:
    """The values of an array, a list or a tensor on any device."""
    host_values = values.cpu() if hasattr(values, "cpu") else values
    return np.asarray(host_values, dtype=np.float64)


def _of_each(boxes: Any, names: tuple[str, ...], count: int) -> Floats | None:
    """(count,) the first of these fields that is there."""
    for name in names:
        value = getattr(boxes, name, None)
        if value is not None:
            values = fetched(value).reshape(-1)
            if len(values) != count:
                raise ValueError(f"{name} of {len(values)} values for {count} boxes; allowed: one for each")
            return values
    return None


def _labels(results: Any, boxes: Any, count: int) -> list[str]:
    named = (getattr(results, "data", None) or {}) if isinstance(getattr(results, "data", None), dict) else {}
    if "class_name" in named:
        labels = [str(name) for name in named["class_name"]]
        if len(labels) != count:
            raise ValueError(f"class_name of {len(labels)} values for {count} boxes; allowed: one for each")
        return labels
    numbers = _of_each(boxes, ("class_id", "cls"), count)
    if numbers is None:
        return [""] * count
    names = getattr(results, "names", None)
    class_names = names if isinstance(names, dict) else dict(enumerate(names or ()))
    return [str(class_names.get(int(number), int(number))) for number in numbers]


@dataclass(frozen=True, eq=False)
class Scan:
    """Detections of one sensor at one time.

    Attributes:
        values: (N, K) a column for each of the sensor's quantities, in the order of its `sd`.
        scores: (N,) 0..1.
    """

    values: Floats
    scores: Floats

    def __len__(self) -> int:
        return len(self.values)


@runtime_checkable
class Scanner(Protocol):
    """Sensors at work: a pure function of the frame."""

    def scans(self, frame: Frame) -> Mapping[str, Scan]:
        """Agent -> what it saw, of those that looked in this frame; one may have seen nothing."""
