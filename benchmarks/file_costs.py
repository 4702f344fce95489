"""What a run's files cost: milliseconds and bytes a frame by file, of two versions in turns.

    python benchmarks/file_costs.py
    python benchmarks/file_costs.py --before OLD/.venv/bin/python --after .venv/bin/python --turns 3

People wander as in `crowd_speed.py`; each frame is tracked with `kalman_detections` and written down as a
run does it. Times are CPU time on one thread, medians over the frames after the thirtieth, and of several
turns the smallest: with `--before`, the two interpreters take turns, so that both have the same machine.
Bytes are means over all frames.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from crowd_speed import WARM_UP, advanced, crowd, graph_of
from measuring import environment, on_one_thread, table

from bayesnet_track.engine.step import make_engine
from bayesnet_track.runtime.recording.record import Recorder
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.runtime.results import Result
from bayesnet_track.sources.detection_files import FileDetector

FILES = ("journal.jsonl", "frames", "tracks.txt", "tracks.csv", "timings.jsonl")


def cost(targets: int, frames: int) -> dict[str, Any]:
    """Median milliseconds of the step and of writing, and bytes a frame of each file."""
    size, found = crowd(targets, frames)
    graph = graph_of("kalman_detections")
    engine = make_engine(graph, 0, detectors={"detections": FileDetector(found)})
    steps, files = [], []
    with tempfile.TemporaryDirectory() as folder:
        directory = RunDirectory(Path(folder) / "run")
        directory.path.mkdir()
        with Recorder(directory, graph, 0.04) as recorder:
            for frame, outcome, spent in advanced(engine, graph, size, frames):
                started = time.process_time()
                for event in outcome.events:
                    recorder.event(event)
                recorder.frame(Result(frame, outcome.metrics, {}, (), {}, spent))
                files.append(time.process_time() - started)
                steps.append(spent)
        written = {path.name: path.stat().st_size / frames for path in directory.path.iterdir()}
    step_ms, files_ms = (1e3 * float(np.median(seconds[WARM_UP:])) for seconds in (steps, files))
    sizes = {name: sum(size for key, size in written.items() if key.startswith(name)) for name in FILES}
    return {"step": step_ms, "files": files_ms, "bytes": sizes}


def measured(python: str, targets: int, frames: int) -> dict[str, Any]:
    """The cost with the package of an interpreter."""
    command = [python, str(Path(__file__).resolve()), "--alone", str(targets), "--frames", str(frames)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tempfile.gettempdir())
    if done.returncode:
        raise SystemExit(f"{python}: {done.stderr[-2000:]}")
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def row(name: str, targets: int, turns: list[Mapping[str, Any]]) -> list[str]:
    """A line of the table."""
    sizes = turns[0]["bytes"]
    times = [f"{min(turn[key] for turn in turns):.2f}" for key in ("step", "files")]
    return [
        name,
        str(targets),
        *times,
        *(f"{sizes[file]:.0f}" for file in FILES),
        f"{sum(sizes.values()):.0f}",
    ]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--before", help="interpreter of an environment with an earlier version")
    parser.add_argument("--after", default=sys.executable, help="interpreter of this one")
    parser.add_argument("--counts", default="1,50,200", help="numbers of people")
    parser.add_argument("--frames", type=int, default=150, help="frames of each setting")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--alone", type=int, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    on_one_thread()
    if chosen.alone is not None:
        print(json.dumps(cost(chosen.alone, chosen.frames)))
        return
    print(f"{environment()}; load {os.getloadavg()[0]:.1f}")
    pythons = {"before": chosen.before, "after": chosen.after} if chosen.before else {"": chosen.after}
    rows = []
    for count in (int(word) for word in chosen.counts.split(",")):
        turns: dict[str, list[Mapping[str, Any]]] = {name: [] for name in pythons}
        for _ in range(chosen.turns):
            for name, python in pythons.items():
                turns[name].append(measured(python, count, chosen.frames))
        rows += [row(name, count, found) for name, found in turns.items()]
    files = [f"{name} [B]" for name in FILES]
    print(table(["", "people", "step [ms]", "files [ms]", *files, "all [B]"], rows))


if __name__ == "__main__":
    main()
