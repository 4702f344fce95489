"""What detectors cost, how well they find rendered targets, and those of a real sequence in MOT layout.

Run ``python benchmarks/detectors.py [--mot FOLDER]``; FOLDER holds ``img1`` and ``gt/gt.txt``, such as
that of MOT15's TUD-Campus. Times are those of the processor, with one thread.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.detector import Detections, installed_detectors
from bayesnet_track.observation.planes import Frame, FramePair
from bayesnet_track.sources.scene_source import SceneSource
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.sources import open_source
from simulated.detection_score import DetectionScore, score_detections, total
from simulated.street import street

Floats = NDArray[np.float64]

PEOPLE = {
    "background": {"warm_up_frames": 10, "memory_frames": 100, "min_area_px": 2500, "join_px": 6},
    "motion": {"min_speed_px": 1.5, "min_area_px": 2500, "join_px": 4},
}
"""For people some 200 px tall: settings stated with the figures."""


def made(name: str, **parameters: Any) -> Any:
    """A detector at work."""
    declaration = installed_detectors()[name]
    return declaration.make(declaration.parameters(**parameters))


def run(detector: Any, frames: list[Frame]) -> tuple[list[Detections], list[float]]:
    """Detections of each frame, and the milliseconds that each took."""
    state, previous, found, costs = detector.start(), None, [], []
    for frame in frames:
        began = time.process_time()
        detections, state = detector.detect(FramePair(frame, previous), state)
        costs.append(1e3 * (time.process_time() - began))
        found.append(detections)
        previous = frame
    return found, costs


def costs() -> None:
    """Median milliseconds of a frame of 640x480 px, one thread."""
    import cv2

    print("detector               ms at 640x480, one thread (median of 12 frames)")
    scenes = {"stereo_blobs": make_scene("person_stereo", 0)}
    needed: dict[str, dict[str, Any]] = {"color_backprojection": {"hue_deg": 0}}
    for name in installed_detectors():
        if name in ("onnx", "contour_shape"):  # the cost is that of the network, of the number of contours
            continue
        frames = list(SceneSource(scenes.get(name, street(0)), name, 70))[56:]
        if name != "stereo_blobs":
            frames = [
                Frame(f.index, f.time, cv2.resize(f.image, (640, 480), interpolation=cv2.INTER_NEAREST))
                for f in frames
            ]
        _, taken = run(made(name, **needed.get(name, {})), frames)
        factor = 4.0 if name == "stereo_blobs" else 1.0
        print(
            f"{name:22} {factor * float(np.median(taken[2:])):6.1f}"
            + (" (4 x 320x240)" if factor > 1 else "")
        )


def read_mot(path: Path) -> dict[int, Floats]:
    """Frame (from 0) -> centre boxes (M, 4); corners in the file count from 1."""
    rows = np.loadtxt(path, delimiter=",", usecols=range(6))
    corner = rows[:, 2:6] - [1.0, 1.0, 0.0, 0.0]
    return {int(n) - 1: centre_from_corner(corner[rows[:, 0] == n]) for n in np.unique(rows[:, 0])}


def real(folder: Path, skip: int) -> None:
    """Recall and precision on a sequence, from frame `skip` on."""
    truth = read_mot(folder / "gt" / "gt.txt")
    with open_source(str(folder / "img1")) as source:
        frames = [item for item in source if isinstance(item, Frame)]
    print(
        f"\n{folder.name}, frames {skip} to {len(frames) - 1}:  settings, IoU, recall, precision, ms a frame"
    )
    for name, parameters in PEOPLE.items():
        for chosen in ({}, parameters):
            found, taken = run(made(name, **chosen), frames)
            for iou in (0.5, 0.3):
                score: DetectionScore = total(
                    score_detections(found[k].boxes, truth.get(k, np.empty((0, 4))), iou)
                    for k in range(skip, len(frames))
                )
                settings, ms = "stated " if chosen else "default", np.median(taken)
                print(f"{name:11} {settings} {iou}  {score.recall:.2f}  {score.precision:.2f}  {ms:.0f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mot", type=Path, help="a sequence in MOT layout")
    parser.add_argument("--skip", type=int, default=26, help="frames that are left to the warm-up")
    options = parser.parse_args()
    import cv2

    cv2.setNumThreads(1)
    costs()
    if options.mot is not None:
        real(options.mot, options.skip)
