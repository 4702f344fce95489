"""`cameras` and `demo street`: the ground over a frame, and metres against a known ground truth."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.numerics.cameras import Camera
from bayesnet_track.observation.calibrations import read_calibration
from bayesnet_track.sources.scenes.library import make_scene

GRAPH = Path("graphs") / "street.yaml"


@pytest.fixture
def frame(tmp_path: Path) -> Path:
    path = tmp_path / "frame.png"
    cv2.imwrite(str(path), np.full((360, 640, 3), 128, np.uint8))
    return path


def green(path: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """(H, W) pixels of the grid's colour."""
    image = np.asarray(cv2.imread(str(path))).astype(int)
    return np.asarray(image[..., 1] - image[..., [0, 2]].max(axis=2) > 20)


def test_the_grid_lies_where_the_camera_sees_whole_metres(
    frame: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = Path(__file__).parents[2]
    out = frame.with_name("out.png")
    assert main(["cameras", str(root / GRAPH), "--source", str(frame), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "6.00 m above the ground" in said
    assert "a line every 5 m" in said
    camera = read_calibration(root / "graphs" / "street.json")
    on = camera.project(np.array([[12.5, 10.0, 0], [17.0, 10.0, 0], [20.0, 12.0, 0]])).round().astype(int)
    off = camera.project(np.array([[12.5, 7.5, 0], [17.5, 12.5, 0]])).round().astype(int)
    drawn = green(out)
    assert all(drawn[y - 1 : y + 2, x - 1 : x + 2].any() for x, y in on)
    assert not any(drawn[y - 1 : y + 2, x - 1 : x + 2].any() for x, y in off)
    assert not drawn[:60].any()  # above the horizon


def test_points_that_are_off_are_said(frame: Path, capsys: pytest.CaptureFixture[str]) -> None:
    calibration = Path(__file__).parents[2] / "graphs" / "street.json"
    camera = read_calibration(calibration)
    pixels = camera.project(np.array([[10.0, 8.0, 0], [20.0, 10.0, 0], [15.0, 15.0, 0]])) + [
        [3, 4],
        [0, 0],
        [0, 0],
    ]
    rows = [
        f"{px},{py},{x},{y}" for (px, py), (x, y) in zip(pixels, [(10, 8), (20, 10), (15, 15)], strict=True)
    ]
    points = frame.with_name("p.csv")
    points.write_text("\n".join(["px,py,x,y", *rows]))
    command = ["cameras", str(calibration), "--source", str(frame), "--points", str(points), "--out"]
    assert main([*command, str(frame.with_name("a.png"))]) == 0
    captured = capsys.readouterr()
    assert "3 points: rms 2.89 px, worst 5.00 px" in captured.out
    assert main([*command, str(frame.with_name("a.png"))]) == 6  # not over a file that is there


def test_frames_of_another_size_and_unknown_cameras_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration = Path(__file__).parents[2] / "graphs" / "street.json"
    cv2.imwrite(str(tmp_path / "b.png"), np.zeros((100, 100, 3), np.uint8))
    command = ["cameras", str(calibration), "--source", f"{tmp_path}/b.png", "--out", f"{tmp_path}/o.png"]
    assert main(command) == 2
    assert "frames of 100x100" in capsys.readouterr().err
    assert main([*command, "--camera", "west"]) == 2
    assert "--camera west" in capsys.readouterr().err


def test_the_calibration_of_the_street_is_that_of_its_scene() -> None:
    ground = make_scene("street").ground
    assert ground is not None
    camera = read_calibration(Path(__file__).parents[2] / "graphs" / "street.json")
    assert isinstance(camera, Camera)
    assert np.abs(camera.centre - ground.camera.centre).max() < 1e-9
    assert np.abs(camera.boxes(ground.paths[0]) - ground.camera.boxes(ground.paths[0])).max() < 1e-6
    assert "street" in load_graph("street").spec.cameras


@pytest.mark.slow
def test_the_street_is_tracked_in_metres(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "street", "--out", f"{tmp_path}/street"]) == 0
    figures = {
        words[0]: words[1] for line in capsys.readouterr().out.splitlines() if len(words := line.split()) > 1
    }
    assert float(figures["mota"]) > 0.88
    assert int(figures["idsw"]) == 0
    assert float(figures["error_m"]) < 0.25
    assert 0.85 < float(figures["coverage"]) <= 1
    truth = f"{tmp_path}/street_inputs/truth.csv"
    assert main(["score", f"{tmp_path}/street", "--truth", truth]) == 0
    assert f"mota{'':9}{figures['mota']:>9}".split() == [
        word
        for line in capsys.readouterr().out.splitlines()
        if line.startswith("mota ")
        for word in line.split()[:2]
    ]
