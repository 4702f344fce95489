"""Frames that come late: CPU time of each update after the first one, in a fresh process with warm kernels.

    python benchmarks/late_frames.py
    python benchmarks/late_frames.py --graphs kalman_detections,mine.yaml --people 50,200 --frames 200

A third of the people are there at first, the others enter one by one, and one in ten detections is missed, so
that targets start, end and return in later frames; frames come up to a quarter of an interval early or late.
Graphs whose births take detections are given them by `DetectionsTracker.update`, with frames if they look at
any. Others get a textured square for `Tracker.update`, which is gone for a while.

The median is that of the 21 frames around each one, since a crowd grows; "worst" is the largest time in terms
of it, and "frames" counts those above twice. "Garbage" counts those of them in which Python's collector ran.
What no later frame should do is counted, too: modules imported, kernels compiled or loaded.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from measuring import environment, on_one_thread, table

from bayesnet_track import DetectionsTracker, Start, Tracker
from bayesnet_track.engine.step import make_engine
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.observation.detector import GIVEN
from bayesnet_track.runtime.frame_clock import Fed, image_users
from simulated.crowd_detector import DetectorSettings, detect_crowd
from simulated.walkers import CrowdSettings, make_crowd

GRAPHS = (
    "kalman_detections", "sort", "bytetrack", "oc_sort", "jpda", "people_detections",
    "general", "two_squares", "crowd", "person_parts", "adaptive", "kalman_ball",
)  # fmt: skip
SIZE = 1920, 1080
AROUND = 10
ABOVE = 2.0

Update = Callable[[int], object]


def of_detections(graph: CheckedGraph, people: int, frames: int) -> tuple[Update, float]:
    """Update with the frame of a number, of a crowd that grows, and seconds until it can be called."""
    crowd = make_crowd(CrowdSettings(*SIZE, frames, people, births=0.0, life=1e9, crossings=0, beside=0))
    given = []
    rng = np.random.default_rng(5)
    for index, one in enumerate(detect_crowd(crowd, DetectorSettings(missed=0.1))):
        left = corner_from_centre(one.detections.boxes)
        corners = np.column_stack([left[:, :2], left[:, :2] + left[:, 2:]])
        entered = max(1, round(people * (1 / 3 + index / frames)))
        given.append(SimpleNamespace(xyxy=corners[:entered], confidence=one.detections.scores[:entered]))
    times = np.arange(frames) / 25 + rng.uniform(-0.01, 0.01, frames)
    times -= min(0.0, times[0])
    looked_at = looks_at_images(graph)
    image = rng.integers(0, 256, (*SIZE[::-1], 3), dtype=np.uint8)

    def update(index: int) -> object:
        shown = image if looked_at else None
        return tracker.update(given[index], shown, time_s=float(times[index])), tracker.events

    began = time.process_time()
    tracker = DetectionsTracker(graph, SIZE)
    return update, time.process_time() - began


def looks_at_images(graph: CheckedGraph) -> bool:
    """True if a graph whose births take detections needs the frames, too."""
    return bool(image_users(make_engine(graph, 0, detectors={GIVEN: Fed()})))


def of_images(graph: CheckedGraph, frames: int) -> tuple[Update, float]:
    """The same of a square on a texture."""
    rng = np.random.default_rng(4)
    texture = rng.integers(0, 256, (480, 640, 3), dtype=np.uint8)
    square = rng.integers(0, 256, (60, 60, 3), dtype=np.uint8)

    def image(index: int) -> np.ndarray:
        shown, x = texture.copy(), 60 + 3 * (index % 150)
        if not frames // 3 <= index < frames // 2:
            shown[200:260, x : x + 60] = square
        return shown

    began = time.process_time()
    tracker = Tracker(graph)
    tracker.init(image(0), Start((60, 200, 60, 60), next(iter(graph.targets))))
    made = time.process_time() - began
    return lambda index: (tracker.update(image(index)), tracker.targets) if index else None, made


def kernels() -> set[tuple[str, str]]:
    """Names and types of all kernels that are compiled or loaded."""
    from numba.core.dispatcher import Dispatcher

    found = [one for one in gc.get_objects() if isinstance(one, Dispatcher)]
    return {(one.py_func.__qualname__, str(types)) for one in found for types in one.overloads}


def measured(name: str, people: int, frames: int) -> dict[str, Any]:
    """Milliseconds of each frame, and what came late."""
    graph = load_graph(name)
    births = [plate.spec.birth for plate in graph.targets.values()]
    if any(birth is not None and birth.detector.detector == GIVEN for birth in births):
        update, made = of_detections(graph, people, frames)
    else:
        update, made = of_images(graph, frames)
    before = set(sys.modules), kernels()
    collected: list[int] = []
    spent: list[float] = []
    gc.callbacks.append(lambda phase, told: collected.append(len(spent)) if phase == "stop" else None)
    for index in range(frames):
        began = time.process_time()
        update(index)
        spent.append(1e3 * (time.process_time() - began))
    return {
        "made": 1e3 * made,
        "spent": spent,
        "collected": collected,
        "modules": sorted(set(sys.modules) - before[0]),
        "kernels": sorted(name for name, _ in kernels() - before[1]),
    }


def alone(name: str, people: int, frames: int) -> dict[str, Any]:
    """`measured` in a fresh process; the kernels that it needs are in the cache on disk before."""
    command = [sys.executable, str(Path(__file__).resolve()), "--alone", name]
    command += ["--people", str(people), "--frames", str(frames)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{name}: {done.stderr[-2000:]}")
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return answer


def row(name: str, people: int, found: dict[str, Any]) -> list[str]:
    """Line of the table."""
    spent = np.array(found["spent"][1:])
    usual = np.array([np.median(spent[max(0, k - AROUND) : k + AROUND + 1]) for k in range(len(spent))])
    ratio = spent / usual
    late = np.flatnonzero(ratio > ABOVE) + 1
    garbage = sum(index in set(found["collected"]) for index in late.tolist())
    worst = int(np.argmax(ratio))
    return [
        name,
        str(people or ""),
        f"{found['made']:.0f}",
        f"{found['spent'][0]:.1f}",
        f"{np.median(spent):.2f}",
        f"{spent[worst]:.1f} ({worst + 1})",
        f"{ratio[worst]:.1f}",
        str(len(late)),
        str(garbage),
        str(len(found["modules"])),
        str(len(found["kernels"])),
    ]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--graphs", default=",".join(GRAPHS), help="names or files, separated by commas")
    parser.add_argument("--people", default="50", help="numbers of people, separated by commas")
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--alone", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    on_one_thread()
    warnings.simplefilter("ignore")
    if chosen.alone is not None:
        print(json.dumps(measured(chosen.alone, int(chosen.people), chosen.frames)))
        return
    print(f"{environment()}; load {os.getloadavg()[0]:.1f}")
    rows, late = [], {}
    for name in chosen.graphs.split(","):
        for people in (int(word) for word in chosen.people.split(",")):
            alone(name, people, chosen.frames)
            found = alone(name, people, chosen.frames)
            rows.append(row(name, people, found))
            packages = {".".join(module.split(".")[:2]) for module in found["modules"]}
            late[name] = sorted(packages) + found["kernels"]
    columns = ["people", "made", "first", "median", "worst (frame)", "of median", "above 2", "garbage"]
    print(table(["CPU ms", *columns, "modules", "kernels"], rows))
    for name, came in late.items():
        if came:
            print(f"{name}: {', '.join(came)}")


if __name__ == "__main__":
    main()
