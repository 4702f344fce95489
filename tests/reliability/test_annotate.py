"""Row 27: a session of annotate that is killed, or finds the disk full, at any step keeps every answer."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import warnings

import numpy as np
import pytest

from bayesnet_track.journal.writer import OutputError
from bayesnet_track.runtime.annotation.answers import Header
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.runtime.annotation.session import open_session

pytestmark = pytest.mark.reliability
HEADER = Header(Video("made_up.mp4", 30, 320, 240, 0.04, "abc"), "general", "0" * 64, 0, 0.5, 1, "1.0")
GIVEN = [
    {"kind": "box", "frame": frame, "target": "ball 1", "box": [10 + frame, 10, 20, 20]} for frame in range(4)
]
OLD = [{**GIVEN[0], "target": name} for name in ("ball\N{NO-BREAK SPACE}1", "", "b" * 99)]
SIGNALS = ("SIGKILL", "SIGHUP", "SIGTERM")


def work(folder, kept):
    """Open a session, which mends what an older one kept, and answer; `kept` has what was taken."""
    session, _ = open_session(folder, HEADER)
    for given in GIVEN:
        try:
            session.give(given)
            kept.append(given["frame"])
        except OutputError:
            pass
    session.close()


def old_session(folder):
    folder.mkdir()
    open_session(folder, HEADER)[0].close()
    with (folder / "answers.jsonl").open("a") as file:
        file.writelines(json.dumps(line) + "\n" for line in OLD)


@pytest.mark.parametrize("has_old", [False, True])
@pytest.mark.parametrize("how", ["killed", "full"])
def test_no_answer_is_lost_at_any_step_on_the_disk(tmp_path, steps, how, has_old):
    def fill():
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    at, is_over = 0, False
    while not is_over:
        at += 1
        folder, kept = tmp_path / f"{at}", []
        if has_old:
            old_session(folder)
        counted = steps.Life(at) if how == "killed" else steps.Counted(at, fill)
        with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            steps.restored(patch)
            counted.install()
            try:
                work(folder, kept)
            except (steps.Killed, OutputError):
                assert len(kept) < len(GIVEN)
            is_over = counted.calls < at
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            again, _ = open_session(folder, HEADER)
        old = len(OLD) if has_old else 0
        assert len({one.target for one in again.answers[:old]}) == old
        found = [one.frame for one in again.answers[old:]]
        # What the person was told is kept, in this order; one more may be, whose end was not told.
        assert [frame for frame in found if frame in kept] == kept and len(found) <= len(kept) + 1
        again.close()
        shutil.rmtree(folder)
    assert at > (12 if has_old else 10)


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_a_command_killed_at_random_times_leaves_no_frames_and_goes_on_to_the_same_bytes(
    videos, graph, tmp_path
):
    (tmp_path / "boxes.txt").write_text("1,1,5,18,12,12,1\n20,1,24,18,12,12,1\n1,2,30,20,10,10,1\n")
    (tmp_path / "tmp").mkdir()
    line = [sys.executable, "-m", "bayesnet_track", "annotate", str(videos["h264.mkv"]), "--no-view"]
    line += ["--graph", str(graph), "--import", str(tmp_path / "boxes.txt"), "--threshold", "0.01", "--out"]
    environment = {**os.environ, "TMPDIR": str(tmp_path / "tmp")}

    def run(out, seconds=None, number=0):
        process = subprocess.Popen(
            [*line, str(out)], env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        if seconds is not None:
            time.sleep(seconds)
            process.send_signal(number)
        return process.wait(120)

    began = time.monotonic()
    assert run(tmp_path / "whole") == 0
    took = time.monotonic() - began
    expected = {path.name: path.read_bytes() for path in (tmp_path / "whole").iterdir()}
    assert len(json.loads(expected["coco.json"])["annotations"]) == 2 * 40
    rng, stopped = np.random.default_rng(27), 0
    for name in SIGNALS:
        out = tmp_path / name
        stopped += run(out, float(rng.uniform(0.3, 0.9)) * took, getattr(signal, name)) != 0
        assert [path for path in (tmp_path / "tmp").iterdir() if "frames" in path.name] == []
        assert run(out) == 0
        assert {path.name: path.read_bytes() for path in out.iterdir()} == expected
    assert stopped
