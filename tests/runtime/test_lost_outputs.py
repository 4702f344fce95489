"""Outputs that something else removes, replaces or changes while a run writes them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from bayesnet_track import Result, Start, load_graph, track
from bayesnet_track.cli.main import main
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.journal.writer import LineFile, OutputError
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.checkpoints.standing import verify
from bayesnet_track.runtime.recording.manifest import FOREIGN
from bayesnet_track.runtime.recording.record import Recorder
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.runtime.run import run
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

OUTPUTS = ("journal.jsonl", "frames.npy.gz", "tracks.txt", "timings.jsonl", "video.mkv")


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


@pytest.mark.slow
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
    path = tmp_path / "run" / "tracks.txt"
    with pytest.raises(OutputError, match=r"tracks\.txt: something else changed it"):
        tracked(graph, tmp_path / "run", lambda: edited(path))


@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_bytes_of_a_video_that_were_edited_in_place_are_found_in_the_end(
    graph: CheckedGraph, tmp_path: Path, share: float
) -> None:
    path = tmp_path / "run" / "video.mkv"

    def edit() -> None:
        data = bytearray(path.read_bytes())
        data[int(share * (len(data) - 1))] ^= 1
        with path.open("r+b") as file:
            file.write(data)

    with pytest.raises(OutputError, match=r"video\.mkv: something else changed it while"):
        tracked(graph, tmp_path / "run", edit, video=True)


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


SMALL = ("run.json", "graph.yaml", "truth.txt")


@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("edit", [edited, grown, truncated, renamed, Path.unlink])
def test_what_was_written_at_the_start_is_not_vouched_for_as_something_else_left_it(
    tmp_path: Path, name: str, edit: Callable[[Path], None]
) -> None:
    source, path = SceneSource.named("two_squares", 0, 3), tmp_path / "run" / name
    results = track("two_squares", source, [Start(source.scene.start_box)], out=path.parent)
    next(results)
    own = path.read_bytes()
    edit(path)
    foreign = path.read_bytes() if path.exists() else None
    with pytest.raises(OutputError, match=rf"{name}: .* during the run, which wrote") as failed:
        list(results)
    assert path.read_bytes() == own
    aside = path.with_name(name + FOREIGN)
    if foreign is not None:
        assert f"the changed one is now {aside.name}" in str(failed.value)
        assert aside.read_bytes() == foreign
        assert verify(path.parent).outputs[aside.name] == "extra"
        aside.unlink()
    if edit is not renamed:
        assert verify(path.parent).status == "verified"


def test_an_edited_graph_is_exit_code_6(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    frame = Recorder.frame

    def then_edited(recorder: Recorder, result: Result) -> None:
        frame(recorder, result)
        edited(tmp_path / "run" / "graph.yaml")

    monkeypatch.setattr(Recorder, "frame", then_edited)
    assert main(["demo", "--end", "3", "--quiet", "--out", str(tmp_path / "run")]) == 6
    _, err = capsys.readouterr()
    assert "run/graph.yaml: something else changed it during the run, which wrote its own again" in err
    assert main(["verify", str(tmp_path / "run")]) == 4


def test_a_link_in_the_place_of_a_file_is_not_written_through(tmp_path: Path) -> None:
    source, path = SceneSource.named("two_squares", 0, 3), tmp_path / "run" / "graph.yaml"
    results = track("two_squares", source, [Start(source.scene.start_box)], out=path.parent)
    next(results)
    path.rename(tmp_path / "graph.yaml")
    path.symlink_to(tmp_path / "graph.yaml")
    with pytest.raises(OutputError, match="something else changed it"):
        list(results)
    assert not path.is_symlink() and path.read_bytes() == (tmp_path / "graph.yaml").read_bytes()


@pytest.mark.parametrize("name", SMALL)
def test_a_run_that_goes_on_vouches_for_what_it_found(tmp_path: Path, name: str) -> None:
    source, path = SceneSource.named("two_squares", 0, 4), tmp_path / "run" / name
    results = track(
        "two_squares", source, [Start(source.scene.start_box)], out=path.parent, checkpoint_every=1e-9
    )
    next(results), next(results)
    results.close()
    again = resume(path.parent)
    next(again)
    grown(path)
    with pytest.raises(OutputError, match="something else changed it during the run"):
        list(again)
    path.with_name(name + FOREIGN).unlink()
    assert verify(path.parent).status == "verified"


def test_a_recipe_with_another_blank_is_not_that_of_the_checkpoint(tmp_path: Path) -> None:
    source, path = SceneSource.named("two_squares", 0, 4), tmp_path / "run" / "run.json"
    results = track(
        "two_squares", source, [Start(source.scene.start_box)], out=path.parent, checkpoint_every=1e-9
    )
    next(results), next(results)
    results.close()
    path.write_text(path.read_text() + " ")
    with pytest.raises(ValueError, match="another recipe than that of the checkpoint"):
        list(resume(path.parent))
