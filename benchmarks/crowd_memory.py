"""How much memory a crowd takes, and whether it grows: detections only, no pixels are read.

    python benchmarks/crowd_memory.py --targets 500 --frames 5000
    python benchmarks/crowd_memory.py --targets 1000 --frames 300 --record

People wander as in `crowd_speed.py`, for a while forward and then back, so that detections take no more room
in a long run. One detection in ten is missed, so that targets end and others start throughout. Memory is the
process' own (RssAnon, Linux), compiled kernels included. With `--record` every frame is written down, 1.7 KB
per target and frame, in a folder that is removed afterwards.
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

from crowd_speed import crowd, frames_of, graph_of
from measuring import environment, on_one_thread
from soak import resident_kb

from bayesnet_track.engine.starts import start_targets
from bayesnet_track.engine.step import State, make_engine, step
from bayesnet_track.observation.detector import Detections
from bayesnet_track.runtime.recording.record import Recorder
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.runtime.results import Result
from bayesnet_track.sources.detection_files import FileDetector

TURN = 120
"""Frames after which everybody turns round."""


@dataclass(frozen=True)
class ToAndFro(Mapping[int, Detections]):
    """Detections played forward and backward for as many frames as are asked for."""

    found: dict[int, Detections]

    def __getitem__(self, index: int) -> Detections:
        place = index % (2 * (TURN - 1))
        return self.found[min(place, 2 * (TURN - 1) - place)]

    def __iter__(self) -> Iterator[int]:
        return iter(self.found)

    def __len__(self) -> int:
        return len(self.found)


@dataclass(frozen=True)
class Measured:
    """The process at one frame.

    Attributes:
        frame: frames done.
        resident_kb: memory of its own.
        files: open files.
        live: live targets.
        started: targets that have started so far.
        seconds: CPU time since the first frame.
    """

    frame: int
    resident_kb: int
    files: int
    live: int
    started: int
    seconds: float


def soak_crowd(graph: str, targets: int, frames: int, every: int, out: Path | None) -> Iterator[Measured]:
    """Track a crowd; measures before the first frame, then every so many of them."""
    size, found = crowd(targets, TURN)
    checked = graph_of(graph)
    engine = make_engine(checked, 0, detectors={"detections": FileDetector(ToAndFro(found))})
    state: State | None = None
    started: set[str] = set()
    gc.collect()
    yield Measured(0, resident_kb(), len(os.listdir("/proc/self/fd")), 0, 0, 0.0)  # noqa: PTH208
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
                yield Measured(frame.index + 1, resident_kb(), files, len(state.targets), len(started), spent)


def main() -> None:
    """Print as it goes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--graph", default="kalman_detections")
    parser.add_argument("--targets", type=int, default=500)
    parser.add_argument("--frames", type=int, default=5000)
    parser.add_argument("--every", type=int, default=0, help="frames between measurements (default: a tenth)")
    parser.add_argument("--record", action="store_true", help="write everything down")
    options = parser.parse_args()
    on_one_thread()
    print(environment())
    first: Measured | None = None
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run" if options.record else None
        every = options.every or max(options.frames // 10, 1)
        for now in soak_crowd(options.graph, options.targets, options.frames, every, out):
            if now.frame == 0:
                print(f"before the first frame: {now.resident_kb / 1024:.1f} MB")
                continue
            first = first or now
            growth = 100 * (now.resident_kb / first.resident_kb - 1)
            print(
                f"frame {now.frame:>6}: {now.resident_kb / 1024:.1f} MB ({growth:+.2f} %), "
                f"{now.files} files, {now.live} live of {now.started} started, "
                f"{1e3 * now.seconds / now.frame:.1f} ms of CPU time a frame",
                flush=True,
            )


if __name__ == "__main__":
    main()
