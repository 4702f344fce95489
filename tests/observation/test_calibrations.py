"""Calibration files: every format gives the same camera, and what is no camera is refused where it stands."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track.numerics.cameras import Camera, GroundHomography
from bayesnet_track.observation.calibration_files import CalibrationError
from bayesnet_track.observation.calibrations import read_calibration, read_calibrations, read_intrinsics
from bayesnet_track.observation.settings import CalibrationNotice

K = np.array([[800.0, 0, 640], [0, 810, 360], [0, 0, 1]])
DISTORTION = np.array([-0.2, 0.05, 0.001, -0.002, 0.0])
RVEC = np.array([2.0, 0.1, -0.1])
ROTATION = np.asarray(cv2.Rodrigues(RVEC)[0])
TRANSLATION = -ROTATION @ np.array([1.0, -8.0, 4.0])
SIZE = (1280, 720)
LISTS = {"K": K.tolist(), "D": DISTORTION.tolist(), "R": ROTATION.tolist(), "t": TRANSLATION.tolist()}
EXPECTED = Camera(K, DISTORTION, ROTATION, TRANSLATION, SIZE)


def storage(path: Path, entries: dict[str, object]) -> None:
    file = cv2.FileStorage(str(path), cv2.FileStorage_WRITE)
    for name, value in entries.items():
        file.write(name, value)
    file.release()


def opencv(path: Path) -> None:
    storage(
        path,
        {
            "image_width": 1280,
            "image_height": 720,
            "camera_matrix": K,
            "distortion_coefficients": DISTORTION,
            "rvec": RVEC,
            "tvec": TRANSLATION,
        },
    )


def aniposelib(path: Path) -> None:
    path.write_text(
        f'[cam_0]\nname = "north"\nsize = [ 1280, 720,]\nmatrix = {K.tolist()}\ndistortions = '
        f"{DISTORTION.tolist()}\nrotation = {RVEC.tolist()}\ntranslation = "
        f"{TRANSLATION.tolist()}\n\n[metadata]\n"
    )


def ros(path: Path) -> None:
    rows = {
        "camera_matrix": {"rows": 3, "cols": 3, "data": K.ravel().tolist()},
        "projection_matrix": {
            "rows": 3,
            "cols": 4,
            "data": np.column_stack([K, np.zeros(3)]).ravel().tolist(),
        },
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": DISTORTION.tolist()},
    }
    text = "".join(f"{name}: {json.dumps(value)}\n" for name, value in rows.items())
    path.write_text(
        f"image_width: 1280\nimage_height: 720\ndistortion_model: plumb_bob\n{text}"
        f"world_to_camera: {np.column_stack([ROTATION, TRANSLATION]).tolist()}\n"
    )


def one_json(path: Path) -> None:
    path.write_text(json.dumps({**LISTS, "image_size": [1280, 720]}))


def many_json(path: Path) -> None:
    camera = {**LISTS, "resolution": {"width": 1280, "height": 720}, "comment": "of the roof"}
    path.write_text(json.dumps({"unit": "m", "cameras": {"north": camera, "south": camera}}))


def inverse_json(path: Path) -> None:
    pose = np.eye(4)
    pose[:3] = np.column_stack([ROTATION.T, -ROTATION.T @ TRANSLATION])
    entries = {"fx": 800, "fy": 810, "cx": 640, "cy": 360, "dist": LISTS["D"], "width": 1280, "height": 720}
    path.write_text(json.dumps({**entries, "camera_to_world": pose.tolist()}))


def millimetres(path: Path) -> None:
    path.write_text(
        json.dumps({**LISTS, "t": (1000 * TRANSLATION).tolist(), "unit": "mm", "image_size": [1280, 720]})
    )


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("a.xml", opencv),
        ("a.yml", opencv),
        ("a.json", opencv),
        ("a.toml", aniposelib),
        ("ros.yaml", ros),
        ("one.json", one_json),
        ("many.json", many_json),
        ("inverse.json", inverse_json),
        ("mm.json", millimetres),
    ],
)
def test_every_format_gives_the_same_camera(tmp_path: Path, name: str, write: Callable[[Path], None]) -> None:
    write(tmp_path / name)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        camera = read_calibration(tmp_path / name, "north" if write is many_json else None)
    assert isinstance(camera, Camera)
    assert camera.size == SIZE
    points = np.array([[0.0, 0, 0], [2, 1, 1], [-1, 4, 1.8]])
    assert np.abs(camera.project(points) - EXPECTED.project(points)).max() < 1e-6
    assert read_intrinsics(tmp_path / name, "north" if write is many_json else None).size == SIZE


def test_projections_are_read_by_name_and_unit(tmp_path: Path) -> None:
    projection = K @ np.column_stack([ROTATION, TRANSLATION])
    millimetre = projection @ np.diag([1e-3, 1e-3, 1e-3, 1])
    (tmp_path / "a.json").write_text(
        json.dumps(
            {
                "image": SIZE,
                "unit": "mm",
                "projection_3x4": {"1": (-millimetre).tolist(), "2": projection.tolist()},
            }
        )
    )
    cameras = read_calibrations(tmp_path / "a.json")
    assert list(cameras) == ["1", "2"]
    points = np.array([[0.0, 0, 0], [2, 1, 1]])
    expected = Camera(K, np.zeros(0), ROTATION, TRANSLATION).project(points)
    assert np.abs(cameras["1"].project(points) - expected).max() < 1e-6


def test_homographies_say_their_direction(tmp_path: Path) -> None:
    matrix = K @ np.column_stack([ROTATION[:, :2], TRANSLATION])
    expected = Camera(K, np.zeros(0), ROTATION, TRANSLATION).project(np.array([[1.0, 2, 0]]))
    for entries in (
        {"ground_to_image": matrix.tolist()},
        {"image_to_ground": np.linalg.inv(matrix).tolist()},
    ):
        (tmp_path / "h.json").write_text(json.dumps(entries))
        camera = read_calibration(tmp_path / "h.json")
        assert isinstance(camera, GroundHomography)
        assert np.abs(camera.project(np.array([[1.0, 2, 0]])) - expected).max() < 1e-6


def test_intrinsics_and_extrinsics_may_be_two_files(tmp_path: Path) -> None:
    storage(tmp_path / "intr.xml", {"camera_matrix": K, "distortion_coefficients": DISTORTION})
    (tmp_path / "extr.xml").write_text(
        "<?xml version='1.0'?>\n<opencv_storage>\n<rvec>\n"
        + " ".join(map(repr, RVEC.tolist()))
        + "</rvec>\n<tvec>\n"
        + " ".join(repr(100 * v) for v in TRANSLATION.tolist())
        + "</tvec>\n</opencv_storage>\n"
    )
    parts = [tmp_path / "intr.xml", tmp_path / "extr.xml"]
    with pytest.warns(CalibrationNotice, match="400 m above the ground"):
        read_calibration(parts)
    camera = read_calibration(parts, unit="cm")
    assert isinstance(camera, Camera)
    assert np.abs(camera.translation - TRANSLATION).max() < 1e-9
    with pytest.raises(CalibrationError, match=r"intr\.xml: it says not where the camera stands.*calibrate"):
        read_calibration(parts[0])
    with pytest.raises(CalibrationError, match="again, as in"):
        read_calibration([parts[0], parts[0]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"R": np.diag([1.0, 1.0, -1.0]).tolist()}, r"c.json:4: the rotation is a reflection"),
        ({"R": (2 * ROTATION).tolist()}, r"c.json:4: the rotation is not orthonormal"),
        ({"R": [[1, 0], [0, 1]]}, r"c.json:4: R is 2 x 2; allowed: 3 x 3 or 3"),
        ({"K": "wide"}, r"c.json:2: K is no matrix"),
        (
            {"K": [[800, 0, 640], [0, float("nan"), 360], [0, 0, 1]]},
            r"c.json:2: K has a number that is not finite",
        ),
        ({"D": [0.1, 0.2]}, r"c.json:3: 2 distortion coefficients; allowed"),
        ({"t": (ROTATION @ [1.0, -8, 4]).tolist()}, r"c.json:5: the camera stands 4 m below the ground"),
        ({"t": None}, "t is no matrix"),
        ({"rvec": [0, 0, 0]}, "R and rvec both give the rotation"),
        ({"unit": "parsec"}, r"unit is 'parsec'; allowed: m, "),
        ({"image_size": [1280]}, "image_size is no size"),
        ({"world_to_camera": np.eye(4).tolist()}, "both give the pose"),
        ({"ground_to_image": np.eye(3).tolist()}, "one of them"),
        ({"projection": np.column_stack([K, [1, 2, 3]]).tolist()}, "differ by"),
        ({"pose": np.eye(4).tolist()}, "world_to_camera or camera_to_world"),
        ({"distortion_model": "division"}, "distortion_model is 'division'"),
    ],
)
def test_entries_of_no_camera_are_refused(tmp_path: Path, change: dict[str, object], message: str) -> None:
    lines = [f'"{key}": {json.dumps(value)}' for key, value in {**LISTS, **change}.items()]
    (tmp_path / "c.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")
    with pytest.raises(CalibrationError, match=message):
        read_calibration(tmp_path / "c.json")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.json", '{"K": [1,\n 2}', r"a.json:2:3: no JSON"),
        ("a.json", '{"K": 1, "K": 2}', "'K' stands there twice"),
        ("a.toml", "[cam_0]\nmatrix = [1,, 2]\n", r"a.toml:2:13: no TOML"),
        ("a.yaml", "K: [1, 2\nD: 3\n", r"a.yaml:2:\d+: no YAML"),
        (
            "a.xml",
            "<?xml version='1.0'?>\n<opencv_storage>\n<K>1 2</J>\n</opencv_storage>\n",
            "no.* OpenCV XML",
        ),
        ("a.yaml", "M1: 1\nD1: 2\n", "stereo pair"),
        ("a.yaml", "- 1\n- 2\n", "instead of named entries"),
        ("a.yaml", "", "no entries"),
        (
            "a.json",
            '{"H": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}',
            "ground to the image or the image to the ground",
        ),
        ("a.json", '{"where": 3}', "no camera among the entries where"),
    ],
)
def test_files_of_no_calibration_are_refused(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(CalibrationError, match=message):
        read_calibration(tmp_path / name)


def test_a_missing_file_and_a_missing_camera_are_named(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"none.json: No such file"):
        read_calibration(tmp_path / "none.json")
    many_json(tmp_path / "a.json")
    with pytest.raises(CalibrationError, match="2 cameras; allowed: the name of one: north, south"):
        read_calibration(tmp_path / "a.json")
    with pytest.raises(CalibrationError, match=re.escape("no camera 'west'; allowed: one of north, south")):
        read_calibration(tmp_path / "a.json", "west")


def test_what_is_not_used_is_said_at_the_callers_line(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps({**LISTS, "zoom": 3, "image_size": [720, 1280]}))
    with pytest.warns(CalibrationNotice) as heard:
        read_calibration(tmp_path / "a.json")
    texts = [str(item.message) for item in heard]
    assert any("not used: zoom" in text for text in texts)
    assert len(texts) == 1
    (tmp_path / "a.json").write_text(json.dumps({**LISTS, "image_size": [480, 360]}))
    with pytest.warns(CalibrationNotice, match="width and height may be exchanged") as heard:
        read_calibration(tmp_path / "a.json")
    assert heard[0].filename == __file__


def test_cameras_are_equal_by_value(tmp_path: Path) -> None:
    one_json(tmp_path / "a.json")
    assert read_calibration(tmp_path / "a.json") == read_calibration(tmp_path / "a.json")
    assert read_calibration(tmp_path / "a.json") != Camera(K, DISTORTION, ROTATION, TRANSLATION + 1, SIZE)
