"""SORT, ByteTrack, OC-SORT and norfair on files of detections: the peer of `field_crosscheck.py`.

    python benchmarks/field_peers.py < frames.json

Runs in an environment with `trackers` and `norfair` and needs nothing else of the project. Reads a list of
frames, each a list of left, top, right, bottom, score. Prints a JSON object: the versions, and of each
tracker the seconds of every `update` and its tracks, a list of id, left, top, right, bottom for every frame.
"""

from __future__ import annotations

import json
import sys
import time
import warnings
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import numpy as np

warnings.filterwarnings("ignore")

import norfair  # noqa: E402
import supervision  # noqa: E402
from trackers import ByteTrackTracker, OCSORTTracker, SORTTracker  # noqa: E402
from trackers.utils.state_representations import XYXYStateEstimator  # noqa: E402


def detections(lines: Any) -> supervision.Detections:
    """The frame as `trackers` wants it; scores in double precision, so that 0.7 is not below 0.7."""
    rows = np.array(lines, dtype=np.float64).reshape(-1, 5)
    return supervision.Detections(xyxy=rows[:, :4], confidence=rows[:, 4])


def run(update: Callable[[Any], Any], frames: list[Any]) -> dict[str, Any]:
    """Seconds of each frame, and the tracks."""
    seconds, tracks = [], []
    for frame in frames:
        started = time.process_time()
        found = update(frame)
        seconds.append(time.process_time() - started)
        ids = getattr(found, "tracker_id", None)
        named = [] if ids is None else zip(ids.tolist(), found.xyxy.tolist(), strict=True)
        tracks.append([[one, *box] for one, box in named if one >= 0])
    return {"seconds": seconds, "tracks": tracks}


def main() -> None:
    """Print the figures of the frames on the standard input."""
    lines = json.load(sys.stdin)
    frames = [detections(one) for one in lines]
    kinds = {
        "SORT": SORTTracker(),
        "ByteTrack": ByteTrackTracker(),
        "OC-SORT": OCSORTTracker(),
        "OC-SORT, corners": OCSORTTracker(state_estimator_class=XYXYStateEstimator),
    }
    found = {name: run(kind.update, frames) for name, kind in kinds.items()}
    theirs = norfair.Tracker(distance_function="iou", distance_threshold=0.7)
    found["norfair"] = run(
        theirs.update, [[norfair.Detection(np.array(box[:4]).reshape(2, 2)) for box in one] for one in lines]
    )
    versions = {name: version(name) for name in ("trackers", "norfair")}
    print(json.dumps({"versions": versions, "figures": found}))


if __name__ == "__main__":
    main()
