"""`--range`: the same run in the range that counts, recorded and repeated byte for byte."""

import json
import warnings

import cv2
import numpy as np
import pytest

from bayesnet_track import DetectionsTracker, Tracker, track
from bayesnet_track.cli.main import main
from bayesnet_track.observation.image_files import PictureError
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.sources import open_source

LOW, HIGH = 8000, 8127
BOX = (20, 30, 24, 24)


def eight_bits(count=12):
    """Gray frames in which a textured square moves 3 px a frame."""
    rng = np.random.default_rng(1)
    back, square = rng.integers(40, 90, (90, 120)), rng.integers(150, 255, (24, 24))
    frames = []
    for number in range(count):
        frame = back.copy()
        frame[30:54, 20 + 3 * number : 44 + 3 * number] = square
        frames.append(frame.astype(np.uint8))
    return frames


def deep(frame):
    """The same in 128 counts of a thermal camera."""
    return (frame.astype(np.uint16) // 2) + LOW


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """The frames of a thermal camera, and the same brought to 8 bits by hand."""
    found = []
    for name in ("thermal", "by_hand"):
        folder = tmp_path_factory.mktemp(name)
        for number, frame in enumerate(eight_bits()):
            image = deep(frame)
            if name == "by_hand":
                image = np.rint((image - LOW) * (255 / (HIGH - LOW))).astype(np.uint8)
            assert cv2.imwrite(str(folder / f"{number}.png"), image)
        found.append(folder)
    return found


def run(source, out, *more):
    box = ",".join(map(str, BOX))
    return main(["run", "general", "--source", str(source), "--init", box, "--out", str(out), "-q", *more])


def tracks(out):
    return (out / "tracks.txt").read_bytes()


def test_a_range_gives_what_frames_of_8_bits_would_have_given(folders, tmp_path, capsys):
    thermal, by_hand = folders
    assert run(thermal, tmp_path / "a", "--range", f"{LOW},{HIGH}") == 0
    assert "levels" not in capsys.readouterr().err
    assert run(by_hand, tmp_path / "b") == 0
    assert tracks(tmp_path / "a") == tracks(tmp_path / "b")
    last = [float(value) for value in tracks(tmp_path / "a").decode().splitlines()[-1].split(",")[2:4]]
    assert last == pytest.approx((53, 30), abs=3)
    assert json.loads((tmp_path / "a" / "run.json").read_text())["origin"]["value_range"] == [LOW, HIGH]
    assert "value_range" not in (tmp_path / "b" / "run.json").read_text()


def test_without_a_range_the_lost_levels_are_said(folders, tmp_path, capsys):
    assert run(folders[0], tmp_path / "a") == 0
    assert "in 8 bits; give the range that counts: --range 80" in capsys.readouterr().err


@pytest.mark.slow
def test_what_reads_the_source_again_reads_it_in_the_same_range(folders, tmp_path, capsys):
    out = tmp_path / "a"
    assert run(folders[0], out, "--range", f"{LOW},{HIGH}", "--keep-beliefs", "--video") == 0
    assert main(["what-if", str(out), "--seed", "0", "--out", str(tmp_path / "same")]) == 0
    assert tracks(tmp_path / "same") == tracks(out)
    for command in (["smooth", str(out), "--out", str(tmp_path / "smooth")], ["report", str(out)]):
        assert main(command) == 0
    assert "levels" not in capsys.readouterr().err


def test_a_run_that_was_broken_off_is_resumed_in_the_same_range(folders, tmp_path):
    settings = {"value_range": (LOW, HIGH), "checkpoint_every": 0.001}
    for _ in track("general", str(folders[0]), BOX, out=str(tmp_path / "whole"), **settings):
        pass
    broken = track("general", str(folders[0]), BOX, out=str(tmp_path / "broken"), **settings)
    for _ in range(5):
        next(broken)
    broken.close()
    assert main(["resume", str(tmp_path / "broken"), "-q"]) == 0
    assert tracks(tmp_path / "broken") == tracks(tmp_path / "whole")


@pytest.mark.slow
def test_a_batch_has_the_range_too(folders, tmp_path):
    thermal, _ = folders
    command = ["batch", "general", "--source", str(thermal), "--init", "20,30,24,24", "--jobs", "1", "-q"]
    command += ["--out", str(tmp_path / "runs")]
    assert main([*command, "--range", f"{LOW},{HIGH}"]) == 0
    assert run(thermal, tmp_path / "a", "--range", f"{LOW},{HIGH}") == 0
    assert tracks(tmp_path / "runs" / thermal.name) == tracks(tmp_path / "a")


def test_a_session_of_annotations_remembers_its_range(folders, tmp_path, capsys):
    boxes = tmp_path / "boxes.txt"
    boxes.write_text(f"1,1,{','.join(map(str, BOX))},1\n")
    command = ["annotate", str(folders[0]), "--out", str(tmp_path / "a"), "--no-view", "--import", str(boxes)]
    assert main([*command, "--range", f"{LOW},{HIGH}"]) == 0
    before = (tmp_path / "a/coco.json").read_bytes()
    capsys.readouterr()
    assert main(command) == 0 and (tmp_path / "a/coco.json").read_bytes() == before
    assert "levels" not in capsys.readouterr().err
    assert main([*command, "--range", f"{LOW},{HIGH + 9}"]) != 0
    assert f"it was ({float(LOW)}, {float(HIGH)}) (without --range it is kept)" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["5", "9,1", "a,b", "1,2,3", "nan,1"])
def test_what_is_no_range_is_refused(folders, tmp_path, text, capsys):
    with pytest.raises(SystemExit) as caught:
        run(folders[0], tmp_path / "a", "--range", text)
    assert caught.value.code == 2 and "LOW,HIGH is needed" in capsys.readouterr().err


def test_trackers_of_frames_take_a_range(folders):
    frames = [deep(frame) for frame in eight_bits()]
    tracker = Tracker("general", value_range=(LOW, HIGH))
    tracker.init(frames[0], BOX)
    boxes = [tracker.update(frame)[1] for frame in frames[1:]]
    assert boxes[-1][:2] == pytest.approx((53, 30), abs=3)
    results = list(track("general", str(folders[0]), BOX, value_range=(LOW, HIGH)))
    assert [result.targets[0].xywh.tolist() for result in results[1:]] == [list(box) for box in boxes]
    with pytest.raises(PictureError, match="uint8 values, and a range that counts those of uint16"):
        tracker.update(eight_bits()[0])


@pytest.mark.parametrize(
    "start",
    [
        lambda frame: Tracker("general").init(frame, BOX),
        lambda frame: DetectionsTracker("kalman_detections").update(
            type("D", (), {"xyxy": [[1, 1, 9, 9]]}), frame
        ),
    ],
)
def test_trackers_say_once_that_levels_are_lost(start):
    with pytest.warns(InputNotice, match="frame 0: .* in 8 bits; .*value_range=") as caught:
        start(deep(eight_bits()[0]))
    said = [one for one in caught if "levels" in str(one.message)]
    assert len(said) == 1 and said[0].filename == __file__


def test_a_range_is_for_a_source_that_is_opened_here(folders):

    with (
        open_source(str(folders[1])) as source,
        pytest.raises(ValueError, match="value_range is for a source"),
    ):
        track("general", source, BOX, value_range=(0, 100))


def test_frames_of_8_bits_say_nothing():
    with warnings.catch_warnings(record=True) as notices:
        warnings.simplefilter("always")
        Tracker("general").init(eight_bits()[0], BOX)
    assert not notices
