"""OpenCV's trackers in an environment of their own: one pass over a sequence for each line asked.

Needs NumPy and OpenCV alone. `benchmarks/real_video.py --peers-python PYTHON` starts it with the interpreter
of an environment that has `opencv-contrib-python-headless` (CSRT and KCF are in that build only). With a
folder as its argument NanoTrack takes part, too, by the two model files there.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import cv2
import numpy as np
from peers import nanotrack, peers


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
