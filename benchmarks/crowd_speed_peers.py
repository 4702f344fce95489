"""What a frame of many targets costs SORT, ByteTrack, OC-SORT and norfair: the peer of `crowd_speed.py`.

    python benchmarks/crowd_speed_peers.py < frames.json

Runs in an environment with `trackers` and `norfair` and needs nothing else of the project. Reads a list of
frames, each a list of corner boxes (left, top, right, bottom). Prints a JSON object: the versions, and of
each tracker the seconds of every `update` and the number of tracks after the last one.
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

Update = Callable[[Any], Any]


def detections(boxes: Any) -> supervision.Detections:
    """The frame as `trackers` wants it, every confidence 1."""
    corners = np.array(boxes, dtype=np.float32).reshape(-1, 4)
    return supervision.Detections(xyxy=corners, confidence=np.ones(len(corners), np.float32))


def norfair_detections(boxes: Any) -> list[norfair.Detection]:
    """The frame as norfair wants it."""
    return [norfair.Detection(np.array(box).reshape(2, 2)) for box in boxes]


def timed(update: Update, frames: list[Any]) -> dict[str, Any]:
    """Seconds of each frame, and tracks reported in the last."""
    seconds, found = [], None
    for frame in frames:
        started = time.process_time()
        found = update(frame)
        seconds.append(time.process_time() - started)
    ids = getattr(found, "tracker_id", None)
    return {"seconds": seconds, "tracks": len(found) if ids is None else int((np.asarray(ids) >= 0).sum())}


def main() -> None:
    """Print the figures of the frames on the standard input."""
    boxes = json.load(sys.stdin)
    frames = [detections(one) for one in boxes]
    kinds = {"SORT": SORTTracker, "ByteTrack": ByteTrackTracker, "OC-SORT": OCSORTTracker}
    found = {name: timed(kind().update, frames) for name, kind in kinds.items()}
    tracker = norfair.Tracker(distance_function="iou", distance_threshold=0.7)
    found["norfair"] = timed(tracker.update, [norfair_detections(one) for one in boxes])
    versions = {name: version(name) for name in ("trackers", "norfair")}
    print(json.dumps({"versions": versions, "figures": found}))


if __name__ == "__main__":
    main()
