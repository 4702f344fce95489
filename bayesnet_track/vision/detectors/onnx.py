"""Detector: any detection network in an ONNX file, run by OpenCV; the layouts of such networks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.detector import (
    Detections,
    Detector,
    DetectorDeclaration,
    DetectorError,
    DetectorParameters,
    DetectorState,
)
from bayesnet_track.observation.planes import FramePair
from bayesnet_track.vision.detectors.selection import select
from bayesnet_track.vision.model_files import ModelFile
from bayesnet_track.vision.siamese_networks import check_apart, read_onnx, reason_of


class LayoutError(ValueError):
    """An output that is not of the layout."""


@dataclass(frozen=True, eq=False)
class NetworkOutput:
    """A network's output.

    Attributes:
        boxes: (N, 4) x, y, w, h with the middle of the box, from the input's top-left edge.
        scores: (N,).
        classes: (N,) number of the class; -1 where there are none.
        distinguished: how many classes have a score of their own; None where the output does not tell.
    """

    boxes: Floats
    scores: Floats
    classes: NDArray[np.int64]
    distinguished: int | None = None


def rows(output: Floats) -> NetworkOutput:
    """(N, 5) x, y, w, h, score."""
    table = _table(output, 5, 5, "rows of x, y, w, h, score")
    return NetworkOutput(table[:, :4], table[:, 4], np.full(len(table), -1))


def yolo(output: Floats) -> NetworkOutput:
    """(N, 4 + C) x, y, w, h and the score of each class, or its transpose."""
    return _best_class(_table(output, 5, None, "rows of x, y, w, h and a score for each class"))


def yolo_objectness(output: Floats) -> NetworkOutput:
    """(N, 5 + C) x, y, w, h, score of any object, and that of each class given an object."""
    table = _table(output, 6, None, "rows of x, y, w, h, objectness and a score for each class")
    return _best_class(np.concatenate([table[:, :4], table[:, 5:] * table[:, 4:5]], axis=1))


STRIDES = (8, 16, 32)
"""Pixels of the input between the cells of each of YOLOX's grids, in the order of its rows."""


def from_grids(raw: NetworkOutput, width: int, height: int) -> NetworkOutput:
    """Boxes of YOLOX in pixels of the input: given from their cell, in cells, the sides as logarithms.

    Raises:
        LayoutError: there are more or fewer rows than cells.
    """
    cells = []
    for stride in STRIDES:
        y, x = np.mgrid[: height // stride, : width // stride]
        cells.append(np.stack([x, y, np.full_like(x, stride)], axis=-1).reshape(-1, 3))
    grid = np.concatenate(cells).astype(np.float64)
    if len(grid) != len(raw.boxes):
        raise LayoutError(
            f"gives {len(raw.boxes)} rows; the layout wants {len(grid)}, one for each cell of an input of "
            f"{width}x{height} px with strides {', '.join(map(str, STRIDES))}"
        )
    side = grid[:, 2:]
    sides = np.exp(np.minimum(raw.boxes[:, 2:], 20.0)) * side
    boxes = np.concatenate([(raw.boxes[:, :2] + grid[:, :2]) * side, sides], axis=1)
    return replace(raw, boxes=boxes)


def yolo_end_to_end(output: Floats) -> NetworkOutput:
    """(N, 6) x0, y0, x1, y1, score, class: what is left after the network's own suppression."""
    table = _table(output, 6, 6, "rows of x0, y0, x1, y1, score, class")
    table = table[np.isfinite(table).all(axis=1)]
    return NetworkOutput(_centred(table[:, :4]), table[:, 4], table[:, 5].astype(np.int64))


def ssd(output: Floats) -> NetworkOutput:
    """(N, 7) image, class, score, x0, y0, x1, y1; rows of another image than 0 are left out."""
    table = _table(output, 7, 7, "rows of image, class, score, x0, y0, x1, y1")
    table = table[np.isfinite(table).all(axis=1) & (table[:, 0] == 0)]
    return NetworkOutput(_centred(table[:, 3:]), table[:, 2], table[:, 1].astype(np.int64))


LAYOUTS: Mapping[str, Callable[[Floats], NetworkOutput]] = MappingProxyType(
    {
        "rows": rows,
        "yolo": yolo,
        "yolo_objectness": yolo_objectness,
        "yolox": yolo_objectness,
        "yolo_end_to_end": yolo_end_to_end,
        "ssd": ssd,
    }
)


def fitting(outputs: Sequence[Floats], layout: str) -> NetworkOutput:
    """Detections of the one output that is of the layout; raises LayoutError where none or several are."""
    readings, refused = [], []
    for output in outputs:
        try:
            readings.append(LAYOUTS[layout](output))
        except LayoutError as error:
            refused.append(error)
    if len(readings) == 1:
        return readings[0]
    if len(outputs) == 1:
        raise refused[0]
    shapes = ", ".join(_shape(output) for output in outputs)
    raise LayoutError(
        f"gives outputs of {shapes}; {len(readings)} of them fit layout {layout}, one is needed"
    )


def _best_class(table: Floats) -> NetworkOutput:
    classes = table[:, 4:].argmax(axis=1)
    scores = table[np.arange(len(table)), 4 + classes]
    return NetworkOutput(table[:, :4], scores, classes.astype(np.int64), table.shape[1] - 4)


def _centred(corners: Floats) -> Floats:
    """(N, 4) x0, y0, x1, y1 as x, y, w, h with the middle of the box."""
    low, high = corners[:, :2], corners[:, 2:]
    return np.concatenate([(low + high) / 2, high - low], axis=1)


def _shape(output: Floats) -> str:
    return " x ".join(str(side) for side in output.shape)


def _table(output: Floats, min_columns: int, max_columns: int | None, layout_words: str) -> Floats:
    """The output as (N, columns), without sides of 1 in front, and turned where columns come first."""
    table = output
    while table.ndim > 2 and table.shape[0] == 1:
        table = table[0]
    if table.ndim == 2:
        fits = [min_columns <= side and (max_columns is None or side <= max_columns) for side in table.shape]
        # With as many classes as may be, rows are the longer side: a network gives more boxes than classes.
        first = table.shape[0] < table.shape[1] if max_columns is None else fits[0] and not fits[1]
        table = table.T if first and fits[0] else table
        if (fits[0] if first else fits[1]) or table.size == 0:
            return np.asarray(table)
    raise LayoutError(f"gives an output of {_shape(output)}; the layout wants {layout_words}")


class OnnxParameters(DetectorParameters):
    """Parameters of a detection network."""

    model: ModelFile = Field(description="ONNX file (path).")
    input_width: int = Field(default=640, ge=8, le=8192, description="Width of the network's input (px).")
    input_height: int = Field(default=640, ge=8, le=8192, description="Height of the network's input (px).")
    fit: Literal["letterbox", "stretch"] = Field(
        default="letterbox", description="The frame keeps its shape, with a gray rim, or is stretched."
    )
    scale: float = Field(
        default=1 / 255, gt=0, description="Gray levels are multiplied by this, after the mean is taken off."
    )
    mean: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="Taken off the channels in the network's order (gray levels)."
    )
    channels: Literal["rgb", "bgr"] = Field(default="rgb", description="Order of the network's channels.")
    layout: Literal["rows", "yolo", "yolo_objectness", "yolox", "yolo_end_to_end", "ssd"] = Field(
        default="rows",
        description="Output: `rows` of x, y, w, h, score; `yolo` of x, y, w, h, score of each class; "
        "`yolo_objectness` with one more score before these, which multiplies them; `yolox` the same, with "
        "boxes in cells of its grids; `yolo_end_to_end` of x0, y0, x1, y1, score, class; `ssd` of image, "
        "class, score, x0, y0, x1, y1. x, y are centres.",
    )
    units: Literal["px", "share"] = Field(
        default="px", description="Boxes are in pixels of the input, or in shares of it."
    )
    classes: tuple[str, ...] = Field(
        default=(), max_length=10000, description="Names of the classes, from number 0 on."
    )
    keep: tuple[str, ...] = Field(
        default=(), description="Classes that are kept (names, or numbers as text); all when empty."
    )
    min_score: float = Field(default=0.4, ge=0, le=1, description="Least score of a detection (0..1).")


@dataclass(frozen=True, eq=False)
class Onnx:
    """Runs the network on each frame on its own; no state."""

    parameters: OnnxParameters
    forward: Callable[[Any], Any]

    def start(self) -> DetectorState:
        """Nothing to remember."""
        return {}

    def detect(self, frames: FramePair, state: DetectorState) -> tuple[Detections, DetectorState]:
        """Detections of the network; raises DetectorError where its output is not of the layout."""
        frame, settings = frames.current, self.parameters
        shrink, rim, blob = self._input(frame.image)
        raw = self._read_outputs(self.forward(blob))
        boxes = raw.boxes.copy()
        if settings.units == "share":
            boxes *= np.tile([settings.input_width, settings.input_height], 2)
        # An edge at 0 of the network is the frame's edge, which is half a pixel left of its first centre.
        boxes[:, :2] = (boxes[:, :2] - rim) / shrink - 0.5
        boxes[:, 2:] /= shrink
        labels = [self._label(number) for number in raw.classes]
        scores = raw.scores
        if settings.keep:
            named = zip(labels, raw.classes, strict=True)
            indices = [
                k for k, names in enumerate(named) if not {str(n) for n in names}.isdisjoint(settings.keep)
            ]
            boxes, scores, labels = boxes[indices], scores[indices], [labels[k] for k in indices]
        return select(boxes, scores, frame, settings, labels), state

    def _input(self, image: NDArray[np.uint8]) -> tuple[Floats, Floats, Any]:
        """(2,) pixels of the input per pixel of the frame; (2,) rim before it, px; the (1, 3, H, W) input."""
        import cv2

        settings = self.parameters
        size = np.array([settings.input_width, settings.input_height], dtype=np.float64)
        frame = np.array(image.shape[1::-1], dtype=np.float64)
        inner = size if settings.fit == "stretch" else np.maximum(np.rint(frame * (size / frame).min()), 1.0)
        rim = np.floor((size - inner) / 2)
        canvas = np.full((settings.input_height, settings.input_width, 3), 114, dtype=np.uint8)
        (x, y), (w, h) = rim.astype(int), inner.astype(int)
        smaller = bool((inner < frame).any())
        canvas[y : y + h, x : x + w] = cv2.resize(
            np.ascontiguousarray(image),
            (int(w), int(h)),
            interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR,
        )
        if settings.channels == "rgb":
            canvas = canvas[:, :, ::-1]
        values = (canvas.astype(np.float32) - np.array(settings.mean, dtype=np.float32)) * np.float32(
            settings.scale
        )
        return inner / frame, rim, np.ascontiguousarray(values.transpose(2, 0, 1)[None])

    def check(self) -> None:
        """Run the network on a black frame; raises DetectorError where it and the parameters do not fit."""
        settings = self.parameters
        black = np.zeros((1, 3, settings.input_height, settings.input_width), np.float32)
        classes, names = self._read_outputs(self.forward(black)).distinguished, settings.classes
        if classes is not None and names and len(names) != classes:
            raise DetectorError(
                f"{settings.model}: gives scores for {classes} classes, and `classes` names {len(names)}; a "
                "network for segmentation or poses has further columns, and is not supported"
            )
        for label in settings.keep:
            is_number = label.isdecimal() and (classes is None or int(label) < classes)
            if label not in names and not is_number:
                class_names = ", ".join(names) or "none: give `classes`, or numbers"
                numbers = "" if classes is None else f"; numbers 0 to {classes - 1}"
                raise DetectorError(f"`keep` has {label!r}; names of classes: {class_names[:300]}{numbers}")

    def _read_outputs(self, outputs: Any) -> NetworkOutput:
        settings = self.parameters
        try:
            arrays = [np.asarray(output, dtype=np.float64) for output in outputs]
            raw = fitting(arrays, settings.layout)
            if settings.layout == "yolox":
                raw = from_grids(raw, settings.input_width, settings.input_height)
            return raw
        except LayoutError as error:
            raise DetectorError(f"{settings.model}: {error}") from error

    def _label(self, number: int) -> str:
        names = self.parameters.classes
        if number < 0:
            return names[0] if len(names) == 1 else ""
        return names[number] if number < len(names) else str(number)


def _make(parameters: OnnxParameters) -> Detector:
    from pathlib import Path

    path = Path(parameters.model)
    if not path.is_file():
        raise DetectorError(
            f"{path}: no such model file; the key model of the detector onnx takes the path of an ONNX file"
        )
    settings = parameters.model_dump(mode="json")
    check_apart(try_network, [parameters.model], DetectorError, parameters=settings)
    return _load(parameters)


def try_network(parameters: Mapping[str, Any]) -> None:
    """Load and run the network of these parameters once."""
    _load(OnnxParameters(**parameters))


def _load(parameters: OnnxParameters) -> Detector:
    import cv2

    path = parameters.model
    network = read_onnx(path, DetectorError)
    size = f"{parameters.input_width}x{parameters.input_height}"

    def forward(blob: Any) -> Any:
        try:
            network.setInput(blob)
            return network.forward(network.getUnconnectedOutLayersNames())
        except cv2.error as error:
            raise DetectorError(
                f"{path}: does not run on a 3-channel input of {size} px (input_width, "
                f"input_height: as it was exported): {reason_of(error)}"
            ) from error

    detector = Onnx(parameters, forward)
    detector.check()
    return detector


DETECTOR = DetectorDeclaration(
    name="onnx",
    summary="A detection network in an ONNX file.",
    parameters=OnnxParameters,
    make=_make,
    cost_ms=200.0,
    files=lambda parameters: (parameters.model,),
)
