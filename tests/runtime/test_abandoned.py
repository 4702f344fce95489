"""A program that ends while a generator of `track` is open: its run is closed in order, and goes on later."""

import subprocess
import sys

import cv2
import pytest

from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.checkpoints.standing import verify
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

PROGRAM = """
from bayesnet_track import track

results = track("two_squares", "frames", (250, 170, 40, 40), out="run")
for result in results:
    if result.frame.index == 3:
        break
raise RuntimeError("of the program itself")
"""

LATE = """
import atexit, sys, threading, time
from bayesnet_track import track

def go_through():
    for result in track("two_squares", "frames", (250, 170, 40, 40), out="run", checkpoint_every=1e-6):
        time.sleep(.02)
    print("last", result.frame.index)

if sys.argv[1] == "thread":
    threading.Thread(target=go_through).start()
else:
    atexit.register(go_through)
"""


@pytest.fixture
def frames(tmp_path):
    (tmp_path / "frames").mkdir()
    for frame in SceneSource(make_scene("two_squares", seed=0), "scene", 6):
        cv2.imwrite(str(tmp_path / f"frames/{frame.index}.png"), frame.image)
    return tmp_path


def run_program(code, *words):
    call = [sys.executable, "-c", code, *words]
    return subprocess.run(call, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.slow
def test_it_goes_on_behind_the_last_frame_that_the_program_saw(frames, monkeypatch):
    monkeypatch.chdir(frames)
    done = run_program(PROGRAM)
    assert done.stderr.strip().splitlines()[-1:] == ["RuntimeError: of the program itself"]
    assert "Exception ignored" not in done.stderr
    # Going on is broken off in the same way, by a program that ends without an error.
    again = "from bayesnet_track.runtime.checkpoints.resume import resume; r = resume('run'); next(r)"
    done = run_program(again)
    assert (done.returncode, done.stderr) == (0, "")
    assert [result.frame.index for result in resume("run")] == [5]


@pytest.mark.parametrize("where", [pytest.param("thread", marks=pytest.mark.slow), "atexit"])
def test_a_run_goes_on_to_its_end_while_the_program_ends(frames, monkeypatch, where):
    monkeypatch.chdir(frames)
    done = run_program(LATE, where)
    assert (done.returncode, done.stdout, done.stderr) == (0, "last 5\n", "")
    assert verify("run").status == "verified"
