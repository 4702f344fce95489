"""Checks that take the program's own ways: its opener of videos, its kernels, its cues, its worker processes.

That a library can be imported and has the right parts does not show that the program can use it.
"""

from __future__ import annotations

from collections.abc import Iterator

from bayesnet_track.cli.doctor.finding import Finding, judge, try_code

_VIDEO = """
import tempfile
from pathlib import Path
import numpy as np
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.sources import open_source
from bayesnet_track.runtime.recording.videowriter import VideoWriter
shown = [np.full((48, 64, 3), 40 * n, np.uint8) for n in range(6)]
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "short.mp4"
    with VideoWriter(path, 64, 48, 1 / 25) as video:
        for image in shown:
            video.write(image)
    with open_source(str(path)) as source:
        frames = [item for item in source if isinstance(item, Frame)]
assert len(frames) == len(shown), f"of {len(shown)} frames {len(frames)} came back"
away = max(abs(float(frame.image.mean()) - float(image.mean())) for frame, image in zip(frames, shown))
assert away < 8, f"gray levels came back {away:.0f} away"
print(len(frames))
"""
_KERNEL = """
import os, sys
os.environ["NUMBA_CACHE_DIR"] = sys.argv[1]
import time
import numpy as np
from bayesnet_track.numerics.resampling import _total_and_last as kernel
weights = np.array([1.0, 2.0, 0.0])
started = time.perf_counter()
found = kernel(weights)
print(f"{time.perf_counter() - started:.1f}")
assert tuple(found) == tuple(kernel.py_func(weights)), f"it gives {found}"
"""
_CUE = """
import numpy as np
from bayesnet_track.observation.cue import Hypotheses, installed_cues
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region
from bayesnet_track.sources.scenes import make_scene
scene = make_scene("two_squares", 0)
declared = installed_cues()["color_histogram"]
cue = declared.make(declared.parameters())
frames = FramePair(Frame(0, 0.0, scene.frames[0]), None)
planes = PlaneCache(frames).planes(cue.needs, Region(0, 0, 320, 240))
box = centre_from_corner(scene.start_box)
reference = cue.learn(planes, box)
beside = box + [0.0, -100.0, 0.0, 0.0]
on, off = cue.log_likelihood(planes, Hypotheses(np.array([box, beside])), reference)
assert on > off, f"the target scores {on:.2f} and what is beside it {off:.2f}"
print(f"{on - off:.1f}")
"""
_WORKER = """
import itertools
from bayesnet_track import Start, track
from bayesnet_track.sources.scene_source import SceneSource
from bayesnet_track.sources.scenes import make_scene
def play(executor, workers):
    scene = make_scene("two_squares", 0)
    source = SceneSource(scene, "scene:two_squares")
    run = track("two_squares", source, [Start(scene.start_box)], executor=executor, workers=workers)
    told = [(r.targets[0].centre_box, r.decisions) for r in itertools.islice(run, 4)]
    run.close()
    return told
if __name__ == "__main__":
    there, here = play("processes", 1), play("serial", None)
    assert there == here, f"boxes and decisions differ from those without: {there[-1]}, {here[-1]}"
    print(len(there))
"""


def check_video() -> Iterator[Finding]:
    """A short MP4 is written by the program's writer and read by its opener."""
    trial = try_code(_VIDEO)
    cure = "install the versions that are allowed: python -m pip install --upgrade --force-reinstall av"
    cure += "   (`versions` above says which)"
    broken = "a short MP4 cannot be written and read: "
    yield judge("mp4", trial, f"{trial.out} frames written and read", cure, broken)


def check_kernel() -> Iterator[Finding]:
    """One of the program's kernels is compiled anew, and computes what its Python code does."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        trial = try_code(_KERNEL, folder)
    cure = "python -m pip install --upgrade --force-reinstall numba numpy"
    yield judge("kernel", trial, f"one compiled in {trial.out} s", cure, "cannot be compiled: ")


def check_cue() -> Iterator[Finding]:
    """A cue learns a target in a frame and scores it above what is beside it."""
    trial = try_code(_CUE, timeout_s=120.0)
    works = f"color_histogram scores a target {trial.out} nats above what is beside it"
    cure = "mend what is above; else please report this"
    yield judge("cue", trial, works, cure, "cannot score a frame: ")


def check_worker() -> Iterator[Finding]:
    """Four frames with the agents in a worker process give what they give without."""
    trial = try_code(_WORKER, timeout_s=300.0)
    works = f"{trial.out} frames, the same with agents in a process of their own"
    cure = "mend what is above; `--executor serial` does without"
    yield judge("worker", trial, works, cure, "agents cannot work in processes: ")
