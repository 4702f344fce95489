"""Detections that a run will not use are spoken of before it begins."""

import re
import warnings

import cv2
import numpy as np
import pytest

from bayesnet_track import track
from bayesnet_track.cli.main import main
from bayesnet_track.cli.options.given_detections import say_unused


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
        (range(1, 13), "0.2,0.3,0.1,0.2,1", [], "12 are smaller than min_area_px 1"),
        (range(41, 52), "20,30,20,20,1", [], "they are of the frames 40 to 50, and 0 to 11 are read"),
        (range(1, 13, 5), "20,30,20,20,1", [], "--stride 5 reads only those"),
        (range(2, 13, 5), "20,30,20,20,1", [], "--start 1 --stride 5 reads only those"),
        (range(1, 13, 5), "20,30,20,20,1", ["--stride", "5"], ""),
    ],
)
def test_a_file_that_does_not_fit_is_spoken_of(dark, tmp_path, capsys, frames, box, options, message):
    assert say_unused
    path = tmp_path / "det.txt"
    path.write_text("".join(f"{frame},-1,{box},-1,-1,-1\n" for frame in frames))
    command = ["run", "kalman_detections", "--source", str(dark), "--detections", str(path), "-q"]
    assert main([*command, "--out", str(tmp_path / "run"), *options]) == 0
    said = capsys.readouterr().err
    assert message in said and (said == "") == (message == "")


@pytest.mark.parametrize(
    ("box", "message"),
    [("20,30,20,20,0.8", None), ("220,30,20,20,1", "det.txt: 12 of 12 .* lie outside of the frames")],
)
def test_python_is_told_too(dark, tmp_path, box, message):
    path = tmp_path / "det.txt"
    path.write_text("".join(f"{frame},-1,{box},-1,-1,-1\n" for frame in range(1, 13)))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert sum(1 for _ in track("kalman_detections", str(dark), detections=path)) == 12
    assert [one.filename for one in caught] == [__file__] * (message is not None)
    assert message is None or re.search(message, str(caught[0].message))
