"""The command `annotate` without its page: imports, files, resuming, and what it refuses."""

import errno
import json
import shutil
import time
from pathlib import Path

import cv2
import pytest

from bayesnet_track import Tracker
from bayesnet_track.cli.main import main
from bayesnet_track.journal.writer import LineFile, OutputError
from bayesnet_track.runtime.annotation.desk import AnnotationServer
from bayesnet_track.runtime.recording.manifest import lock_run
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
    wrong.write_text("1,1,10,10,20,20,1\n99,1,10,10,20\n")
    assert annotate(folder, tmp_path / "a", "--import", str(wrong)) == 2
    assert "wrong.txt:2" in capsys.readouterr().err
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


BAD_BOXES = {
    "0.5,20": "width and height must be at least 1 px",
    "20,2401": "at most 10 times the 320x240 frame is allowed",
}


@pytest.mark.slow
@pytest.mark.parametrize("size", BAD_BOXES)
def test_a_target_that_cannot_be_tracked_stops_no_other_and_is_named_until_it_is_corrected(
    video, tmp_path, capsys, size
):
    folder, boxes = video
    mot = tmp_path / "boxes.txt"
    good = boxes.read_text()
    mot.write_text(f"1,2,150,100,20,20,1\n4,2,150,100,{size},1\n{good}")
    options = ("--threshold", "0.01", "--format", "coco")
    assert annotate(folder, tmp_path / "a", *options, "--import", str(mot)) == 5
    said = f"open: target 2, frame 3: not tracked: start box 150,100,{size}: {BAD_BOXES[size]}"
    assert said in capsys.readouterr().out
    content = json.loads((tmp_path / "a/coco.json").read_text())
    names = {one["id"]: one["name"] for one in content["tracks"]}
    hows = [(names[one["track_id"]], one["attributes"]["how"]) for one in content["annotations"]]
    assert hows.count(("target 1", "tracked")) == 7 and hows.count(("target 2", "given")) == 2
    # It stays in the session, the answers as they were: whoever corrects it has all of them.
    assert annotate(folder, tmp_path / "a", *options) == 5
    capsys.readouterr()
    with (tmp_path / "a/answers.jsonl").open("a") as file:
        file.write(json.dumps({"kind": "box", "frame": 3, "target": "target 2", "box": [150, 100, 20, 20]}))
    assert annotate(folder, tmp_path / "a", *options) == 0
    assert "2 targets, 8 frames: 3 given, 13 tracked\n" in capsys.readouterr().out


def test_a_box_too_small_for_the_frames_that_are_tracked_in_is_named(video, tmp_path, capsys):
    folder, boxes = video
    mot = tmp_path / "boxes.txt"
    mot.write_text("1,2,150,100,8,8,1\n" + boxes.read_text())
    assert annotate(folder, tmp_path / "a", "--max-side", "32", "--import", str(mot)) == 5
    out = capsys.readouterr().out
    assert "open: target 2, frame 0: not tracked" in out and "0.8x0.8 px" in out


def test_a_box_with_which_nothing_can_be_computed_stops_no_other_target_and_no_file(video, tmp_path, capsys):
    folder, boxes = video
    everything = [
        word for name in ("coco", "cvat", "mot", "yolo", "label-studio") for word in ("--format", name)
    ]
    assert annotate(folder, tmp_path / "a", "--threshold", "0.01", "--import", str(boxes)) == 0
    with (tmp_path / "a/answers.jsonl").open("a") as file:
        line = {"kind": "box", "frame": 2, "target": "far", "box": [-1e308, 10, 1.5e308, 1e308]}
        file.write(json.dumps(line) + "\n")
    assert annotate(folder, tmp_path / "a", *everything) == 5
    assert "open: far, frame 2: not tracked: start box -1e+308,10,1.5e+308" in capsys.readouterr().out
    assert len((tmp_path / "a/mot.txt").read_text().splitlines()) == FRAMES


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")  # its thread is left
def test_answers_that_are_not_tracked_when_the_page_is_left_are_no_success(
    video, tmp_path, capsys, monkeypatch
):
    folder, boxes = video
    update = Tracker.update

    def slow(self, frame):
        time.sleep(0.3)
        return update(self, frame)

    monkeypatch.setattr(Tracker, "update", slow)
    monkeypatch.setattr(AnnotationServer, "wait", lambda self, give_up: None)  # as Ctrl-C at once
    command = ["annotate", str(folder), "--out", str(tmp_path / "a"), "--graph", "gray_square"]
    assert main([*command, "--import", str(boxes)]) == 5
    assert "the last answers are not tracked yet" in capsys.readouterr().err
    monkeypatch.setattr(Tracker, "update", update)
    assert main([*command, "--no-view", "--threshold", "0.01"]) == 0


def test_a_failure_of_the_tracker_concerns_one_target(video, tmp_path, capsys, monkeypatch):
    folder, boxes = video
    mot = tmp_path / "boxes.txt"
    mot.write_text("1,2,150,100,21,20,1\n" + boxes.read_text())
    init = Tracker.init

    def fail(self, frame, box):
        init(self, frame, box)
        if box[2] == 21:
            monkeypatch.setattr(self, "update", lambda frame: 1 / 0, raising=False)

    monkeypatch.setattr(Tracker, "init", fail)
    assert annotate(folder, tmp_path / "a", "--threshold", "0.01", "--import", str(mot)) == 5
    out = capsys.readouterr().out
    assert "open: target 2, frame 1: not tracked: ZeroDivisionError" in out
    assert "2 given, 7 tracked" in out


def test_a_damaged_source_is_annotated_as_far_as_it_goes_and_is_no_success(video, tmp_path, capsys):
    folder, boxes = video
    copy = tmp_path / "video"
    shutil.copytree(folder, copy, ignore=shutil.ignore_patterns("*.txt"))
    (copy / "5.png").write_bytes((copy / "5.png").read_bytes()[:200])
    assert annotate(copy, tmp_path / "a", "--import", str(boxes)) == 5
    err = capsys.readouterr().err
    assert "source damaged after 7 frames" in err
    assert "frames cannot be read and are left out: 5; those behind them are counted without them" in err


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


FIXTURES = Path(__file__).parents[1] / "fixtures" / "annotations"


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """The frames of `tests/fixtures/annotations`: 12 images from clip_01.png on, 160 x 120 px."""
    folder = tmp_path_factory.mktemp("clip")
    scene = make_scene("two_squares", seed=0)
    for number in range(12):
        cv2.imwrite(str(folder / f"clip_{number + 1:02d}.png"), scene.frames[number][:120, :160])
    return folder


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("cvat_coco_rotated", "3 of 6 boxes are the upright box around a rotated box"),
        ("ultralytics_track_conf", ""),
        ("cvat_video", "16 boxes between key frames are left to the tracker"),
    ],
)
def test_files_of_other_tools_are_imported_with_notices_and_images_keep_their_names(
    clip, name, said, tmp_path, capsys
):
    options = (
        "--threshold",
        "0.01",
        "--import",
        str(FIXTURES / name),
        "--format",
        "coco",
        "--format",
        "yolo",
    )
    assert annotate(clip, tmp_path / "a", *options) == 0
    out, err = capsys.readouterr()
    assert "2 targets, 12 frames: 6 given" in out
    assert said in err
    content = json.loads((tmp_path / "a/coco.json").read_text())
    assert [one["file_name"] for one in content["images"]] == [f"clip_{n:02d}.png" for n in range(1, 13)]
    given = [one for one in content["annotations"] if one["attributes"]["how"] == "given"]
    assert [one["image_id"] for one in given] == [1, 6, 11] * 2
    labels = sorted(file.name for file in (tmp_path / "a/yolo/labels").iterdir())
    assert labels == [f"clip_{n:02d}.txt" for n in range(1, 13)]


def test_an_import_that_is_refused_says_where_and_why(clip, tmp_path, capsys):
    content = json.loads((FIXTURES / "cvat_coco/annotations/instances_default.json").read_text())
    del content["annotations"][2]["attributes"]["track_id"]
    (tmp_path / "a.json").write_text(json.dumps(content))
    assert annotate(clip, tmp_path / "a", "--import", str(tmp_path / "a.json")) == 2
    assert (
        "a.json, annotations[2] (id 3): the key 'attributes.track_id' is missing" in capsys.readouterr().err
    )
