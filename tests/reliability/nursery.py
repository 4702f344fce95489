"""Runs in processes of their own that can be killed: all is loaded once, and every run is a fork.

Its arguments are the folder of `prepare` and an executor; every run draws its video. It reads lines
``begin FOLDER DELAY`` and ``resume FOLDER DELAY``. After DELAY seconds the fork is killed (kill -9); 0 lets
it end. It writes a line for each: how it ended, and for how many seconds it ran.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from bayesnet_track import Start, track
from bayesnet_track.runtime.checkpoints.resume import resume
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


def forked(work: str, given: Path, folder: Path, delay: float, executor: str) -> str:
    child = os.fork()
    if child == 0:
        code = 1
        try:
            if work == "begin":
                begin(given, folder, video=True, executor=executor)
            else:
                go_on(folder, executor=executor)
            code = 0
        except Exception as error:
            (folder.parent / f"{folder.name}.error").write_text(f"{type(error).__name__}: {error}")
        os._exit(code)
    began = time.perf_counter()
    if delay:
        time.sleep(delay)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return f"{os.waitstatus_to_exitcode(status)} {time.perf_counter() - began:.4f}"


if __name__ == "__main__":
    # A fork has no threads but its own.
    cv2.setNumThreads(1)
    given, executor = Path(sys.argv[1]), sys.argv[2]
    with tempfile.TemporaryDirectory() as loads:
        begin(given, Path(loads) / "run")
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    for line in sys.stdin:
        word, where, seconds = line.split()
        sys.stdout.write(forked(word, given, Path(where), float(seconds), executor) + "\n")
        sys.stdout.flush()
