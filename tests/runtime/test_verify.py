"""The manifest of a finished run, and every way in which a run can differ from it."""

from __future__ import annotations

import itertools
import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from bayesnet_track import Start, track
from bayesnet_track.cli.main import main
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.checkpoints.standing import standing, verify
from bayesnet_track.runtime.recording.manifest import ManifestError, lock_run, read_manifest
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.sources.scenes.library import SceneSource

FRAMES = 4
OUTPUTS = {
    "frames.npy.gz",
    "graph.yaml",
    "journal.jsonl",
    "run.json",
    "timings.jsonl",
    "tracks.txt",
    "truth.txt",
    "video.mkv",
}


def tracked(folder: Path, frames: int | None = None) -> Path:
    source = SceneSource.named("two_squares", 0, FRAMES)
    results = track("two_squares", source, [Start(source.scene.start_box)], out=folder, video=True)
    for _ in itertools.islice(results, frames):
        pass
    results.close()
    return folder


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tracked(tmp_path_factory.mktemp("finished") / "run")


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    return shutil.copytree(finished, tmp_path / "run")


def test_the_manifest_lists_every_output(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(run)]) == 0
    assert f"{run}: verified: 8 files, result " in capsys.readouterr().out
    assert main(["verify", str(run), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["status"] == "verified" and answer["outputs"] == dict.fromkeys(sorted(OUTPUTS), "ok")
    held = json.loads((run / "manifest.json").read_text())
    assert {name: one["size"] for name, one in held["outputs"].items()} == {
        name: (run / name).stat().st_size for name in OUTPUTS
    }
    assert {name: one["varies_with"] for name, one in held["outputs"].items()} == {
        **dict.fromkeys(OUTPUTS, "inputs"),
        "run.json": "machine",
        "video.mkv": "machine",
        "timings.jsonl": "clock",
    }


def test_equal_runs_have_equal_results(finished: Path, tmp_path: Path) -> None:
    again = tracked(tmp_path / "again")
    first, second = verify(finished), verify(again)
    assert first.result == second.result is not None
    # Times differ between runs, and so do the manifests that hold them.
    assert (finished / "timings.jsonl").read_bytes() != (again / "timings.jsonl").read_bytes()
    changed = (again / "manifest.json").read_text().replace(str(second.result), "0" * 64)
    (again / "manifest.json").write_text(changed)
    with pytest.raises(ManifestError, match="changed since it was written"):
        read_manifest(again / "manifest.json")


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


def grown(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b"\n")


def flipped(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[random.Random(path.name).randrange(len(data))] ^= 1
    path.write_bytes(data)


def a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize("name", sorted(OUTPUTS))
@pytest.mark.parametrize(
    ("edit", "finding"),
    [
        (Path.unlink, "missing"),
        (cut, "truncated"),
        (grown, "changed"),
        (flipped, "changed"),
        (a_folder, "changed"),
    ],
)
def test_every_edit_of_every_output_is_found(
    run: Path, name: str, edit: Callable[[Path], None], finding: str, capsys: pytest.CaptureFixture[str]
) -> None:
    edit(run / name)
    assert main(["verify", str(run)]) == 4
    said = capsys.readouterr().out
    assert f"{run}/{name}: " in said and "1 of 8 files are not as the run left them" in said
    assert verify(run).outputs == {**dict.fromkeys(OUTPUTS, "ok"), name: finding}


@pytest.mark.parametrize("edit", [cut, grown, flipped])
def test_an_edited_manifest_vouches_for_nothing(
    run: Path, edit: Callable[[Path], None], capsys: pytest.CaptureFixture[str]
) -> None:
    edit(run / "manifest.json")
    for command in ("verify", "resume"):
        assert main([command, str(run)]) == 4
        assert "manifest.json: changed since it was written" in capsys.readouterr().err


def test_an_extra_file_is_found_and_a_page_is_listed(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(run), "--frames", "none"]) == 0
    assert verify(run).status == "verified" and verify(run).outputs["report.html"] == "ok"
    grown(run / "report.html")
    (run / "notes.txt").write_text("mine")
    found = {name: one for name, one in verify(run).outputs.items() if one != "ok"}
    assert found == {"report.html": "changed", "notes.txt": "extra"}


def test_an_unfinished_run_is_said_to_be_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tracked(tmp_path / "run", 2)
    assert main(["verify", str(run)]) == 5
    assert f"`bayesnet-track resume {run}` finishes it" in capsys.readouterr().out
    with lock_run(RunDirectory(run)):
        assert main(["verify", str(run)]) == 5
        assert "a process is writing it now" in capsys.readouterr().out
    list(resume(run))
    assert verify(run).status == "verified"
    assert main(["verify", str(tmp_path)]) == 4
    assert "not a run" in capsys.readouterr().err


def test_without_its_manifest_a_run_is_finished_again(run: Path, finished: Path) -> None:
    """As a kill leaves it after the journal's last line, with a video that has no end."""
    (run / "manifest.json").unlink()
    cut(run / "video.mkv")
    assert not standing(run).is_finished
    list(resume(run))
    assert (run / "video.mkv").read_bytes() == (finished / "video.mkv").read_bytes()
    assert verify(run).result == verify(finished).result


def test_what_a_kill_in_the_last_moment_left_is_removed(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("checkpoint", "manifest.json.part"):
        (run / name).write_text("left")
    assert verify(run).status == "verified"
    assert main(["resume", str(run)]) == 0
    assert "it is finished; there is nothing to do" in capsys.readouterr().out
    assert not (run / "checkpoint").exists() and not (run / "manifest.json.part").exists()
