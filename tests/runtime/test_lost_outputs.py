"""Outputs that something else removes, replaces or changes while a run writes them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.writer import LineFile, OutputError
from bayesnet_track.runtime.recording.record import Recorder
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.runtime.results import Result
from bayesnet_track.runtime.run import Start, run
from bayesnet_track.sources.scene_source import SceneSource
from bayesnet_track.sources.scenes import make_scene

OUTPUTS = ("journal.jsonl", "frames.jsonl", "tracks.txt", "tracks.csv", "timings.jsonl", "video.mkv")


def renamed(path: Path) -> None:
    path.rename(path.with_name("elsewhere"))


def truncated(path: Path) -> None:
    with path.open("r+b") as file:
        file.truncate(1)


def grown(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b"x\n")


def replaced(path: Path) -> None:
    shutil.copy(path, path.with_name("copy"))
    path.with_name("copy").replace(path)


def edited(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[0] ^= 1
    with path.open("r+b") as file:
        file.write(data)


EDITS = {
    Path.unlink: "removed or renamed",
    renamed: "removed or renamed",
    truncated: "it has 1 bytes, not",
    grown: "something else changed it",
    replaced: "another file has taken its place",
}


@pytest.fixture(scope="module")
def graph() -> CheckedGraph:
    return load_graph("two_squares")


def tracked(graph: CheckedGraph, folder: Path, then: Callable[[], None], video: bool = False) -> list[int]:
    """Track four frames, doing something after the second; the frames that were done."""
    scene, done = make_scene("two_squares"), list[int]()
    with Recorder(RunDirectory.create(folder), graph, 0.04, ("video",) if video else ()) as recorder:
        for result in run(graph, SceneSource(scene, "scene", 4), [Start(scene.start_box)], sinks=[recorder]):
            done.append(result.frame.index)
            if result.frame.index == 1:
                then()
        recorder.finish()
    return done


@pytest.mark.parametrize("name", OUTPUTS)
@pytest.mark.parametrize("edit", list(EDITS))
def test_it_is_told_with_the_next_line(
    graph: CheckedGraph, tmp_path: Path, name: str, edit: Callable[[Path], None]
) -> None:
    path = tmp_path / "run" / name
    with pytest.raises(OutputError, match=EDITS[edit]) as failed:
        tracked(graph, tmp_path / "run", lambda: edit(path), video=name == "video.mkv")
    assert str(failed.value).startswith(f"{path}: ")


def test_bytes_that_were_edited_in_place_are_found_in_the_end(graph: CheckedGraph, tmp_path: Path) -> None:
    path = tmp_path / "run" / "tracks.csv"
    with pytest.raises(OutputError, match=r"tracks\.csv: something else changed it"):
        tracked(graph, tmp_path / "run", lambda: edited(path))


def test_a_folder_that_is_moved_away_is_told(graph: CheckedGraph, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="removed or renamed"):
        tracked(graph, tmp_path / "run", lambda: renamed(tmp_path / "run"))


def test_another_current_directory_is_no_loss(
    graph: CheckedGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "below").mkdir()
    with LineFile(Path("lines")) as file:
        for _ in range(2):
            file.append("x")
            file.flush()
            monkeypatch.chdir(tmp_path / "below")
    assert (tmp_path / "lines").read_text() == "x\nx\n"


def test_it_is_exit_code_6(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    frame = Recorder.frame

    def then_removed(recorder: Recorder, result: Result) -> None:
        frame(recorder, result)
        if result.frame.index == 1:
            (tmp_path / "run" / "tracks.txt").unlink()

    monkeypatch.setattr(Recorder, "frame", then_removed)
    assert main(["demo", "--end", "4", "--quiet", "--out", str(tmp_path / "run")]) == 6
    _, err = capsys.readouterr()
    assert "tracks.txt: it was removed or renamed while it was being written" in err
