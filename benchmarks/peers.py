"""OpenCV's trackers as peers, with the settings of OpenCV's samples; alone, a server of their passes.

Needs NumPy and OpenCV only. `real_video.Elsewhere` starts it with the interpreter of an environment that
has `opencv-contrib-python-headless` (CSRT and KCF are in that build only). With a folder as its argument
NanoTrack takes part, too, by the two model files there. Requests and answers are JSON objects, a line each.
"""

from __future__ import annotations

import json
import sys
import time
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


def peers() -> Mapping[str, Callable[[], Peer]]:
    """Name -> factory, of those that the installed OpenCV has; CSRT and KCF are in its contrib build only."""
    found: dict[str, Callable[[], Peer]] = {}
    for name in ("CSRT", "KCF", "MIL"):
        create = getattr(getattr(cv2, f"Tracker{name}", None), "create", None)
        if create is not None:
            found[name] = partial(Whole, create)
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


def main() -> None:
    """Say which trackers there are, then answer requests, one JSON object a line."""
    cv2.setNumThreads(1)
    known = {**peers(), **(nanotrack(Path(sys.argv[1])) if len(sys.argv) > 1 else {})}
    print(json.dumps({"opencv": cv2.__version__, "trackers": list(known)}), flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        cv2.setRNGSeed(asked["seed"])
        tracker = known[asked["tracker"]]()
        box = tuple(float(value) for value in asked["box"])
        boxes, lost, scores, seconds = [box], [False], [1.0], 0.0
        for index, file in enumerate(asked["files"]):
            image = np.asarray(cv2.imread(file, cv2.IMREAD_COLOR), dtype=np.uint8)
            started = time.process_time()
            if index == 0:
                tracker.init(image, box)
                continue
            ok, found = tracker.update(image)
            seconds += time.process_time() - started
            boxes.append(found)
            lost.append(not ok)
            scores.append(getattr(tracker, "score", 1.0))
        answer = {"boxes": boxes, "lost": lost, "scores": scores, "cpu_s": seconds}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
