"""Kill -9 at random times, then resume: the run directory is that of an unbroken run, byte for byte."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from bayesnet_track.runtime.checkpoints.recipe import RecipeError
from bayesnet_track.runtime.checkpoints.standing import standing

SIDE_BY_SIDE = 2


@pytest.fixture
def given(tmp_path: Path, nursery: ModuleType) -> Path:
    """A graph and pictures."""
    folder = tmp_path / "given"
    folder.mkdir()
    nursery.prepare(folder)
    return folder


def files(folder: Path) -> dict[str, str]:
    """File -> hash, but for the times, of which only the number of lines is the same."""
    return {
        path.name: str(path.read_bytes().count(b"\n"))
        if path.name in ("timings.jsonl", "manifest.json")
        else hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.iterdir()
    }


def killed(number: int, process: Any, job: Any, took: float, whole: dict[str, str]) -> str:
    """What came of one run that is killed once or more and resumed; "" when all is as it should be."""
    rng = np.random.Generator(np.random.Philox(number))
    work, kills, folder = "begin", 0, Path(job.folder)
    while True:
        # The first kill falls anywhere in a run; every other run is killed again while it is resumed.
        is_killed = kills == 0 or (number % 2 == 0 and kills < 3)
        delay = float(rng.uniform(0.0, 1.1 * took)) if is_killed else 0.0
        (code,), _ = process.ask(replace(job, work=work, kill_after_s=delay))
        kills += code == -9
        if code == 0 and kills == 0:
            # It was done before the kill.
            shutil.rmtree(folder)
            continue
        if code == 0:
            break
        if code != -9:
            return f"{number}: {job.text_file.read_text() if job.text_file.exists() else f'exit code {code}'}"
        try:
            standing(folder)
            work = "resume"
        except RecipeError:
            # Killed before it was written down what to do: there is no run yet.
            shutil.rmtree(folder, ignore_errors=True)
            work = "begin"
    found = files(folder)
    others = sorted(name for name in whole.keys() | found.keys() if whole.get(name) != found.get(name))
    shutil.rmtree(folder)
    return f"{number}: {', '.join(others)}" if others else ""


@pytest.mark.parametrize(
    "kills",
    [pytest.param(12, marks=pytest.mark.reliability), pytest.param(200, marks=pytest.mark.endurance)],
)
@pytest.mark.parametrize("executor", ["serial", "processes"])
@pytest.mark.skipif(sys.platform == "win32", reason="there is no fork and no kill -9")
def test_kills_leave_the_bytes_of_unbroken_runs(
    tmp_path: Path, given: Path, nursery: ModuleType, executor: str, kills: int
) -> None:
    """Half of the runs are killed again while they are resumed; the video is one of the files."""
    processes = [nursery.Nursery(given) for _ in range(SIDE_BY_SIDE)]

    def job(folder: Path) -> Any:
        return nursery.Job("begin", str(folder), given=str(given), executor=executor)

    try:
        processes[0].ask(job(tmp_path / "whole"))
        _, took = processes[1].ask(job(tmp_path / "again"))
        whole = files(tmp_path / "whole")
        switched = (tmp_path / "whole" / "journal.jsonl").read_text().count("activated")
        assert switched >= 4
        assert (
            "checkpoint" not in whole
            and "video.mkv" in whole
            and files(tmp_path / "again").keys() == whole.keys()
        )

        def half(which: int) -> list[str]:
            numbers = range(which, kills, SIDE_BY_SIDE)
            at = tmp_path / f"side{which}"
            at.mkdir()
            return [killed(n, processes[which], job(at / "run"), took, whole) for n in numbers]

        with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
            wrong = [line for lines in pool.map(half, range(SIDE_BY_SIDE)) for line in lines if line]
        assert wrong == []
    finally:
        for process in processes:
            process.close()


SLOW_CUE = """
import time
import numpy as np
from bayesnet_track import CueDeclaration


class Slow:
    needs = ()

    def learn(self, planes, box):
        return {}

    def log_likelihood(self, planes, hypotheses, reference):
        time.sleep(0.1)
        return np.zeros(len(hypotheses))


CUE = CueDeclaration("slow", make=Slow)
"""

SLOW_GRAPH = """
bayesnet: 1
name: slow
targets:
  square:
    nodes:
      square: {motion: {random_walk: {sd_px: {x: 10, y: 10}}}, ud_fields: [x, y]}
      slow: {parent: square, agent: slow}
"""


@pytest.mark.reliability
@pytest.mark.skipif(sys.platform == "win32", reason="there is no kill -9")
def test_no_more_than_two_seconds_of_work_are_repeated(tmp_path: Path) -> None:
    """By the command line as it is, killed 4 s after its first frame; no machine is done with it by then."""
    run = tmp_path / "run"
    (tmp_path / "slow.py").write_text(SLOW_CUE)
    (tmp_path / "slow.yaml").write_text(SLOW_GRAPH)
    command = [sys.executable, "-m", "bayesnet_track", "demo", "two_squares", "--quiet", "--out", str(run)]
    command += ["--graph", str(tmp_path / "slow.yaml"), "--cue-file", str(tmp_path / "slow.py")]
    done_at: dict[int, float] = {}
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        while process.poll() is None and (not done_at or time.monotonic() < min(done_at.values()) + 4.0):
            time.sleep(0.01)
            timings = run / "timings.jsonl"
            done = timings.read_bytes().count(b"\n") if timings.exists() else 0
            if done:
                done_at.setdefault(done - 1, time.monotonic())
        assert process.poll() is None
        process.kill()
    at = standing(run).frame
    assert at is not None
    ended = max(done_at.values())
    assert ended - min(when for frame, when in done_at.items() if frame > at) <= 2.0
