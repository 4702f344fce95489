"""How much memory and how many open files a long run takes.

    python benchmarks/soak.py --frames 1000000
    python benchmarks/soak.py --targets 500 --frames 5000 [--record]

Without `--targets`: tiny frames, a small net that reconfigures itself and learns, everything recorded. With
it: a crowd by detections only, no pixels are read. People wander as in `crowd_speed.py`, for a while forward
and then back, so that detections take no more room in a long run; one detection in ten is missed, and every
so often the right half of them is not detected for a while, so that targets end and others start throughout.
`--record` writes every frame down.

Prints resident memory of the process' own (RssAnon, Linux; compiled kernels included), open files and the
time of a frame as it goes, and the growth since the first line.
"""

from __future__ import annotations

import argparse
import gc
import os
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from crowd_speed import crowd, frames_of, graph_of
from measuring import on_one_thread

from bayesnet_track.engine.starts import start_targets
from bayesnet_track.engine.step import State, make_engine, step
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.observation.detector import Detections
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.recording.record import Recorder
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.runtime.results import Result
from bayesnet_track.runtime.session import track
from bayesnet_track.sources.detection_files import FileDetector

WIDTH, HEIGHT, SIDE = 64, 48, 10
GRAPH = {
    "name": "soak",
    "targets": {
        "square": {
            "nodes": {
                "square": {
                    "belief": {"particles": {"size": 20}},
                    "fuse": "product",
                    "motion": {"random_walk": {"sd_px": {"x": 2.0, "y": 2.0}}},
                    "adapt": {
                        "activate": {"above": {"ud_px2": 4.0}, "frames": 2},
                        "deactivate": {"below": {"ud_px2": 3.0}, "frames": 3, "drop": "largest_kl"},
                    },
                    "learn": {"below": {"ud_px2": 50.0}, "rate_max": 0.05},
                },
                "gray": {"parent": "square", "agent": "intensity"},
                "moves": {"parent": "square", "agent": "motion", "active": False},
            }
        }
    },
}
"""A net that reconfigures itself again and again, learns, and costs little."""


@dataclass
class Square:
    """A source: a bright square that goes round in a noisy picture, for so many frames."""

    count: int
    description: str = "soak"
    frame_interval_s: float = 0.04
    width: int = WIDTH
    height: int = HEIGHT
    end_reason: str = "end_of_source"

    @property
    def expected_frames(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[Frame]:
        rng = np.random.default_rng(7)
        noise = rng.integers(0, 40, (16, HEIGHT, WIDTH, 3), dtype=np.uint8)
        for index in range(self.count):
            image = noise[index % 16].copy()
            x, y = place(index)
            image[y : y + SIDE, x : x + SIDE] = 200
            yield Frame(index, float(index), image, True, index * 0.04)


def place(index: int) -> tuple[int, int]:
    """Top-left corner of the square in a frame."""
    turn = 2 * np.pi * index / 200
    return round(27 + 15 * np.cos(turn)), round(19 + 10 * np.sin(turn))


@dataclass(frozen=True)
class Measured:
    """Memory and files at one frame."""

    frame: int
    resident_kb: int
    files: int
    seconds: float
    live: int = 0
    started: int = 0


def resident_kb() -> int:
    """Resident memory of this process, of its own (not of mapped files)."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("RssAnon:"):
            return int(line.split()[1])
    raise OSError("no RssAnon in /proc/self/status: Linux is needed")


def soak(frames: int, every: int, out: Path) -> Iterator[Measured]:
    """Track through `frames` frames, all recorded in `out`; measures every so many of them."""
    cv2.setNumThreads(1)  # a picture this small is done before a second thread wakes
    began = time.perf_counter()
    x, y = place(0)
    results = track(check_graph(GRAPH), Square(frames), (x, y, SIDE, SIDE), out=out, seed=1)
    for result in results:
        done = result.frame.index + 1
        if done % every == 0:
            gc.collect()
            files = len(os.listdir("/proc/self/fd"))  # noqa: PTH208
            yield Measured(done, resident_kb(), files, time.perf_counter() - began)


TURN = 120
"""Frames after which everybody turns round."""

AWAY = 45
"""Frames for which half of the crowd is not detected; `death.unseen_frames` is less."""


@dataclass(frozen=True)
class ToAndFro(Mapping[int, Detections]):
    """Detections played forward and backward for as many frames as are asked for, with half of them away.

    Before each turn the right half of them is not detected, for longer than a target waits.
    """

    found: dict[int, Detections]

    def __getitem__(self, index: int) -> Detections:
        place = index % (2 * (TURN - 1))
        detections = self.found[min(place, 2 * (TURN - 1) - place)]
        if index % (TURN - 1) < TURN - 1 - AWAY:
            return detections
        across = detections.boxes[:, 0]
        left = np.flatnonzero(across < np.median(across))
        labels = tuple(detections.labels[row] for row in left.tolist())
        return Detections(detections.boxes[left], detections.scores[left], labels)

    def __iter__(self) -> Iterator[int]:
        return iter(self.found)

    def __len__(self) -> int:
        return len(self.found)


def soak_crowd(graph: str, targets: int, frames: int, every: int, out: Path | None) -> Iterator[Measured]:
    """Track a crowd; measures every so many frames."""
    size, found = crowd(targets, TURN)
    checked = graph_of(graph)
    engine = make_engine(checked, 0, detectors={"detections": FileDetector(ToAndFro(found))})
    state: State | None = None
    started: set[str] = set()
    began = time.process_time()
    with ExitStack() as stack:
        recorder = None
        if out is not None:
            directory = RunDirectory(out)
            directory.path.mkdir()
            recorder = stack.enter_context(Recorder(directory, checked, 0.04))
        for frame in frames_of(size, frames):
            outcome = (
                start_targets(checked, engine, frame, ()) if state is None else step(engine, state, frame)
            )
            state = outcome.state
            if recorder is not None:
                for event in outcome.events:
                    recorder.event(event)
                recorder.frame(Result(frame, tuple(outcome.metrics), {}, (), {}, 0.0))
            started.update(state.net.targets)
            if (frame.index + 1) % every == 0:
                gc.collect()
                files = len(os.listdir("/proc/self/fd"))  # noqa: PTH208
                spent = time.process_time() - began
                live = len(state.targets)
                yield Measured(frame.index + 1, resident_kb(), files, spent, live, len(started))


def main() -> None:
    """Print as it goes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--every", type=int, default=0, help="frames between measurements (default: a tenth)")
    parser.add_argument("--targets", type=int, default=0, help="a crowd of so many, by detections")
    parser.add_argument("--graph", default="kalman_detections", help="of the crowd")
    parser.add_argument("--record", action="store_true", help="write the crowd's frames down, too")
    options = parser.parse_args()
    every = options.every or max(options.frames // 10, 1)
    first = None
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        if options.targets:
            on_one_thread()
            lines = soak_crowd(
                options.graph, options.targets, options.frames, every, out if options.record else None
            )
        else:
            lines = soak(options.frames, every, out)
        for now in lines:
            first = first or now
            growth = 100 * (now.resident_kb / first.resident_kb - 1)
            of_crowd = f", {now.live} live of {now.started} started" if options.targets else ""
            print(
                f"frame {now.frame:>8}: {now.resident_kb / 1024:.1f} MB ({growth:+.2f} %), "
                f"{now.files} files{of_crowd}, {1e3 * now.seconds / now.frame:.2f} ms a frame",
                flush=True,
            )


if __name__ == "__main__":
    main()
