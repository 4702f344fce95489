"""Runs in processes of their own that can be killed: all is loaded once, and every run is a fork.

Reads lines ``begin FOLDER DELAY`` and ``resume FOLDER DELAY`` from its input. After DELAY seconds the fork is
killed (kill -9); 0 lets it end. Writes a line for each: how it ended, and for how many seconds it ran.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

import cv2

from bayesnet_track import Start, load_graph, track
from bayesnet_track.runtime.resume import resume
from bayesnet_track.runtime.scene_source import SceneSource

FRAMES = 36
EVERY_S = 0.02
"""In a second of work, checkpoints are as many as otherwise in a minute."""


def begin(folder: Path) -> None:
    source = SceneSource.named("two_squares", 0, FRAMES)
    starts = [Start(source.scene.start_box)]
    for _ in track("two_squares", source, starts, out=folder, checkpoint_every=EVERY_S):
        pass


def go_on(folder: Path) -> None:
    for _ in resume(folder, checkpoint_every=EVERY_S):
        pass


def forked(work: str, folder: Path, delay: float) -> str:
    child = os.fork()
    if child == 0:
        code = 1
        try:
            (begin if work == "begin" else go_on)(folder)
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
    scene = SceneSource.named("two_squares", 0, 6)
    list(track(load_graph("two_squares"), scene, [Start(scene.scene.start_box)]))
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    for line in sys.stdin:
        word, where, seconds = line.split()
        sys.stdout.write(forked(word, Path(where), float(seconds)) + "\n")
        sys.stdout.flush()
