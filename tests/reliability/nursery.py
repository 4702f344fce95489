"""Runs in processes that can be killed: all is loaded once, and every run is a fork of a clean process.

A fork of the process of the tests would inherit what earlier tests left: locks that are held, encoders whose
threads are not there. `Nursery` starts this file as a script, which reads a list of `Job` as JSON a line.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import av  # noqa: F401
import cv2
import numpy as np

from bayesnet_track import Start, track
from bayesnet_track.cli.main import main
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.recording.videowriter import Background, VideoWriter
from bayesnet_track.sources.sources import open_source

FRAMES, SIDE = 36, 10
EVERY_S = 0.01
"""In a second of work, checkpoints are as many as otherwise in a minute or two."""

GRAPH = """\
bayesnet: 1
name: killed
targets:
  square:
    nodes:
      square:
        belief: {particles: {size: 60}}
        motion: {random_walk: {sd_px: {x: 3, y: 3}}}
        fuse: product
        adapt:
          activate: {above: {ud_px2: 8}, frames: 1}
          deactivate: {below: {ud_px2: 6}, frames: 2, drop: largest_kl}
        learn: {below: {ud_px2: 50}, rate_max: 0.05}
      gray: {parent: square, agent: intensity}
      moves: {parent: square, agent: motion, active: false}
"""
"""A net that reconfigures itself and learns: all of its state has to come back."""


def place(index: int) -> tuple[int, int]:
    """Top-left corner of the square in a picture."""
    turn = 2 * np.pi * index / 40
    return round(27 + 15 * np.cos(turn)), round(19 + 10 * np.sin(turn))


def prepare(folder: Path, frames: int = FRAMES) -> None:
    """The graph and the pictures that every run reads."""
    (folder / "pictures").mkdir()
    (folder / "graph.yaml").write_text(GRAPH)
    rng = np.random.default_rng(7)
    for index in range(frames):
        image = rng.integers(0, 40, (48, 64, 3), dtype=np.uint8)
        x, y = place(index)
        image[y : y + SIDE, x : x + SIDE] = 200
        cv2.imwrite(str(folder / "pictures" / f"{index:04}.png"), image)


def begin(
    given: Path, folder: Path, every_s: float = EVERY_S, video: Any = False, executor: str = "serial"
) -> None:
    graph = given / "graph.yaml"
    with open_source(str(given / "pictures")) as source:
        starts = [Start((*map(float, place(0)), float(SIDE), float(SIDE)))]
        for _ in track(
            graph,
            source,
            starts,
            out=folder,
            checkpoint_every=every_s,
            overwrite=True,
            video=video,
            executor=executor,
            workers=None if executor == "serial" else 2,
        ):
            pass


def go_on(folder: Path, every_s: float = EVERY_S, executor: str = "serial") -> None:
    workers = None if executor == "serial" else 2
    for _ in resume(folder, checkpoint_every=every_s, executor=executor, workers=workers):
        pass


@dataclass(frozen=True)
class Job:
    """A run in a process of its own; with `kill_after_s` it is killed, with `crash_at` it ends itself.

    Attributes:
        work: "begin", "resume", or "command" with `arguments` of the command line.
        folder: the run directory.
        kill_after_s: seconds until kill -9; 0 lets it end.
        crash_at: number of the change of the disk at which the process ends, as `steps.Counted` counts them;
            0 for none, "close" for the end of the video.
        start_at_s: time of the clock at which the work begins.
    """

    work: str
    folder: str
    given: str = ""
    arguments: tuple[str, ...] = ()
    kill_after_s: float = 0.0
    crash_at: int | str = 0
    start_at_s: float = 0.0
    every_s: float = EVERY_S
    video: bool | str = True
    executor: str = "serial"

    @property
    def text_file(self) -> Path:
        """Where a command prints, and the error of other work stands."""
        return Path(f"{self.folder}.text")


def crash() -> None:
    os._exit(137)


def do(job: Job) -> int:
    """The exit code of the work."""
    # A child that waits for what never comes ends with -14 in place of the patience of whoever reads this.
    signal.alarm(300)
    import steps

    if job.crash_at:
        Background._is_at_work = lambda _: False  # type: ignore[method-assign]
    if job.crash_at == "close":
        VideoWriter.close = VideoWriter.finish = lambda _: crash()  # type: ignore[method-assign,assignment,misc]
    elif job.crash_at:
        steps.Counted(int(job.crash_at), crash).install()
    folder = Path(job.folder)
    time.sleep(max(0.0, job.start_at_s - time.time()))
    if job.work == "command":
        with job.text_file.open("w", buffering=1) as text, redirect_stdout(text), redirect_stderr(text):
            return main(list(job.arguments))
    if job.work == "begin":
        begin(Path(job.given), folder, job.every_s, job.video, job.executor)
    else:
        go_on(folder, job.every_s, job.executor)
    return 0


def forked(job: Job) -> int:
    child = os.fork()
    if child == 0:
        code = 1
        try:
            code = do(job)
        except BaseException as error:
            job.text_file.write_text(f"{type(error).__name__}: {error}")
        finally:
            os._exit(code)
    return child


def serve(given: Path) -> None:
    """Load all that a run needs, then fork the jobs of each line and answer with how they ended."""
    # A child inherits locks and objects of threads, but no thread: here are none. An encoder is one of those.
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as loads:
        begin(given, Path(loads) / "run")
    print("ready", flush=True)
    for line in sys.stdin:
        jobs = [Job(**job) for job in json.loads(line)]
        began = time.perf_counter()
        children = [forked(job) for job in jobs]
        if delay := jobs[0].kill_after_s:
            time.sleep(delay)
            os.kill(children[0], signal.SIGKILL)
        codes = [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]
        print(json.dumps([codes, time.perf_counter() - began]), flush=True)


class Nursery:
    """A process without threads that forks runs; to be closed."""

    def __init__(self, given: Path) -> None:
        pipe = subprocess.PIPE
        command = [sys.executable, __file__, str(given)]
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
        assert self._read() == "ready\n"

    def ask(self, *jobs: Job) -> tuple[list[int], float]:
        """Exit codes of jobs that are started together, -9 when killed, and the seconds that they took."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps([asdict(job) for job in jobs]) + "\n")
        self._process.stdin.flush()
        codes, seconds = json.loads(self._read())
        return codes, seconds

    def _read(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline()

    def close(self) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(10)
        self._process.stdout.close()


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
