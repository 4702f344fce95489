"""`calibrate camera`, `ground` and `poses`: rendered boards and points give back the cameras that saw "
"them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.numerics.arrays import Floats, Image
from bayesnet_track.numerics.cameras import Camera
from bayesnet_track.observation.calibrations import read_calibration, read_calibrations, read_intrinsics

SIZE = (640, 480)
K = np.array([[620.0, 0, 325], [0, 615, 235], [0, 0, 1]])
BOARD, SQUARE = (9, 6), 0.04


def looking(centre: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> Camera:
    z = np.subtract(at, centre) / np.linalg.norm(np.subtract(at, centre))
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    rotation = np.array([x, np.cross(z, x), z])
    return Camera(K, np.zeros(0), rotation, -rotation @ np.array(centre), SIZE)


def board_image(camera: Camera) -> Image:
    """The board on the ground, its middle at the origin, by a homography of its texture."""
    cell, (across, down) = 40, BOARD
    squares = (np.indices((down + 1, across + 1)).sum(axis=0) % 2 * 255).astype(np.uint8)
    texture = cv2.copyMakeBorder(
        np.kron(squares, np.ones((cell, cell), np.uint8)),
        cell,
        cell,
        cell,
        cell,
        cv2.BORDER_CONSTANT,
        value=255,
    )
    metres = SQUARE / cell
    height, width = texture.shape
    to_ground = np.array([[metres, 0, -width * metres / 2], [0, -metres, height * metres / 2], [0, 0, 1]])
    plane = camera.matrix @ np.column_stack([camera.rotation[:, :2], camera.translation])
    image = cv2.warpPerspective(texture, plane @ to_ground, SIZE, flags=cv2.INTER_AREA, borderValue=200)
    return np.asarray(cv2.cvtColor(cv2.GaussianBlur(image, (3, 3), 0.7), cv2.COLOR_GRAY2BGR), dtype=np.uint8)


def write_points(path: Path, camera: Camera, ground: Floats) -> None:
    pixels = camera.project(np.column_stack([ground, np.zeros(len(ground))]))
    rows = ["x,y,px,py"] + [
        f"{x},{y},{px:.2f},{py:.2f}" for (x, y), (px, py) in zip(ground, pixels, strict=True)
    ]
    path.write_text("\n".join(rows) + "\n")


GROUND = np.array([[-2.0, -1.0], [2.0, -1.2], [2.2, 3.0], [-1.8, 3.1], [0.3, 1.0], [1.0, 0.0]])


def test_a_lens_is_found_from_views_of_a_board(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    views = [(0.5, -0.5, 0.6), (-0.5, -0.5, 0.5), (0.4, 0.4, 0.7), (-0.5, 0.3, 0.6), (0.03, -0.7, 0.5)]
    views += [(0.3, -0.1, 0.7), (0.1, 0.02, 0.8), (-0.2, -0.3, 0.8)]
    for n, view in enumerate(views):
        cv2.imwrite(
            str(tmp_path / f"{n}.png"), board_image(looking(view, (0.02 * n - 0.07, 0.01 * n - 0.04, 0)))
        )
    out = tmp_path / "lens.yaml"
    assert main(f"calibrate camera {tmp_path}/*.png --board 9x6 --square 0.04 --out {out}".split()) == 0
    assert f"of {len(views)} frames" in capsys.readouterr().out
    lens = read_intrinsics(out)
    assert lens.size == SIZE
    assert np.abs(lens.matrix - K).max() < 12
    for wrong in ("8x5", "10x7"):
        command = f"calibrate camera {tmp_path}/*.png --board {wrong} --square 0.04 --out {tmp_path}/b.yaml"
        assert main(command.split()) == 2
        message = capsys.readouterr().err
        assert "is whole in 0 views" in message
        assert "is it --board 9x6?" in message


def test_the_place_of_a_camera_is_found_from_points(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = looking((1.0, -6.0, 3.0))
    image, points, lens, out = (tmp_path / name for name in ("a.png", "p.csv", "lens.json", "cam.yaml"))
    cv2.imwrite(str(image), np.zeros((480, 640, 3), np.uint8))
    write_points(points, camera, GROUND)
    lens.write_text(json.dumps({"K": K.tolist(), "image_size": SIZE}))
    command = f"calibrate ground {image} --points {points} --out {out}"
    assert main(f"{command} --intrinsics {lens}".split()) == 0
    assert "the camera stands at x 1.00, y -6.00 m, 3.00 m above the ground" in capsys.readouterr().out
    found = read_calibration(out)
    assert isinstance(found, Camera)
    assert np.abs(found.centre - camera.centre).max() < 0.02
    assert main(f"{command} --overwrite".split()) == 0
    plain = read_calibration(out)
    people = np.array([[0.0, 0.0, 0.6, 1.8], [1.0, 2.0, 0.6, 1.7]])
    assert np.abs(plain.boxes(people) - camera.boxes(people)).max() < 4  # the principal point is a guess


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p[:3], "3 points; at least 4 are needed"),
        (lambda p: p[:, [0, 1, 2, 3]] * [1, 1, 1, -1], "mirrored"),
        (lambda p: np.column_stack([p[:, :2], p[:, 2], 0.001 * p[:, 3]]), "almost in one line on the ground"),
        (lambda p: p + [700, 0, 0, 0], "point 1 at"),
        (lambda p: p * [0.7, 0, 1, 1] + [0, 630, 0, 0], "all would be in one that lies on its side"),
        (
            lambda p: np.vstack([p[[4]], p[[4]] + np.outer([1, 2, 3], [9, 7, 0.3, 0.2]), p[:1]]),
            "all but number 5",
        ),
    ],
)
def test_points_that_do_not_determine_a_place_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: object, message: str
) -> None:
    camera = looking((1.0, -6.0, 3.0))
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((480, 640, 3), np.uint8))
    pixels = camera.project(np.column_stack([GROUND, np.zeros(len(GROUND))]))
    rows = change(np.column_stack([pixels, GROUND]))  # type: ignore[operator]
    given = " ".join(f"--point {a},{b}={x},{y}" for a, b, x, y in rows)
    assert main(f"calibrate ground {tmp_path}/a.png {given} --out {tmp_path}/c.yaml".split()) == 2
    assert message.replace("all but number", "all points but number") in capsys.readouterr().err
    assert not (tmp_path / "c.yaml").exists()


def test_a_wrong_line_of_the_points_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((480, 640, 3), np.uint8))
    for text, message in (
        ("px,py,x,y\n1,2,3,4\n1,2,three,4\n", "p.csv:3: '1,2,three,4'; allowed: four numbers"),
        ("u,v,x,y\n1,2,3,4\n", "p.csv:1: 'u,v,x,y'; allowed: a header line px,py,x,y"),
    ):
        (tmp_path / "p.csv").write_text(text)
        command = f"calibrate ground {tmp_path}/a.png --points {tmp_path}/p.csv --out {tmp_path}/c.yaml"
        assert main(command.split()) == 2
        assert message in capsys.readouterr().err


def test_a_point_with_a_wrong_sign_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    camera = looking((1.0, -6.0, 3.0))
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((480, 640, 3), np.uint8))
    pixels = camera.project(np.column_stack([GROUND, np.zeros(len(GROUND))]))
    wrong = GROUND.copy()
    wrong[4, 0] = 1.3
    given = " ".join(f"--point {a},{b}={x},{y}" for (a, b), (x, y) in zip(pixels, wrong, strict=True))
    assert main(f"calibrate ground {tmp_path}/a.png {given} --out {tmp_path}/c.yaml".split()) == 0
    assert "point 5 is" in capsys.readouterr().err


ORDERS = {
    "exchanged": ([0, 1, 3, 2], "the pixels of 3, 4 the metres of 4, 3"),
    "shifted": ([3, 0, 1, 2], "the pixels of 1, 2, 3, 4 the metres of 2, 3, 4, 1"),
    "two of six": ([0, 4, 2, 3, 1, 5], "the pixels of 2, 5 the metres of 5, 2"),
    "six from the second": (
        [1, 2, 3, 4, 5, 0],
        "the pixels of 1, 2, 3, 4, 5, 6 the metres of 6, 1, 2, 3, 4, 5",
    ),
}


@pytest.mark.parametrize("name", ORDERS)
def test_points_in_another_order_are_refused_with_the_right_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    order, message = ORDERS[name]
    count = len(order)
    image, points, lens = (tmp_path / name for name in ("a.png", "p.csv", "lens.json"))
    cv2.imwrite(str(image), np.zeros((480, 640, 3), np.uint8))
    lens.write_text(json.dumps({"K": K.tolist(), "image_size": SIZE}))
    camera = looking((1.0, -6.0, 3.0))
    pixels = camera.project(np.column_stack([GROUND, np.zeros(len(GROUND))]))[:count]
    rows = np.column_stack([pixels, GROUND[order]])
    points.write_text("px,py,x,y\n" + "\n".join(",".join(f"{v:.2f}" for v in row) for row in rows))
    command = f"calibrate ground {image} --points {points} --intrinsics {lens} --out {tmp_path}/c.yaml"
    assert main(command.split()) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "c.yaml").exists()


@pytest.mark.parametrize(("other", "message"), [("cm", "are x and y in metres"), ("lens", "do not fit: rms")])
def test_points_of_another_unit_or_lens_are_complained_about(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], other: str, message: str
) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((480, 640, 3), np.uint8))
    write_points(tmp_path / "p.csv", looking((1.0, -6.0, 3.0)), GROUND[:4])
    matrix = K * [[1.4], [1.4], [1]] if other == "lens" else K
    if other == "cm":
        header, *lines = (tmp_path / "p.csv").read_text().split()
        rows = [[100 * float(x), 100 * float(y), px, py] for x, y, px, py in (r.split(",") for r in lines)]
        (tmp_path / "p.csv").write_text("\n".join([header] + [",".join(map(str, row)) for row in rows]))
    (tmp_path / "lens.json").write_text(json.dumps({"K": matrix.tolist(), "image_size": SIZE}))
    command = f"calibrate ground {tmp_path}/a.png --points {tmp_path}/p.csv --out {tmp_path}/c.yaml"
    assert main(f"{command} --intrinsics {tmp_path}/lens.json".split()) == 0
    assert message in capsys.readouterr().err


def test_cameras_agree_on_the_board_that_they_see(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = {
        "north": looking((0.3, 0.5, 0.5)),
        "south": looking((-0.2, -0.6, 0.4)),
        "east": looking((0.6, 0.1, 0.5)),
    }
    given = []
    for name, camera in truth.items():
        cv2.imwrite(str(tmp_path / f"{name}.png"), board_image(camera))
        (tmp_path / f"{name}.json").write_text(json.dumps({"K": K.tolist(), "image_size": SIZE}))
        given += [
            "--source",
            f"{name}={tmp_path}/{name}.png",
            "--intrinsics",
            f"{name}={tmp_path}/{name}.json",
        ]
    out = tmp_path / "rig.json"
    assert main(["calibrate", "poses", *given, "--board", "9x6", "--square", "0.04", "--out", str(out)]) == 0
    cameras = read_calibrations(out)
    for one in truth:
        for other in truth:
            first, second = cameras[one], cameras[other]
            assert isinstance(first, Camera)
            assert isinstance(second, Camera)
            apart = np.linalg.norm(first.centre - second.centre)
            assert abs(apart - np.linalg.norm(truth[one].centre - truth[other].centre)) < 0.01
    assert (
        main(["calibrate", "poses", *given, "--board", "9x7", "--square", "0.04", "--out", f"{out}2.json"])
        == 2
    )
    assert "looks the same when it is turned around" in capsys.readouterr().err
