"""Detector: any detection network in an ONNX file, run by OpenCV."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
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
from bayesnet_track.vision.apart import check_apart
from bayesnet_track.vision.detectors.onnx_layouts import Found, LayoutError, fitting, from_grids
from bayesnet_track.vision.detectors.selection import select
from bayesnet_track.vision.opencv_errors import read_onnx, reason_of


class OnnxParameters(DetectorParameters):
    """Parameters of a detection network."""

    model: str = Field(description="ONNX file (path).")
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
        """What the network finds; raises DetectorError where its output is not of the layout."""
        frame, settings = frames.current, self.parameters
        shrink, rim, blob = self._input(frame.image)
        found = self._found(self.forward(blob))
        boxes = found.boxes.copy()
        if settings.units == "share":
            boxes *= np.tile([settings.input_width, settings.input_height], 2)
        # An edge at 0 of the network is the frame's edge, which is half a pixel left of its first centre.
        boxes[:, :2] = (boxes[:, :2] - rim) / shrink - 0.5
        boxes[:, 2:] /= shrink
        labels = [self._label(number) for number in found.classes]
        scores = found.scores
        if settings.keep:
            named = zip(labels, found.classes, strict=True)
            kept = [
                k for k, names in enumerate(named) if not {str(n) for n in names}.isdisjoint(settings.keep)
            ]
            boxes, scores, labels = boxes[kept], scores[kept], [labels[k] for k in kept]
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
        classes, names = self._found(self.forward(black)).distinguished, settings.classes
        if classes is not None and names and len(names) != classes:
            raise DetectorError(
                f"{settings.model}: gives scores for {classes} classes, and `classes` names {len(names)}; a "
                "network for segmentation or poses has further columns, and is not supported"
            )
        for label in settings.keep:
            is_number = label.isdecimal() and (classes is None or int(label) < classes)
            if label not in names and not is_number:
                known = ", ".join(names) or "none: give `classes`, or numbers"
                numbers = "" if classes is None else f"; numbers 0 to {classes - 1}"
                raise DetectorError(f"`keep` has {label!r}; names of classes: {known[:300]}{numbers}")

    def _found(self, outputs: Any) -> Found:
        settings = self.parameters
        try:
            arrays = [np.asarray(output, dtype=np.float64) for output in outputs]
            found = fitting(arrays, settings.layout)
            if settings.layout == "yolox":
                found = from_grids(found, settings.input_width, settings.input_height)
            return found
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
    given = parameters.model_dump(mode="json")
    check_apart(try_network, [parameters.model], DetectorError, parameters=given)
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
