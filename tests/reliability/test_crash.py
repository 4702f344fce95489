"""A crash at every write, fsync, rename, removal: a run goes on to the same bytes, or says there is none."""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from bayesnet_track import Start, track
from bayesnet_track.journal.reader import read_events, read_metrics
from bayesnet_track.journal.writer import OutputError
from bayesnet_track.runtime.checkpoints.recipe import RecipeError
from bayesnet_track.runtime.checkpoints.standing import standing, verify
from bayesnet_track.runtime.recording.rundir import RunDirectoryError
from bayesnet_track.sources.scenes.library import SceneSource

FRAMES, EVERY_S = 4, 1e-6
Work = Callable[[Path], None]
Crashed = Callable[[str, Path, int | str], int]

pytestmark = [
    pytest.mark.reliability,
    pytest.mark.usefixtures("at_once"),
    pytest.mark.skipif(sys.platform == "win32", reason="there is no fork"),
]


@pytest.fixture(scope="module", params=["mkv", "mp4"])
def job(request: pytest.FixtureRequest, nursery: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A job that begins a run of a few frames, but for its folder."""
    given = tmp_path_factory.mktemp("given")
    nursery.prepare(given, FRAMES)
    return nursery.Job("begin", "", given=str(given), every_s=EVERY_S, video=request.param)


@pytest.fixture(scope="module")
def begin(nursery: ModuleType, job: Any) -> Work:
    return lambda folder: nursery.begin(Path(job.given), folder, EVERY_S, video=job.video)


@pytest.fixture(scope="module")
def go_on(nursery: ModuleType) -> Work:
    return lambda folder: nursery.go_on(folder, EVERY_S)


@pytest.fixture(scope="module")
def crashed(nursery: ModuleType, job: Any) -> Iterator[Crashed]:
    """The exit code of work in a process that ends at a change of the disk; 137 when it did."""
    process = nursery.Nursery(Path(job.given))

    def call(work: str, folder: Path, at: int | str) -> int:
        (code,), _ = process.ask(replace(job, work=work, folder=str(folder), crash_at=at))
        return code

    yield call
    process.close()


@pytest.fixture(scope="module")
def whole(begin: Work, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("whole") / "run"
    begin(folder)
    return files(folder)


def files(folder: Path) -> dict[str, str]:
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.iterdir()
        if path.name not in ("timings.jsonl", "manifest.json")
    }


def test_a_crash_at_every_step_of_a_run(
    tmp_path: Path, begin: Work, go_on: Work, whole: dict[str, str], crashed: Crashed
) -> None:
    refused, at = 0, 0
    while True:
        at += 1
        folder = tmp_path / str(at)
        code = crashed("begin", folder, at)
        assert code in (0, 137), at
        try:
            is_finished = standing(folder).is_finished
            assert verify(folder).status == ("verified" if is_finished else "unfinished"), at
            go_on(folder)
        except RecipeError:
            refused += 1
            begin(folder)
        assert files(folder) == whole and verify(folder).status == "verified", at
        if code == 0:
            break
    print(f"{at} steps, {refused} of them before there was a run")
    # Files of the start, lines of every frame, checkpoints, and the end.
    assert at > 40 and 0 < refused < 12


def test_a_kill_before_the_video_is_closed(
    tmp_path: Path, go_on: Work, whole: dict[str, str], crashed: Crashed
) -> None:
    """The journal has its last line then, and the video lacks its own last part."""
    folder = tmp_path / "run"
    assert crashed("begin", folder, "close") == 137
    assert '"run_ended"' in (folder / "journal.jsonl").read_text()
    go_on(folder)
    assert files(folder) == whole


def test_a_crash_at_every_step_of_going_on(
    tmp_path: Path, begin: Work, go_on: Work, whole: dict[str, str], crashed: Crashed
) -> None:
    assert crashed("begin", tmp_path / "broken", 30) == 137
    at = 0
    while True:
        at += 1
        folder = shutil.copytree(tmp_path / "broken", tmp_path / str(at))
        code = crashed("resume", folder, at)
        assert code in (0, 137), at
        go_on(folder)
        assert files(folder) == whole, at
        if code == 0:
            break
    print(f"{at} steps")
    assert at > 15


def test_a_crash_at_every_step_of_an_overwrite(
    tmp_path: Path, begin: Work, go_on: Work, whole: dict[str, str], crashed: Crashed
) -> None:
    """Until a step it is the earlier run, untouched; from there on the new one, which goes on."""
    source = SceneSource.named("two_squares", 0, 2)
    list(track("two_squares", source, [Start(source.scene.start_box)], out=tmp_path / "old"))
    old, at, untouched = files(tmp_path / "old"), 0, 0
    while True:
        at += 1
        folder = shutil.copytree(tmp_path / "old", tmp_path / str(at))
        code = crashed("begin", folder, at)
        assert code in (0, 137), at
        found = verify(folder)
        if found.status == "verified" and "truth.txt" in found.outputs:
            assert at == untouched + 1, "once it is the new run, it stays that"
            untouched = at
            shutil.rmtree(folder / ".staged", ignore_errors=True)
            assert files(folder) == old, at
            begin(folder)
        else:
            assert found.status == ("verified" if standing(folder).is_finished else "unfinished"), at
            go_on(folder)
        assert files(folder) == whole and verify(folder).status == "verified", at
        shutil.rmtree(folder)
        if code == 0:
            break
    print(f"{at} steps, {untouched} of them before the new run took the place of the old one")
    assert at > 60 and 5 < untouched < 20


def full() -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_at_every_step(
    tmp_path: Path,
    begin: Work,
    go_on: Work,
    whole: dict[str, str],
    steps: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is told, whole lines are left, and with room again the run goes on."""
    at, count = 0, 0
    while True:
        at += 1
        folder = tmp_path / str(at)
        with monkeypatch.context() as patch:
            steps.restored(patch)
            counted = steps.Counted(at, full)
            counted.install()
            try:
                begin(folder)
            except (OutputError, RunDirectoryError) as error:
                count += 1
                assert "No space left" in str(error)
        for name, read in (("journal.jsonl", read_events), ("frames.npy.gz", read_metrics)):
            if (folder / name).exists():
                assert list(read(folder / name, pytest.fail)) is not None
        try:
            go_on(folder)
        except RecipeError:
            begin(folder)
        assert files(folder) == whole, at
        if counted.calls < at:
            break
    assert count > 20
