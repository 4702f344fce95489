"""The command `detect`."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.sources.scenes import make_scene


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Six frames of two orange squares, as images."""
    path = tmp_path_factory.mktemp("frames")
    for index, image in zip(range(6), make_scene("two_squares", 0).frames, strict=False):
        cv2.imwrite(str(path / f"{index:03}.png"), image)
    return str(path)


def test_mot_lines_are_printed(folder, capsys):
    assert main(["detect", "gray_level", "--source", folder, "--start", "2", "--end", "4"]) == 0
    out, err = capsys.readouterr()
    lines = [line.split(",") for line in out.splitlines()]
    assert [line[0] for line in lines] == ["3", "3", "4", "4"] and "4 detections in 2 frames" in err
    assert all(line[1] == "-1" and line[7:] == ["-1"] * 3 and len(line) == 10 for line in lines)
    truth = make_scene("two_squares", 0).truth[2]
    near = min(abs(float(line[2]) - truth[0]) + abs(float(line[3]) - truth[1]) for line in lines[:2])
    assert near < 3.0 and all(0 < float(line[6]) <= 1 for line in lines)


def test_json_lines_and_a_video_are_written(folder, tmp_path):
    out, video = tmp_path / "found.jsonl", tmp_path / "found.mkv"
    arguments = ["detect", "motion", "--source", folder, "--out", str(out), "--save-video", str(video)]
    assert main(arguments) == 0
    rows = [json.loads(line) for line in out.read_text().splitlines()]
    assert [row["frame"] for row in rows] == list(range(6)) and rows[0]["detections"] == []
    assert set(rows[2]["detections"][0]) == {"box", "score", "label"} and video.stat().st_size > 1000
    before = out.read_bytes()
    assert main(arguments) == 6 and out.read_bytes() == before
    assert main([*arguments, "--overwrite"]) == 0 and out.read_bytes() == before


def test_smaller_frames_give_boxes_in_pixels_of_the_source(folder, capsys):
    arguments = ["detect", "color_backprojection", "--source", folder, "--end", "1", "--set", "min_chroma=40"]
    box = [round(v) for v in make_scene("two_squares", 0).truth[0]]
    arguments += ["--learn", ",".join(map(str, box))]
    found = []
    for more in ([], ["--max-side", "160"]):
        assert main([*arguments, *more]) == 0
        lines = sorted(line.split(",")[2:6] for line in capsys.readouterr().out.splitlines())
        found.append(np.array(lines, dtype=float))
    assert np.abs(found[0] - found[1]).max() <= 4.0
    assert np.abs(found[1] - box).sum(axis=1).min() <= 10.0


def test_a_target_is_shown(folder, capsys):
    x, y, w, h = (round(v) for v in make_scene("two_squares", 0).truth[0])
    shown = ["--learn", f"{x},{y},{w},{h}", "--set", "min_chroma=40"]
    assert main(["detect", "color_backprojection", "--source", folder, *shown]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 12  # both squares are of this colour


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["backgruond"], 2, "no detector is called 'backgruond'; there are background, color"),
        (["motion", "--set", "min_sped_px=2"], 2, "did you mean min_speed_px?"),
        (["motion", "--set", "min_speed_px=fast"], 2, "min_speed_px: Input should be a valid number"),
        (["motion", "--set", "max_count"], 2, "--set 'max_count': key=value is needed"),
        (["motion", "--set", "max_count=[", "--set", "x=1"], 2, "--set max_count: '[' is no value"),
        (["motion", "--set", "max_count=1", "--set", "max_count=2"], 2, "--set max_count is given twice"),
        (["gray_level", "--set", "split=bands"], 2, "`split: bands` and a list of bands belong together"),
        (["contour_shape"], 2, "model: Field required (Shape model file"),
        (["contour_shape", "--set", "model=none.npz"], 2, "none.npz is not there"),
        (["onnx", "--set", "model=none.onnx"], 2, "none.onnx: no such model file"),
        (["color_backprojection"], 2, "has nothing to look for: give --learn X,Y,W,H"),
        (["color_backprojection", "--learn", "1,2,3"], 2, "four numbers X,Y,W,H are needed"),
        (["color_backprojection", "--learn", "2,2,9,9"], 2, "nothing inside the box has a hue"),
        (["motion", "--learn", "2,2,9,9"], 2, "--learn: motion cannot be shown a target"),
        (["motion", "--start", "4", "--end", "4"], 2, "--end 4 must be greater than --start 4"),
        (["motion", "--calibration", "c.yml"], 2, "--calibration is of a pair"),
        (["stereo_blobs"], 4, "stereo_blobs needs depth, and the source is one eye"),
        (["motion", "--start", "40"], 4, "no frame can be read from frame 40 on"),
        (["motion", "--out", "/no/folder/x.txt"], 6, "/no/folder/x.txt: cannot write"),
    ],
)
def test_mistakes_are_told_with_their_exit_code(folder, capsys, arguments, code, said):
    assert main(["detect", *arguments, "--source", folder]) == code
    out, err = capsys.readouterr()
    assert said in err and "Traceback" not in err and out == ""


def test_a_gray_source_is_refused_by_a_detector_of_colour(tmp_path, capsys):
    cv2.imwrite(str(tmp_path / "0.png"), make_scene("two_squares", 0).frames[0][:, :, 1])
    arguments = ["detect", "color_backprojection", "--set", "hue_deg=30", "--source", str(tmp_path)]
    assert main(arguments) == 4
    assert "needs colour, and the source is gray" in capsys.readouterr().err


def test_detectors_are_listed(capsys):
    assert main(["list"]) == 0
    assert "background" in capsys.readouterr().out.split("detectors:")[1]


@pytest.fixture(scope="module")
def walkers(tmp_path_factory):
    """Twenty frames of 256 x 128 px: two bright squares of 16 px walk past each other."""
    path = tmp_path_factory.mktemp("walkers")
    for index in range(20):
        image = np.zeros((128, 256, 3), np.uint8)
        image[24:40, 20 + 4 * index :][:, :16] = (255, 240, 250)
        image[84:100, 200 - 4 * index :][:, :16] = (245, 255, 250)
        cv2.imwrite(str(path / f"{index:03}.png"), image)
    return path


def test_people_are_found_by_a_network_and_followed(walkers, network, tmp_path, capsys):
    onnx = network(after=(0.25,), size=128, stride=2, turned=True)  # as YOLO v8 exports, two classes
    settings = {"model": onnx, "input_width": 128, "input_height": 128, "min_score": 0.9}
    changes = [f"--set=birth.detector.onnx.{key}={value}" for key, value in settings.items()]
    command = ["run", "people", "--source", str(walkers), "--out", str(tmp_path / "run"), "--quiet"]
    assert main([*command, *changes]) == 0, capsys.readouterr().err
    lines = [line.split(",") for line in (tmp_path / "run" / "tracks.txt").read_text().splitlines()]
    assert {line[1] for line in lines} == {"1", "2"} and len(lines) > 30
    for line in lines:
        index, (left, top, width, height) = int(line[0]) - 1, map(float, line[2:6])
        across = 20 + 4 * index if top < 60 else 200 - 4 * index
        assert abs(left - across) < 5 and abs(width - 16) < 2 and abs(height - 16) < 2


def test_people_without_a_network_say_how_to_give_one(walkers, network, tmp_path, capsys):
    command = ["run", "people", "--source", str(walkers), "--out", str(tmp_path / "run")]
    assert main(command) == 2
    assert "people.onnx: no such model file" in capsys.readouterr().err
    cut = tmp_path / "cut.onnx"
    cut.write_bytes(Path(network()).read_bytes()[:300])
    assert main([*command, "--set", f"birth.detector.onnx.model={cut}"]) == 2
    said = capsys.readouterr().err
    assert "cut.onnx: OpenCV cannot read it as an ONNX model" in said and "Traceback" not in said
    assert not (tmp_path / "run").exists()
