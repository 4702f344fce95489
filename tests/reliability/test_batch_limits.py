"""Row 21: a batch of real processes with few files, little time and an early Ctrl-C."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest

from bayesnet_track.sources.scenes import make_scene

pytestmark = pytest.mark.reliability


@pytest.fixture
def videos(tmp_path):
    scene = make_scene("two_squares", 0)
    for name in ("one", "two"):
        (tmp_path / name / "img").mkdir(parents=True)
        for number in range(60):
            cv2.imwrite(str(tmp_path / name / "img" / f"{number}.png"), scene.frames[number])
        np.savetxt(tmp_path / name / "gt.txt", scene.truth[:60], delimiter=",")
    return tmp_path


def batch(videos, *options, files=None):
    """A batch that is begun; at most so many files may be open in each of its processes."""
    limit = (
        f"import resource; resource.setrlimit(resource.RLIMIT_NOFILE, ({files}, {files}))\n" if files else ""
    )
    code = f"{limit}import sys; from bayesnet_track.cli.main import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "batch", "two_squares", "--source", f"{videos}/*/img"]
    command += ["--init-from", "{folder}/gt.txt", "--out", str(videos / "out"), *options]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=environment)


def told(process, code):
    _, error = process.communicate(timeout=120)
    assert process.returncode == code, error
    return error


def table(videos):
    with (videos / "out" / "results.csv").open() as file:
        return {row["video"]: (row["status"], row["frames"]) for row in csv.DictReader(file)}


def test_few_files_little_time_and_ctrl_c(videos):
    assert "raise the limit on open files" in told(batch(videos, files=24), 2)
    error = told(batch(videos, "--timeout", "0.3", "--end", "5"), 5)
    assert "one seed 0: timed out: stopped after 0.3 s" in error
    assert table(videos) == {"one": ("timed out", ""), "two": ("timed out", "")}
    error = told(batch(videos, "--jobs", "2", "--end", "5", files=38), 0)
    assert "no more than 1 runs at a time, not 2" in error
    assert table(videos) == {"one": ("finished", "5"), "two": ("finished", "5")}
    before = (videos / "out" / "results.csv").read_bytes()
    process = batch(videos, "--seeds", "2", "--jobs", "1")
    while not (videos / "out" / "one-seed0").exists():
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    told(process, 130)
    assert (videos / "out" / "results.csv").read_bytes() == before
