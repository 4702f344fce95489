"""What a frame of many targets costs `kalman_detections`, SORT, ByteTrack, OC-SORT and norfair.

    python benchmarks/crowd_speed.py [--peers-python PEERS/bin/python] [--counts 10,50,200,1000] [--false 0]
    python benchmarks/crowd_speed.py --peers-python PEERS/bin/python --counts 5000 --peers SORT --frames 40

Detections only, no pixels are read: people wander over 1920x1080 px, 10 % of detections are missed, sizes are
off by 5 %, positions by 3 px; beyond 200 people the image grows, so that the crowd is as dense as with 200.
With `--false 1` there is a false detection for each person in every frame. With `--beside GRAPH` another
graph is timed on the same detections, each frame once by either, turn by turn.
Everything runs on one thread, the peers first, then ours, in one run: ratios say more than times. Times are
CPU time, medians over the frames after the thirtieth. Ours is the step, with association, UD, KL, metrics as
columns and decisions: alone, and in a run that is written down ("recorded"). "Update" is the `update` of a
`DetectionsTracker`, the call that the peers have, too. "Files" is what writing the frame takes, in which the
lines of metrics and their clouds are made.
"""

from __future__ import annotations

import argparse
import cProfile
import os
import pstats
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from crowd_peers import ask, rows_of
from measuring import environment, on_one_thread, table

from bayesnet_track import DetectionsTracker
from bayesnet_track.engine.starts import start_targets
from bayesnet_track.engine.step import Engine, Outcome, State, make_engine, step
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.observation.detector import Detections
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.recording.record import Recorder
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.runtime.results import Result
from bayesnet_track.sources.detection_files import FileDetector
from simulated.crowd_detector import DetectorSettings, detect_crowd
from simulated.walkers import CrowdSettings, make_crowd

WARM_UP = 30
PEERS = ("SORT", "ByteTrack", "OC-SORT", "norfair")


@dataclass(frozen=True)
class Cost:
    """What so many targets cost.

    Attributes:
        step_ms: median time of the step, as a tracker's loop without files has it.
        recorded_ms: the same in a run that is written down.
        files_ms: median time of writing the frame down.
        targets: live targets after the last frame.
        bytes_a_target: journal, metrics and tracks per target and frame.
    """

    step_ms: float
    update_ms: float
    recorded_ms: float
    files_ms: float
    targets: int
    bytes_a_target: float


def crowd(count: int, frames: int, false: float = 0.0) -> tuple[tuple[int, int], dict[int, Detections]]:
    """Width and height of the image, and the detections of each frame."""
    side = max(1.0, (count / 200) ** 0.5)
    size = round(1920 * side), round(1080 * side)
    people = CrowdSettings(*size, frames, count, births=0.0, life=1e9, crossings=0, beside=0)
    reported = detect_crowd(make_crowd(people), DetectorSettings(missed=0.1, clutter=false * count))
    return size, {index: one.detections for index, one in enumerate(reported)}


def graph_of(name: str) -> CheckedGraph:
    """A graph with room for all targets, its detections taken as they are."""
    written = load_graph(name).spec.model_dump(exclude_unset=True)
    (plate,) = written["targets"].values()
    plate["birth"]["max_targets"] = 10_000
    plate["birth"]["detector"] = {"detections": {"max_count": 10_000, "max_overlap": 1.0}}
    return load_graph(written)


def frames_of(size: tuple[int, int], count: int) -> Iterator[Frame]:
    """Frames of black pixels, which nobody reads."""
    image = np.zeros((size[1], size[0], 3), np.uint8)
    for index in range(count):
        yield Frame(index=index, time=float(index), time_s=index / 25, image=image)


def advanced(
    engine: Engine, graph: CheckedGraph, size: tuple[int, int], frames: int
) -> Iterator[tuple[Frame, Outcome, float]]:
    """Each frame, its outcome and the seconds of the step."""
    state: State | None = None
    for frame in frames_of(size, frames):
        started = time.process_time()
        outcome = start_targets(graph, engine, frame, ()) if state is None else step(engine, state, frame)
        spent = time.process_time() - started
        state = outcome.state
        yield frame, outcome, spent


def beside(first: str, second: str, found: dict[int, Detections], size: tuple[int, int]) -> list[str]:
    """Median milliseconds of the steps of two graphs that take turns, and their ratio."""
    runs = []
    for graph in (graph_of(first), graph_of(second)):
        engine = make_engine(graph, 0, detectors={"detections": FileDetector(found)})
        runs.append(advanced(engine, graph, size, len(found)))
    seconds = [[spent for _, _, spent in both] for both in zip(*runs, strict=True)]
    medians = 1e3 * np.median(np.array(seconds)[WARM_UP:], axis=0)
    return [*(f"{value:.2f}" for value in medians), f"{medians[1] / medians[0]:.2f}"]


def updates(graph: CheckedGraph, found: dict[int, Detections], size: tuple[int, int]) -> Iterator[float]:
    """The seconds of each update of a `DetectionsTracker`."""
    tracker = DetectionsTracker(graph, size)
    for index in sorted(found):
        left = corner_from_centre(found[index].boxes)
        corners = np.column_stack([left[:, :2], left[:, :2] + left[:, 2:]])
        given = SimpleNamespace(xyxy=corners, confidence=found[index].scores)
        started = time.process_time()
        tracker.update(given)
        yield time.process_time() - started


def measured(graph: CheckedGraph, found: dict[int, Detections], size: tuple[int, int]) -> Cost:
    """The cost of the frames after the warm-up: of steps alone, then of a run that is written down."""
    engine, frames = make_engine(graph, 0, detectors={"detections": FileDetector(found)}), len(found)
    alone = [spent for _, _, spent in advanced(engine, graph, size, frames)]
    whole = list(updates(graph, found, size))
    steps, files, live = [], [], 0
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
                live = len(outcome.state.targets)
        written = sum(one.stat().st_size for one in directory.path.iterdir())
    median = [1e3 * float(np.median(seconds[WARM_UP:])) for seconds in (alone, whole, steps, files)]
    return Cost(*median, live, written / max(frames * live, 1))


def row(count: int, cost: Cost, others: dict[str, Any]) -> list[str]:
    """A line of the table."""
    cells = [str(count), str(cost.targets), f"{cost.step_ms:.2f}", f"{1e3 * cost.step_ms / count:.0f}"]
    cells += [
        f"{cost.update_ms:.2f}",
        f"{cost.recorded_ms:.2f}",
        f"{cost.files_ms:.2f}",
        f"{cost.bytes_a_target:.0f}",
    ]
    for one in others.values():
        cells.append(f"{1e3 * float(np.median(one['seconds'][WARM_UP:])):.2f}")
    if "SORT" in others:
        sort = 1e3 * float(np.median(others["SORT"]["seconds"][WARM_UP:]))
        cells += [f"{cost.step_ms / sort:.2f}", f"{cost.update_ms / sort:.2f}"]
    return cells


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--peers-python", help="interpreter of an environment with trackers and norfair")
    parser.add_argument("--peers", nargs="+", default=PEERS, choices=PEERS)
    parser.add_argument("--graph", default="kalman_detections")
    parser.add_argument("--beside", help="another graph, timed on the same detections, instead")
    parser.add_argument("--counts", default="10,50,200,1000", help="numbers of people")
    parser.add_argument("--false", type=float, default=0.0, help="false detections for each person")
    parser.add_argument("--frames", type=int, default=120, help="frames of each setting")
    parser.add_argument("--profile", action="store_true", help="say where the time goes, instead")
    chosen = parser.parse_args()
    on_one_thread()
    print(f"{environment()}; load {os.getloadavg()[0]:.1f}")
    rows: list[Sequence[str]] = []
    names: list[str] = []
    for count in (int(word) for word in chosen.counts.split(",")):
        size, found = crowd(count, chosen.frames, chosen.false)
        if chosen.beside:
            rows.append([str(count), *beside(chosen.graph, chosen.beside, found, size)])
            continue
        graph = graph_of(chosen.graph)
        if chosen.profile:
            profile = cProfile.Profile()
            profile.runcall(measured, graph, found, size)
            pstats.Stats(profile).sort_stats("tottime").print_stats(45)
            continue
        others: dict[str, Any] = {}
        if chosen.peers_python:
            rows_of_frames = [rows_of(found[index]) for index in sorted(found)]
            answer, names = ask(chosen.peers_python, chosen.peers, [rows_of_frames]), [*chosen.peers]
            others = answer["figures"][0]
            print(f"{count} people: {answer['versions']}")
        rows.append(row(count, measured(graph, found, size), others))
    head = [
        "people",
        "targets",
        "step [ms]",
        "per person [us]",
        "update [ms]",
        "recorded [ms]",
        "files [ms]",
        "bytes per target and frame",
    ]
    head += [f"{name} [ms]" for name in names] + (["step / SORT", "update / SORT"] if names else [])
    if chosen.beside:
        head = ["people", f"{chosen.graph} [ms]", f"{chosen.beside} [ms]", "ratio"]
    if rows:
        print(table(head, rows))


if __name__ == "__main__":
    main()
