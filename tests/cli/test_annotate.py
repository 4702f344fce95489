"""The command `annotate` without its page: imports, files, resuming, and what it refuses."""

import errno
import json

import cv2
import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.journal.writer import LineFile, OutputError
from bayesnet_track.runtime.recording.lock import lock_run
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.sources.scenes import make_scene

FRAMES = 8


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """A folder of images, and the true box of its first frame as MOT."""
    folder = tmp_path_factory.mktemp("video")
    scene = make_scene("two_squares", seed=0)
    for number in range(FRAMES):
        cv2.imwrite(str(folder / f"{number}.png"), scene.frames[number])
    boxes = folder / "boxes.txt"
    boxes.write_text("1,1," + ",".join(f"{value:.2f}" for value in scene.truth[0]) + ",1\n")
    return folder, boxes


def annotate(video, out, *options):
    return main(["annotate", str(video), "--out", str(out), "--no-view", "--graph", "gray_square", *options])


def test_imported_boxes_are_tracked_from_and_written_and_resuming_changes_no_byte(video, tmp_path, capsys):
    folder, boxes = video
    options = ("--threshold", "0.01", "--format", "mot", "--format", "coco")
    assert annotate(folder, tmp_path / "a", *options, "--import", str(boxes)) == 0
    out = capsys.readouterr().out
    assert "1 target, 8 frames: 1 given, 7 tracked\n" in out and "frame 7: the last frame" in out
    names = ("answers.jsonl", "mot.txt", "coco.json")
    before = [(tmp_path / "a" / name).read_bytes() for name in names]
    assert len(before[1].splitlines()) == FRAMES
    hows = [one["attributes"]["how"] for one in json.loads(before[2])["annotations"]]
    assert hows == ["given"] + ["tracked"] * 7
    assert annotate(folder, tmp_path / "a", *options, "--import", str(boxes)) == 0
    assert [(tmp_path / "a" / name).read_bytes() for name in names] == before


def test_what_is_open_is_printed_with_its_reason(video, tmp_path, capsys):
    folder, boxes = video
    assert (
        annotate(folder, tmp_path / "a", "--threshold", "1", "--patience", "1", "--import", str(boxes)) == 0
    )
    out = capsys.readouterr().out
    assert (
        "not known yet" in out
        and "nothing to ask" not in out
        and "open: target 1, frame 1: probability of being on target" in out
    )


def test_what_does_not_fit_is_refused_without_a_trace_in_the_answers(video, tmp_path, capsys):
    folder, boxes = video
    wrong = tmp_path / "wrong.txt"
    wrong.write_text("1,1,10,10,20,20,1\n99,1,10,10,20,20,1\n")
    assert annotate(folder, tmp_path / "a", "--import", str(wrong)) == 2
    assert "wrong.txt:2: frame 98" in capsys.readouterr().err
    assert (tmp_path / "a/answers.jsonl").read_text().count("\n") == 1
    assert annotate(folder / "0.png", tmp_path / "a") == 2
    assert "frames: 1, it was 8" in capsys.readouterr().err
    assert annotate(tmp_path / "none.mp4", tmp_path / "b") == 4
    assert annotate(folder, boxes) == 6


def test_two_commands_never_write_the_same_folder(video, tmp_path, capsys):
    folder, _ = video
    with lock_run(RunDirectory(tmp_path)):
        assert annotate(folder, tmp_path) == 6
    assert "another process is writing" in capsys.readouterr().err


def test_a_disk_that_is_full_for_an_answer_is_an_output_that_cannot_be_written(
    video, tmp_path, capsys, monkeypatch
):
    folder, boxes = video
    assert annotate(folder, tmp_path / "a") == 0

    def full(self):
        raise OutputError(errno.ENOSPC, "cannot write: No space left on device", str(self.path))

    monkeypatch.setattr(LineFile, "flush", full)
    assert annotate(folder, tmp_path / "a", "--import", str(boxes)) == 6
    assert "answers.jsonl: cannot write: No space left" in capsys.readouterr().err
