"""A run over every third frame: resumed, repeated, scored and looked at, all by the source's numbers."""

from __future__ import annotations

import itertools
from pathlib import Path

import cv2
import pytest

from bayesnet_track import open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.evaluate.mot import score_mot_files
from bayesnet_track.evaluate.runs import score_run
from bayesnet_track.journal.events.runs import RunStarted
from bayesnet_track.runtime.checkpoints.recipe import Recipe
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.recording.run_reader import pictures_of
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.sources.scenes import make_scene

STRIDE, FRAMES = 3, 20
TRACKED = list(range(0, FRAMES, STRIDE))
OUTPUTS = ("journal.jsonl", "frames.npy.gz", "tracks.txt", "run.json", "video.mkv")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames and ground truth of a scene, as files."""
    folder, made = tmp_path_factory.mktemp("scene"), make_scene("two_squares", 0)
    (folder / "img").mkdir()
    for index in range(FRAMES):
        cv2.imwrite(str(folder / "img" / f"{index:03}.png"), made.frames[index])
    rows = [",".join(f"{value:g}" for value in box) for box in made.truth[:FRAMES]]
    (folder / "truth.txt").write_text("\n".join(rows) + "\n")
    mot = [f"{index + 1},1,{row},1,1,1" for index, row in enumerate(rows)]
    (folder / "gt.txt").write_text("\n".join(mot) + "\n")
    return folder


def begun(scene: Path, out: Path, frames: int | None = None) -> Path:
    box = make_scene("two_squares", 0).start_box
    results = track("two_squares", scene / "img", box, out=out, stride=STRIDE, video=True)
    for _ in itertools.islice(results, frames):
        pass
    results.close()
    return out


@pytest.fixture(scope="module")
def whole(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return begun(scene, tmp_path_factory.mktemp("whole") / "run")


def test_only_these_frames_are_tracked_with_the_numbers_of_the_source(whole: Path) -> None:
    assert [line.frame for line in open_run(whole).metrics] == TRACKED
    assert Recipe.read(whole).origin.stride == STRIDE
    kinds = [type(event).__name__ for event in open_run(whole).events]
    assert "FramesMissing" not in kinds


def test_a_run_that_was_broken_off_goes_on_to_the_same_bytes(
    scene: Path, whole: Path, tmp_path: Path
) -> None:
    run = begun(scene, tmp_path / "run", 3)
    assert [result.frame.index for result in resume(run)] == TRACKED[3:]
    assert {name: (run / name).read_bytes() for name in OUTPUTS} == {
        name: (whole / name).read_bytes() for name in OUTPUTS
    }


def test_what_if_reads_the_same_frames(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "again"
    assert main(["what-if", str(whole), "--seed", "1", "--out", str(out), "--quiet"]) == 0
    assert [line.frame for line in open_run(out).metrics] == TRACKED


def test_scores_are_those_of_the_tracked_frames(
    scene: Path, whole: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = score_run(whole, scene / "truth.txt")
    assert found.frames == len(TRACKED) and found.mean_iou > 0.6
    assert score_mot_files(whole / "tracks.txt", scene / "gt.txt").mota < 0.5
    assert score_mot_files(whole / "tracks.txt", scene / "gt.txt", frames=TRACKED).mota > 0.9
    assert main(["score", str(whole), "--truth", str(scene / "gt.txt")]) == 0
    said = [line.split()[:2] for line in capsys.readouterr().out.splitlines()]
    assert ["true_boxes", str(len(TRACKED))] in said and ["frames", str(len(TRACKED))] in said


def test_its_own_video_has_the_numbers_of_the_source(whole: Path, tmp_path: Path) -> None:
    recipe = Recipe.read(whole)
    assert recipe.has_video
    run = RunDirectory(tmp_path)
    for name in ("video.mkv", "run.json"):
        (tmp_path / name).write_bytes((whole / name).read_bytes())
    gone = (whole / "run.json").read_text().replace("img", "gone")
    run.recipe.write_text(gone)
    started = next(event for event in open_run(whole).events if isinstance(event, RunStarted))
    with pictures_of(run, started, 0, 10) as (found, _):
        assert found is not None and found.annotated
        assert [index for index, _ in found.images] == [0, 3, 6, 9]
