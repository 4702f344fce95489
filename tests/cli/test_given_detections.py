"""Detections that a run will not use are spoken of before it begins."""

import re
import warnings
from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from bayesnet_track import track
from bayesnet_track.cli.main import main
from bayesnet_track.observation.planes import Frame


@pytest.fixture(scope="module")
def dark(tmp_path_factory):
    """Twelve black images."""
    folder = tmp_path_factory.mktemp("dark")
    for index in range(12):
        cv2.imwrite(str(folder / f"{index:03}.png"), np.zeros((90, 120, 3), np.uint8))
    return folder


@pytest.mark.parametrize(
    ("frames", "box", "options", "message"),
    [
        (range(1, 13), "20,30,20,20,0.8", [], ""),
        (
            range(1, 13),
            "20,30,20,20,0.1",
            [],
            ": 12 of 12 detections are not used: 12 score less than min_score",
        ),
        (range(1, 13), "220,30,20,20,1", [], "12 lie outside of the frames of 120x90 px"),
        (range(41, 52), "20,30,20,20,1", [], "they are of the frames 40 to 50, and 0 to 11 are read"),
        (range(1, 13, 5), "20,30,20,20,1", [], "--stride 5 reads only those"),
        (range(2, 13, 5), "20,30,20,20,1", [], "--start 1 --stride 5 reads only those"),
        (range(1, 13, 5), "20,30,20,20,1", ["--stride", "5"], ""),
        (
            range(1, 25),
            "20,30,20,20,1",
            [],
            "12 of 24 detections are of frames after the last one that is read (12 ",
        ),
        (
            range(1, 13),
            "20,30,20,20,1",
            ["--start", "4"],
            "4 of 12 detections are of frames before the first one",
        ),
        (
            range(1, 13),
            "20,30,20,20,1",
            ["--stride", "4"],
            "9 of 12 detections are of frames which a stride of 4 ",
        ),
        (
            range(1, 13),
            "70,50,140,40,1",
            [],
            "12 of 12 detections begin inside of the frames of 120x90 px and",
        ),
        (range(1, 13), "50,40,110,85,1", [], "they can be corners left,top,right,bottom, which a header"),
    ],
)
def test_a_file_that_does_not_fit_is_spoken_of(dark, tmp_path, capsys, frames, box, options, message):
    path = tmp_path / "det.txt"
    path.write_text("".join(f"{frame},-1,{box},-1,-1,-1\n" for frame in frames))
    command = ["run", "kalman_detections", "--source", str(dark), "--detections", str(path), "-q"]
    assert main([*command, "--out", str(tmp_path / "run"), *options]) == 0
    said = capsys.readouterr().err
    assert message in said and (said == "") == (message == "")


@pytest.mark.parametrize(
    ("box", "frames", "message"),
    [
        ("20,30,20,20,0.8", 12, None),
        ("220,30,20,20,1", 12, "det.txt: 12 of 12 .* lie outside of the frames"),
        ("20,30,20,20,0.8", 20, r"8 of 20 .* after the last one that is read \(12 to 19; 0 to 11 are read"),
        ("20,30,20,20,0.8", 2, r"no detection is of the last 10 frames \(2 to 11; 0 to 11 are read"),
    ],
)
def test_python_is_told_too(dark, tmp_path, box, frames, message):
    path = tmp_path / "det.txt"
    path.write_text("".join(f"{frame},-1,{box},-1,-1,-1\n" for frame in range(1, frames + 1)))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert sum(1 for _ in track("kalman_detections", str(dark), detections=path)) == 12
    assert [one.filename for one in caught] == [__file__] * (message is not None)
    assert message is None or re.search(message, str(caught[0].message))


@dataclass
class Unknown:
    """A source that does not say how many frames it has."""

    frames: int
    description = "unknown"
    frame_interval_s = 0.04
    width, height = 120, 90
    expected_frames = None
    end_reason = "end_of_source"

    def __iter__(self):
        for index in range(self.frames):
            yield Frame(index, float(index), np.zeros((90, 120, 3), np.uint8), True, 0.04 * index)


@pytest.mark.parametrize(("frames", "count"), [(5, 7), (12, 0), (20, 0)])
def test_of_a_source_of_unknown_length_it_is_said_at_its_end(tmp_path, frames, count):
    path = tmp_path / "det.txt"
    path.write_text("".join(f"{frame},-1,20,30,20,20,1,-1,-1,-1\n" for frame in range(1, 13)))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert sum(1 for _ in track("kalman_detections", Unknown(frames), detections=path)) == frames
    assert [str(one.message) for one in caught] == [
        f"{path}: 7 of 12 detections are of frames after the last one that is read (5 to 11; 0 to 4 are "
        "read, counted from 0): is the file of this video, and of its frame rate?"
    ] * (count > 0)
    assert [one.filename for one in caught] == [__file__] * (count > 0)
