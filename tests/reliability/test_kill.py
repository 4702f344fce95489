"""Kill -9 at random times, then resume: the run directory is that of an unbroken run, byte for byte."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from bayesnet_track.runtime.checkpoints.recipe import RecipeError
from bayesnet_track.runtime.checkpoints.standing import standing

SIDE_BY_SIDE = 2
SCRIPT = Path(__file__).with_name("nursery.py")


@pytest.fixture
def given(tmp_path: Path, nursery: ModuleType) -> Path:
    """A graph and pictures."""
    folder = tmp_path / "given"
    folder.mkdir()
    nursery.prepare(folder)
    return folder


class Nursery:
    """A process that forks runs and kills them."""

    def __init__(self, given: Path, executor: str) -> None:
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            [sys.executable, SCRIPT, given, executor], stdin=pipe, stdout=pipe, text=True
        )
        assert self._answer() == ["ready"]

    def ask(self, work: str, folder: Path, delay: float = 0.0) -> tuple[int, float]:
        """The exit code, -9 when it was killed, and the seconds that it took."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{work} {folder} {delay:.6f}\n")
        self._process.stdin.flush()
        code, seconds = self._answer()
        return int(code), float(seconds)

    def _answer(self) -> list[str]:
        assert self._process.stdout is not None
        return self._process.stdout.readline().split()

    def close(self) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(10)
        self._process.stdout.close()


def files(folder: Path) -> dict[str, str]:
    """File -> hash, but for the times, of which only the number of lines is the same."""
    return {
        path.name: str(path.read_bytes().count(b"\n"))
        if path.name in ("timings.jsonl", "manifest.json")
        else hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.iterdir()
    }


def killed(number: int, nursery: Nursery, folder: Path, took: float, whole: dict[str, str]) -> str:
    """What came of one run that is killed once or more and resumed; "" when all is as it should be."""
    rng = np.random.Generator(np.random.Philox(number))
    work, kills = "begin", 0
    while True:
        # The first kill falls anywhere in a run; every other run is killed again while it is resumed.
        is_killed = kills == 0 or (number % 2 == 0 and kills < 3)
        delay = float(rng.uniform(0.0, 1.1 * took)) if is_killed else 0.0
        code, _ = nursery.ask(work, folder, delay)
        kills += code == -9
        if code == 0 and kills == 0:
            # It was done before the kill.
            shutil.rmtree(folder)
            continue
        if code == 0:
            break
        if code != -9:
            error_file = folder.with_name(f"{folder.name}.error")
            return f"{number}: {error_file.read_text() if error_file.exists() else f'exit code {code}'}"
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
    tmp_path: Path, given: Path, executor: str, kills: int
) -> None:
    """Half of the runs are killed again while they are resumed; the video is one of the files."""
    nurseries = [Nursery(given, executor) for _ in range(SIDE_BY_SIDE)]
    try:
        nurseries[0].ask("begin", tmp_path / "whole")
        _, took = nurseries[1].ask("begin", tmp_path / "again")
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
            return [killed(n, nurseries[which], at / "run", took, whole) for n in numbers]

        with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
            wrong = [line for lines in pool.map(half, range(SIDE_BY_SIDE)) for line in lines if line]
        assert wrong == []
    finally:
        for nursery in nurseries:
            nursery.close()


@pytest.mark.reliability
@pytest.mark.skipif(sys.platform == "win32", reason="there is no kill -9")
def test_no_more_than_two_seconds_of_work_are_repeated(tmp_path: Path) -> None:
    """By the command line as it is, killed 4 s after its first frame."""
    run = tmp_path / "run"
    command = [sys.executable, "-m", "bayesnet_track", "demo", "crowd", "--quiet", "--out", str(run)]
    done_at: dict[int, float] = {}
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        while not done_at or time.monotonic() < done_at[0] + 4.0:
            time.sleep(0.01)
            timings = run / "timings.jsonl"
            done = timings.read_bytes().count(b"\n") if timings.exists() else 0
            if done:
                done_at.setdefault(0 if not done_at else done, time.monotonic())
        process.kill()
    at = standing(run).frame
    assert at is not None
    ended = max(done_at.values())
    assert ended - min(when for done, when in done_at.items() if done > at) <= 2.0
