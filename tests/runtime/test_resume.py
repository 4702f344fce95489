"""A run that was broken off goes on, and what is there in the end is what an unbroken run leaves."""

from __future__ import annotations

import errno
import hashlib
import itertools
import json
from collections.abc import Callable, Generator
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import Result, Start, track
from bayesnet_track.journal.events.load import Toggled
from bayesnet_track.runtime import arguments
from bayesnet_track.runtime.checkpoints.recipe import RecipeError
from bayesnet_track.runtime.checkpoints.resume import ResumeError, resume
from bayesnet_track.runtime.checkpoints.standing import RunStanding, standing
from bayesnet_track.runtime.recording.manifest import lock_run
from bayesnet_track.runtime.recording.rundir import RunDirectory, RunDirectoryError
from bayesnet_track.runtime.results import Summary, Switchboard
from bayesnet_track.sources.scenes.library import SceneSource

FRAMES = 10


def files(folder: Path) -> dict[str, str]:
    """File -> hash, but for the times, of which only the number of lines is the same."""
    return {
        path.name: str(path.read_bytes().count(b"\n"))
        if path.name in ("timings.jsonl", "manifest.json")
        else hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.iterdir()
    }


def begun(folder: Path, frames: int | None = None, **options: object) -> Path:
    """A run over the scene, broken off after so many frames."""
    source = SceneSource.named("two_squares", 0, FRAMES)
    results = track("two_squares", source, [Start(source.scene.start_box)], out=folder, **options)
    for _ in itertools.islice(results, frames):
        pass
    results.close()
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return files(begun(tmp_path_factory.mktemp("whole") / "run"))


def test_it_goes_on_after_the_last_frame(tmp_path: Path, whole: dict[str, str]) -> None:
    run = begun(tmp_path / "run", 5)
    assert standing(run) == RunStanding(False, 4, "interrupted")
    summary = Summary()
    assert [result.frame.index for result in resume(run, summary=summary)] == list(range(5, FRAMES))
    assert (summary.frames, summary.complete, summary.reason) == (FRAMES, True, "end_of_source")
    assert files(run) == whole
    assert standing(run).is_finished
    assert list(resume(run)) == []


def test_it_goes_on_as_often_as_it_is_broken_off(tmp_path: Path, whole: dict[str, str]) -> None:
    run = begun(tmp_path / "run", 1)
    for _ in range(2):
        results = resume(run)
        next(results), next(results)
        results.close()
    assert [result.frame.index for result in resume(run)] == list(range(5, FRAMES))
    assert files(run) == whole


def test_without_a_checkpoint_it_begins_anew(tmp_path: Path, whole: dict[str, str]) -> None:
    run = begun(tmp_path / "run", 5, checkpoint_every=0)
    said: list[str] = []
    assert len(list(resume(run, notice=said.append))) == FRAMES
    assert said == ["it begins anew: there is no checkpoint"]
    assert files(run) == whole


def test_what_was_written_after_the_checkpoint_is_written_again(
    tmp_path: Path, whole: dict[str, str]
) -> None:
    run = begun(tmp_path / "run", 5)
    for name in ("journal.jsonl", "tracks.txt"):
        with (run / name).open("ab") as file:
            file.write(b'a whole line\n{"torn')
    (run / "inputs.jsonl").touch()
    said: list[str] = []
    list(resume(run, notice=said.append))
    assert sum("torn" in line for line in said) == 2
    assert files(run) == whole


@pytest.mark.slow
def test_switches_of_frames_after_the_checkpoint_come_again(tmp_path: Path) -> None:
    def at_frame_7(frame: int) -> tuple[Toggled, ...]:
        return (Toggled(7, "1", "blobs", False),) if frame == 7 else ()

    expected = files(begun(tmp_path / "whole", inputs=at_frame_7))
    assert "inputs.jsonl" in expected
    run = begun(tmp_path / "run", 5, inputs=at_frame_7)
    held = (run / "checkpoint").read_bytes()
    results = resume(run, inputs=at_frame_7)
    for _ in itertools.islice(results, 4):
        pass
    results.close()
    # As a kill right before the next checkpoint leaves it.
    (run / "checkpoint").write_bytes(held)
    list(resume(run, inputs=Switchboard()))
    assert files(run) == expected


@pytest.mark.slow
def test_switches_still_to_come_outlast_that_it_is_broken_off_again(tmp_path: Path) -> None:
    def at_frame_7(frame: int) -> tuple[Toggled, ...]:
        return (Toggled(7, "1", "blobs", False),) if frame == 7 else ()

    expected = files(begun(tmp_path / "whole", inputs=at_frame_7))
    run = begun(tmp_path / "run", 5, inputs=at_frame_7)
    held = (run / "checkpoint").read_bytes()
    list(itertools.islice(resume(run, inputs=at_frame_7), 4))
    (run / "checkpoint").write_bytes(held)
    for _ in range(2):
        results = resume(run)
        assert next(results).frame.index < 7
        results.close()
    list(resume(run))
    assert files(run) == expected


@pytest.mark.slow
def test_of_two_switches_of_a_frame_none_is_lost_when_only_one_was_written_again(tmp_path: Path) -> None:
    switches = (Toggled(7, "1", "blobs", False), Toggled(7, "1", "color", False))

    def at_frame_7(frame: int) -> tuple[Toggled, ...]:
        return switches if frame == 7 else ()

    expected = files(begun(tmp_path / "whole", inputs=at_frame_7))
    run = begun(tmp_path / "run", 5, inputs=at_frame_7)
    held = (run / "checkpoint").read_bytes()
    for inputs in (at_frame_7, None):
        results = resume(run, inputs=inputs)
        list(itertools.islice(results, 4))
        results.close()
        (run / "checkpoint").write_bytes(held)
    # As a power cut in the middle of that write leaves it.
    first = (run / "inputs.jsonl").read_bytes().index(b"\n") + 1
    (run / "inputs.jsonl").write_bytes((run / "inputs.jsonl").read_bytes()[: first + 5])
    list(resume(run))
    assert files(run) == expected


def test_a_finished_run_has_no_checkpoint_though_it_went_on_without_any(
    tmp_path: Path, whole: dict[str, str]
) -> None:
    run = begun(tmp_path / "run", 5)
    list(resume(run, checkpoint_every=0))
    assert files(run) == whole and standing(run).is_finished


@pytest.mark.slow
def test_a_budget_stays_and_what_was_late_is_not_measured_twice(tmp_path: Path) -> None:
    """No frame takes a nanosecond, so every one is late that is measured."""

    def on(folder: Path, **options: object) -> Generator[Result, None, None]:
        source = SceneSource.named("two_squares", 0, 24)
        return track("two_squares", source, [Start(source.scene.start_box)], out=folder, **options)

    run = tmp_path / "run"
    results = on(run, budget_ms=1e-6)
    list(itertools.islice(results, 5))
    results.close()
    held = (run / "checkpoint").read_bytes()
    results = resume(run)
    list(itertools.islice(results, 9))
    results.close()
    before = (run / "inputs.jsonl").read_text()
    (run / "checkpoint").write_bytes(held)
    list(resume(run))
    after = (run / "inputs.jsonl").read_text()
    assert before and after.startswith(before)
    late = [json.loads(line)["frame"] for line in after.splitlines()]
    assert late == list(range(late[0], 24)), "each once, from the first that is measured to the last"
    list(on(tmp_path / "again", inputs=run / "inputs.jsonl"))
    for name in ("journal.jsonl", "frames.npy.gz", "inputs.jsonl"):
        assert (run / name).read_bytes() == (tmp_path / "again" / name).read_bytes(), name


@pytest.mark.slow
def test_the_video_is_whole(tmp_path: Path) -> None:
    expected = files(begun(tmp_path / "whole", video=True))
    run = begun(tmp_path / "run", 5, video=True)
    list(resume(run))
    assert files(run) == expected


def cut(run: Path) -> None:
    (run / "frames.npy.gz").write_bytes((run / "frames.npy.gz").read_bytes()[:-9])


def edited(run: Path) -> None:
    path = run / "journal.jsonl"
    path.write_bytes(path.read_bytes().replace(b'"seed": 0', b'"seed": 1'))


def gone(run: Path) -> None:
    (run / "tracks.txt").unlink()


def other_seed(run: Path) -> None:
    recipe = json.loads((run / "run.json").read_text())
    recipe["seed"] = 1
    (run / "run.json").write_text(json.dumps(recipe))


def damaged(run: Path) -> None:
    data = bytearray((run / "checkpoint").read_bytes())
    data[-1] ^= 1
    (run / "checkpoint").write_bytes(data)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (cut, ResumeError, "frames.npy.gz: cut off"),
        (edited, ResumeError, "journal.jsonl: changed"),
        (gone, ResumeError, "tracks.txt"),
        (other_seed, ValueError, "another recipe"),
        (damaged, ValueError, "damaged"),
    ],
)
def test_what_is_not_as_it_was_is_refused_and_nothing_changes(
    tmp_path: Path, change: Callable[[Path], None], error: type[Exception], words: str
) -> None:
    run = begun(tmp_path / "run", 5)
    change(run)
    before = files(run)
    with pytest.raises(error, match=words):
        list(resume(run))
    assert files(run) == before


@pytest.mark.parametrize("damage", [damaged, lambda run: (run / "checkpoint").write_bytes(b""), None])
def test_a_damaged_checkpoint_falls_back_to_the_one_before(
    tmp_path: Path, whole: dict[str, str], damage: Callable[[Path], None] | None
) -> None:
    run = begun(tmp_path / "run", 3)
    results = resume(run)
    next(results), next(results)
    results.close()
    assert standing(run).frame == 4
    if damage is None:  # as a crash between two renames leaves it
        (run / "checkpoint").unlink()
    else:
        damage(run)
    assert standing(run).frame == 2
    said: list[str] = []
    results = resume(run, notice=said.append)
    assert next(results).frame.index == 3
    results.close()
    assert any("the checkpoint before it is used, of frame 2" in line for line in said) == (
        damage is not None
    )
    assert standing(run).frame == 3 and (run / "checkpoint.previous").is_file()
    list(resume(run))
    assert files(run) == whole


def test_the_good_checkpoint_outlasts_a_second_damage(tmp_path: Path, whole: dict[str, str]) -> None:
    """The damaged one must not become the one before."""
    run = begun(tmp_path / "run", 3)
    list(itertools.islice(results := resume(run), 2))
    results.close()
    for frame in (2, 2):
        damaged(run)
        assert standing(run).frame == frame
        results = resume(run)
        next(results)
        results.close()
    list(resume(run))
    assert files(run) == whole


def test_another_graph_is_refused(tmp_path: Path) -> None:
    run = begun(tmp_path / "run", 3)
    with (run / "graph.yaml").open("a") as file:
        file.write("\n")
    with pytest.raises(RecipeError, match="another graph"):
        list(resume(run))


def test_another_video_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    source = SceneSource.named("two_squares", 0, 6)
    for frame in source:
        cv2.imwrite(str(folder / f"{frame.index}.bmp"), frame.image)
    results = track("two_squares", folder, source.scene.start_box, out=tmp_path / "run")
    next(results), next(results)
    results.close()
    held = (folder / "1.bmp").read_bytes()
    # The same size, other pixels: the fingerprint of a folder does not read all of it.
    cv2.imwrite(str(folder / "1.bmp"), np.zeros_like(source.scene.frames[0]))
    with pytest.raises(ValueError, match="frame 1 of the source has other pixels"):
        list(resume(tmp_path / "run"))
    (folder / "1.bmp").write_bytes(held)
    (folder / "6.bmp").write_bytes(held)
    with pytest.raises(ResumeError, match=r"source: 6 files.*now 7 files"):
        list(resume(tmp_path / "run"))
    (folder / "6.bmp").unlink()
    assert [result.frame.index for result in resume(tmp_path / "run")] == [2, 3, 4, 5]


def test_a_source_of_ones_own_is_asked_for(tmp_path: Path) -> None:
    scene = SceneSource.named("two_squares", 0, 6)
    own = SceneSource(scene.scene, "mine", 6)
    results = track("two_squares", own, [Start(scene.scene.start_box)], out=tmp_path / "run")
    next(results), next(results)
    results.close()
    with pytest.raises(ResumeError, match="an object"):
        list(resume(tmp_path / "run"))
    assert len(list(resume(tmp_path / "run", source=own))) == 6


def test_an_empty_folder_and_one_that_is_being_written_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecipeError, match=r"no run\.json"):
        list(resume(tmp_path))
    run = begun(tmp_path / "run", 2)
    with lock_run(RunDirectory(run)), pytest.raises(RunDirectoryError, match="another process"):
        list(resume(run))


def test_a_run_that_is_being_written_is_not_overwritten(tmp_path: Path) -> None:
    run = begun(tmp_path / "run", 2)
    before = files(run)
    with lock_run(RunDirectory(run)), pytest.raises(RunDirectoryError, match="another process"):
        begun(run, 2, overwrite=True)
    assert files(run) == before
    (run / "checkpoint.previous").unlink(missing_ok=True)  # where two frames took a second
    assert files(begun(run, 2, overwrite=True)).keys() >= before.keys() - {"checkpoint.previous"}


def test_where_a_file_system_has_no_locks_a_run_goes_on_without(
    tmp_path: Path, whole: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_locks(file: object, operation: int) -> None:
        raise OSError(errno.EOPNOTSUPP, "Operation not supported")

    monkeypatch.setattr("fcntl.flock", no_locks)
    run = begun(tmp_path / "run", 9)
    list(resume(run))
    assert files(run) == whole


def test_a_run_is_told_when_what_its_agents_keep_cannot_be_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: dict[str, str]
) -> None:
    monkeypatch.setattr(arguments, "opaque_agents", lambda engine: ("mil",))
    monkeypatch.setattr("bayesnet_track.runtime.checkpoints.resume.opaque_agents", lambda engine: ("mil",))
    run = begun(tmp_path / "run", 5)
    assert standing(run).frame is None
    said: list[str] = []
    assert len(list(resume(run, notice=said.append))) == FRAMES
    assert said == ["it begins anew: what mil keeps cannot be stored"]
    assert files(run) == whole
