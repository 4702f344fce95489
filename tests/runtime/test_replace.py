"""Overwriting a run: the earlier one is untouched until the new one has its first frame."""

from __future__ import annotations

import itertools
import shutil
from pathlib import Path

import pytest

from bayesnet_track import Result, Start, track
from bayesnet_track.cli.main import main
from bayesnet_track.journal import disk
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.writer import OutputError
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.checkpoints.standing import standing, verify
from bayesnet_track.runtime.recording.manifest import replace_run, settle
from bayesnet_track.runtime.recording.rundir import RunDirectory, RunDirectoryError
from bayesnet_track.sources.scenes.library import SceneSource


def tracked(folder: Path, frames: int, seed: int = 0, **options: object) -> Path:
    source = SceneSource.named("two_squares", seed, 4)
    results = track("two_squares", source, [Start(source.scene.start_box)], out=folder, **options)
    for _ in itertools.islice(results, frames):
        pass
    results.close()
    return folder


def held(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def old(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tracked(tmp_path_factory.mktemp("old") / "run", 5)


@pytest.fixture(scope="module")
def new(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tracked(tmp_path_factory.mktemp("new") / "run", 5, seed=1)


@pytest.fixture
def run(old: Path, tmp_path: Path) -> Path:
    return shutil.copytree(old, tmp_path / "run")


class Fails:
    def event(self, event: Event) -> None:
        pass

    def frame(self, result: Result) -> None:
        raise RuntimeError("in the first frame")


def test_a_first_frame_that_fails_costs_nothing(run: Path, old: Path) -> None:
    with pytest.raises(RuntimeError, match="in the first frame"):
        tracked(run, 5, seed=1, overwrite=True, sinks=[Fails()])
    assert held(run) == held(old) and verify(run).status == "verified"


def test_a_source_or_graph_that_fails_costs_nothing(run: Path, old: Path, tmp_path: Path) -> None:
    (tmp_path / "wrong.yaml").write_text("bayesnet: 1\nname: x\n")
    (tmp_path / "wrong.mp4").write_bytes(b"no video")
    out = ["--init", "1,1,9,9", "--out", str(run), "--overwrite", "--quiet"]
    assert main(["run", "general", "--source", str(tmp_path / "wrong.mp4"), *out]) == 4
    assert main(["run", str(tmp_path / "wrong.yaml"), "--source", str(tmp_path / "wrong.mp4"), *out]) == 3
    assert held(run) == held(old)


def test_with_the_first_frame_it_is_the_new_run(run: Path, new: Path) -> None:
    tracked(run, 1, seed=1, overwrite=True)
    assert standing(run).frame == 0 and not (run / "manifest.json").exists()
    list(resume(run))
    assert verify(run).status == "verified" and verify(run).result == verify(new).result


def test_what_a_broken_off_replacement_left_is_completed(run: Path, new: Path) -> None:
    """As a kill right after the deciding rename leaves it."""
    small = {"recipe": "run.json", "graph": "graph.yaml", "truth": "truth.txt"}
    (run / ".replacing").mkdir()
    for name in small.values():
        shutil.copy(new / name, run / ".replacing" / name)
    assert (standing(run).is_finished, verify(run).status) == (False, "unfinished")
    for command in ("log", "score", "report"):
        assert main([command, str(run)]) == 4
    with pytest.raises(RunDirectoryError, match="a run is there already"):
        tracked(run, 1)
    assert main(["resume", str(run), "--quiet"]) == 0
    assert verify(run).result == verify(new).result
    assert sorted(held(run)) == sorted(held(new))


def test_what_was_not_decided_is_dropped(run: Path, old: Path) -> None:
    (run / ".staged").mkdir()
    (run / ".staged" / "run.json").write_text("{")
    assert verify(run).status == "verified"
    assert list(resume(run)) == []
    assert held(run) == held(old)


def test_a_full_disk_before_the_decision_leaves_the_earlier_run(
    run: Path, old: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(source: Path, target: Path) -> None:
        raise OSError(28, "No space left on device", str(source))

    with monkeypatch.context() as patch:
        patch.setattr(disk, "replace", full)
        with pytest.raises(OutputError, match="No space left"):
            replace_run(RunDirectory(run), {"graph": b"new"})
    settle(RunDirectory(run))
    assert held(run) == held(old)
