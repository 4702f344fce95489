"""OpenCV's trackers as peers: one interface, with the settings that OpenCV's samples have."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Corner = tuple[float, float, float, float]


class Peer(Protocol):
    """A tracker as OpenCV has it; boxes are x, y, w, h with the top-left corner, px."""

    def init(self, image: Image, box: Corner) -> None:
        """Start in the box."""
        ...

    def update(self, image: Image) -> tuple[bool, Corner]:
        """(whether it still tracks, the box) in the next picture."""
        ...


class Whole:
    """One of OpenCV's own trackers, which want whole pixels; where it gives up it keeps its last box."""

    def __init__(self, create: Callable[[], Peer]) -> None:
        self._tracker = create()
        self._box: Corner = (0.0, 0.0, 0.0, 0.0)

    def init(self, image: Image, box: Corner) -> None:
        """Start in the box."""
        self._box = box
        x, y, w, h = (round(value) for value in box)
        self._tracker.init(image, (x, y, w, h))

    @property
    def score(self) -> float:
        """Its own score of the last picture; 1 where it has none."""
        of = getattr(self._tracker, "getTrackingScore", None)
        return 1.0 if of is None else float(of())

    def update(self, image: Image) -> tuple[bool, Corner]:
        """The box in the next picture."""
        ok, (x, y, w, h) = self._tracker.update(image)
        if ok and w > 0 and h > 0:
            self._box = (float(x), float(y), float(w), float(h))
        return ok, self._box


class MeanShift:
    """`cv2.meanShift` on the back-projection of the first box's hue histogram."""

    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 10, 1)

    def init(self, image: Image, box: Corner) -> None:
        """Start in the box."""
        height, width = image.shape[:2]
        x, y, w, h = (round(value) for value in box)
        x, y = max(x, 0), max(y, 0)
        self._window = (x, y, max(1, min(w, width - x)), max(1, min(h, height - y)))
        x, y, w, h = self._window
        hsv, colourful = self._hue(image)
        part = np.s_[y : y + h, x : x + w]
        self._histogram = cv2.calcHist([hsv[part]], [0], colourful[part], [16], [0, 180])
        cv2.normalize(self._histogram, self._histogram, 0, 255, cv2.NORM_MINMAX)

    def update(self, image: Image) -> tuple[bool, Corner]:
        """The box in the next picture."""
        hsv, colourful = self._hue(image)
        back = cv2.calcBackProject([hsv], [0], self._histogram, [0, 180], 1) & colourful
        _, self._window = cv2.meanShift(back, self._window, self.stop)
        x, y, w, h = self._window
        return True, (float(x), float(y), float(w), float(h))

    @staticmethod
    def _hue(image: Image) -> tuple[Image, Image]:
        hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
        return hsv, cv2.inRange(hsv, (0, 60, 32), (180, 255, 255))


def peers() -> Mapping[str, Callable[[], Peer]]:
    """Name -> factory, of those that the installed OpenCV has; CSRT and KCF are in its contrib build only."""
    found: dict[str, Callable[[], Peer]] = {}
    for name in ("CSRT", "KCF", "MIL"):
        create = getattr(getattr(cv2, f"Tracker{name}", None), "create", None)
        if create is not None:
            found[name] = partial(Whole, create)
    found["mean shift"] = MeanShift
    return found


def nanotrack(folder: Path) -> Mapping[str, Callable[[], Peer]]:
    """NanoTrack with `*backbone*.onnx` and `*head*.onnx` of the folder, as OpenCV's `TrackerNano`."""

    def create() -> Peer:
        given = cv2.TrackerNano.Params()
        given.backbone = str(next(folder.glob("*backbone*.onnx")))
        given.neckhead = str(next(folder.glob("*head*.onnx")))
        tracker: Peer = cv2.TrackerNano.create(given)
        return tracker

    return {"NanoTrack": partial(Whole, create)}
