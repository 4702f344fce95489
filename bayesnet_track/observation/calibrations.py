"""Calibrations of cameras: the camera, or cameras, of a file.

One camera is known by a camera matrix with rotation and translation from world to camera (and distortion), by
a 3 x 4 projection, or by a homography of the ground (`calibration_entries` has their names). What could be
read in two ways is refused, with both named.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.cameras import (
    Camera,
    CameraError,
    GroundHomography,
    camera_of_projection,
    check_rotation,
)
from bayesnet_track.numerics.outlines import GroundView
from bayesnet_track.observation.calibration_entries import ENTRIES, UNITS, Entries, Intrinsics, unlikely
from bayesnet_track.observation.calibration_files import CalibrationError, numbers

MOST_BYTES = 20_000_000


FORMATS = "OpenCV XML, YAML or JSON; YAML; JSON; TOML, as of aniposelib"


_AT = re.compile(r"\((\d+)\):\s*(.*?)(?: in function .*)?\s*$", re.DOTALL)


_LINE = re.compile(r"\(at line (\d+), column (\d+)\)")


def read_tree(path: Path) -> tuple[dict[str, Any], str]:
    """Entries of a calibration file, and its text.

    Raises:
        CalibrationError: no such file, no text, too large, another format, or one with an error in it.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise CalibrationError.of(str(path), f"{path.stat().st_size} bytes", f"up to {MOST_BYTES}")
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise CalibrationError.of(str(path), str(error.strerror or error), "a calibration file") from error
    except UnicodeDecodeError as error:
        raise CalibrationError.of(str(path), "no text", FORMATS) from error
    tree = _parse(path, text)
    if not isinstance(tree, dict) or not tree:
        fault = "no entries" if not tree else f"a {type(tree).__name__} instead of named entries"
        raise CalibrationError.of(str(path), fault, FORMATS)
    return tree, text


def _parse(path: Path, text: str) -> Any:
    start = text.lstrip()[:12]
    if start.startswith(("<", "%YAML")):
        return _storage(path, text)
    if start.startswith(("{", "[")) and path.suffix.lower() != ".toml":
        try:
            content = json.loads(text, object_pairs_hook=_distinct)
        except json.JSONDecodeError as error:
            location = f"{path}:{error.lineno}:{error.colno}"
            raise CalibrationError.of(location, f"no JSON: {error.msg}", FORMATS) from error
        except (ValueError, RecursionError) as error:
            raise CalibrationError.of(str(path), f"no JSON: {error}", FORMATS) from error
        return {str(n): item for n, item in enumerate(content)} if isinstance(content, list) else content
    if path.suffix.lower() == ".toml":
        try:
            return tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            place = _LINE.search(str(error))
            location = f"{path}:{place[1]}:{place[2]}" if place else str(path)
            message = _LINE.sub("", str(error)).strip()
            raise CalibrationError.of(location, f"no TOML: {message}", FORMATS) from error
    return _yaml(path, text)


def _distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{twice!r} stands there twice")
    return entries


def _yaml(path: Path, text: str) -> Any:
    import yaml

    try:
        return yaml.safe_load(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        location = f"{path}:{mark.line + 1}:{mark.column + 1}" if mark else str(path)
        raise CalibrationError.of(location, f"no YAML: {error.problem}", FORMATS) from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise CalibrationError.of(str(path), f"no YAML: {error}", FORMATS) from error


def _storage(path: Path, text: str) -> dict[str, Any]:
    """Entries of OpenCV's XML or YAML."""
    import cv2

    try:
        storage = cv2.FileStorage(text, cv2.FileStorage_READ | cv2.FileStorage_MEMORY)
        root = storage.root()
        return {name: _node(storage.getNode(name)) for name in root.keys()}  # noqa: SIM118 (a cv2.FileNode)
    except (cv2.error, TypeError, ValueError, SystemError) as error:
        place = _AT.search(str(error))
        location = f"{path}:{place[1]}" if place else str(path)
        kind = "XML" if text.lstrip().startswith("<") else "YAML"
        message = f": {place[2]}" if place else ""
        raise CalibrationError.of(location, f"it is not OpenCV {kind}{message}", FORMATS) from error


def _node(node: Any) -> Any:
    if node.isMap():
        names = list(node.keys())
        if {"dt", "data"} <= set(names):
            matrix = node.mat()
            return np.zeros(0) if matrix is None else np.asarray(matrix, dtype=np.float64)
        return {name: _node(node.getNode(name)) for name in names}
    if node.isSeq():
        return [_node(node.at(place)) for place in range(node.size())]
    if node.isInt() or node.isReal():
        return float(node.real())
    return str(node.string()) if node.isString() else None


FAR_M = 100.0
"""A camera farther above the ground is said to be there: the file's unit may be another."""


def read_calibration(
    path: Path | str | Sequence[Path | str],
    camera: str | None = None,
    *,
    unit: str | None = None,
    above_ground: bool = True,
) -> GroundView:
    """Camera of a calibration file.

    Args:
        path: the file, or several that complete each other, such as intrinsics and extrinsics.
        camera: name of one of the file's cameras; not needed if there is one.
        unit: of the file's lengths, where it does not say so: m (default), cm or mm.
        above_ground: refuse cameras below the plane z = 0.

    Raises:
        CalibrationError: the file cannot be read, has several cameras and none is named, or its entries
            are missing, contradict each other, or could be read in two ways.
    """
    cameras = read_calibrations(path, only=camera, unit=unit, above_ground=above_ground)
    return next(iter(cameras.values()))


def read_calibrations(
    path: Path | str | Sequence[Path | str],
    *,
    only: str | None = "",
    unit: str | None = None,
    above_ground: bool = True,
) -> dict[str, GroundView]:
    """Every camera of a file by its name; with `only` the one of that name; None if there is but one.

    Raises:
        CalibrationError: as for `read_calibration`.
    """
    if unit is not None and unit not in UNITS:
        raise CalibrationError(f"unit {unit!r}; allowed: {', '.join(UNITS)}")
    entries = Entries.chosen(_read_all(path), only)
    return {name: _view(camera_entries, unit, above_ground) for name, camera_entries in entries.items()}


def read_intrinsics(path: Path | str, camera: str | None = None) -> Intrinsics:
    """Camera matrix and distortion of a calibration file; where the camera stands is not needed.

    Raises:
        CalibrationError: as for `read_calibration`.
    """
    entries = next(iter(Entries.chosen(_read_all(path), camera).values()))
    if "projection" in entries.values and "matrix" not in entries.values and "fx" not in entries.values:
        view = _view(entries, None, False)
        assert isinstance(view, Camera)
        return Intrinsics(view.matrix, view.distortion, view.size)
    return entries.intrinsics()


def _read_all(path: Path | str | Sequence[Path | str]) -> dict[str, Entries]:
    """Cameras of one file, or of several that each have a part of one."""
    paths = [Path(path)] if isinstance(path, Path | str) else [Path(part) for part in path]
    if len(paths) == 1:
        return dict(Entries.all_of(paths[0], *read_tree(paths[0])))
    merged: dict[str, Any] = {}
    texts = []
    for part in paths:
        tree, text = read_tree(part)
        twice = merged.keys() & tree.keys()
        if twice:
            raise CalibrationError.of(str(part), f"{', '.join(sorted(twice))} again, as in {paths[0]}")
        merged |= tree
        texts.append(text)
    joined = Path(", ".join(map(str, paths)))
    return dict(Entries.all_of(joined, merged, ""))


def _view(entries: Entries, unit: str | None, above_ground: bool) -> GroundView:
    """The camera of its entries, in metres."""
    values = entries.values
    if "pose" in values:
        raise entries.wrong(
            "pose",
            "may go from world to camera or from camera to world",
            "world_to_camera or camera_to_world",
        )
    if entries.unknown:
        unlikely(f"{entries.where()}: not used: {', '.join(entries.unknown)}")
    scale = entries.unit(unit)
    try:
        view = _choose(entries, scale)
    except CameraError as error:
        meaning = next(
            (m for m in ("rotation", "distortion", "matrix") if m in str(error) and m in values), ""
        )
        raise CalibrationError.of(entries.where(meaning), str(error)) from error
    if isinstance(view, Camera):
        _check_place(entries, view, above_ground)
    return view


def _choose(entries: Entries, scale: float) -> GroundView:
    values = entries.values
    ways = {
        "projection": "projection" in values and not _rectified(entries),
        "homography": bool({"homography", "ground_to_image", "image_to_ground"} & values.keys()),
        "pose": bool({"rotation", "translation", "world_to_camera", "camera_to_world"} & values.keys()),
    }
    if ways["projection"] and not ways["homography"]:
        projection = entries.array("projection", (3, 4))
        assert projection is not None
        metres = projection * np.array([1, 1, 1, scale])
        view = camera_of_projection(metres, entries.size())
        if ways["pose"] and "matrix" in values:
            _agree(entries, view, _posed(entries, scale))
        return view
    if ways["pose"] and not ways["homography"]:
        return _posed(entries, scale)
    if ways["homography"] and not (ways["pose"] or ways["projection"]):
        return _homography(entries, scale)
    if ways["homography"]:
        raise CalibrationError.of(
            entries.where("homography"), "a homography, and a pose or projection beside it", "one of them"
        )
    raise CalibrationError.of(
        entries.where(),
        "it says not where the camera stands",
        ENTRIES,
        "`bayesnet-track calibrate ground` finds it from points of the ground",
    )


def _rectified(entries: Entries) -> bool:
    """True if the projection is ROS's: intrinsics of a rectified image, in camera coordinates."""
    projection = numbers(entries.values["projection"][1])
    is_centred = projection is not None and projection.size == 12 and not projection.reshape(3, 4)[:, 3].any()
    return bool(is_centred and "matrix" in entries.values)


def _agree(entries: Entries, first: Camera, second: Camera) -> None:
    points = first.centre + (np.array([[0, 0, 5], [1, 1, 6], [-1, 0.5, 7.0]]) @ first.rotation)
    distance = np.abs(
        first.project(points)
        - Camera(second.matrix, np.zeros(0), second.rotation, second.translation).project(points)
    ).max()
    if not distance < 1.0:
        raise entries.wrong(
            "projection", f"and the matrix with its pose differ by {distance:.3g} px", "both the same, or one"
        )


def _posed(entries: Entries, scale: float) -> Camera:
    intrinsics = entries.intrinsics()
    poses = [m for m in ("rotation", "world_to_camera", "camera_to_world") if m in entries.values]
    if len(poses) > 1:
        names = " and ".join(entries.values[m][0] for m in poses)
        raise CalibrationError.of(entries.where(poses[0]), f"{names} both give the pose", "one of them")
    if poses in ([], ["rotation"]):
        for meaning, shape in (("rotation", "3 x 3 or a rotation vector of 3"), ("translation", "3 numbers")):
            if meaning not in entries.values:
                raise CalibrationError.of(entries.where(), f"no {meaning}", f"{meaning}: {shape}")
        rotation, shift = _rotation(entries), entries.array("translation", (3,))
        assert shift is not None
    else:
        pose = entries.array(poses[0], (3, 4), (4, 4))
        assert pose is not None
        rotation, shift = pose[:3, :3], pose[:3, 3]
        if poses == ["camera_to_world"]:
            check_rotation(rotation)
            rotation, shift = rotation.T, -rotation.T @ shift
    return Camera(
        intrinsics.matrix, intrinsics.distortion, rotation, shift * scale, intrinsics.size, intrinsics.fisheye
    )


def _rotation(entries: Entries) -> Floats:
    import cv2

    rotation = entries.array("rotation", (3, 3), (3,))
    assert rotation is not None
    return rotation if rotation.shape == (3, 3) else np.asarray(cv2.Rodrigues(rotation)[0], dtype=np.float64)


def _homography(entries: Entries, scale: float) -> GroundHomography:
    if "homography" in entries.values:
        raise entries.wrong(
            "homography",
            "may map the ground to the image or the image to the ground",
            "the name ground_to_image or image_to_ground",
        )
    directions = [m for m in ("ground_to_image", "image_to_ground") if m in entries.values]
    if len(directions) > 1:
        raise entries.wrong(
            directions[0], f"and {entries.values[directions[1]][0]} are both there", "one of them"
        )
    homography = entries.array(directions[0], (3, 3))
    assert homography is not None
    matrix = homography
    if directions[0] == "image_to_ground":
        if abs(np.linalg.det(matrix)) == 0:
            raise entries.wrong("image_to_ground", "cannot be inverted", "an invertible 3 x 3 matrix")
        matrix = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    focal = entries.array("focal", (), (1,))
    view = GroundHomography(
        matrix @ np.diag([1, 1, scale]), entries.size(), None if focal is None else float(focal.item())
    )
    if "distortion" in entries.values and entries.distortion().any():
        unlikely(
            f"{entries.where('distortion')}: not used with a homography; give a camera matrix and a pose"
        )
    return view


def _check_place(entries: Entries, view: Camera, above_ground: bool) -> None:
    """Refuse a camera below the ground; say that one is unlikely far away."""
    z = view.centre[2]
    pose = next((m for m in ("translation", "world_to_camera", "camera_to_world") if m in entries.values), "")
    if above_ground and z <= 0:
        mend = "z must point up; use a world frame on the ground, or `bayesnet-track calibrate ground`"
        if view.translation[2] > 0 and pose == "translation":
            mend = (
                "if rotation and translation go from camera to world, name them camera_to_world (3 x 4); "
                "otherwise " + mend
            )
        raise CalibrationError.of(
            entries.where(pose), f"the camera stands {-z:.3g} m below the ground, the plane z = 0", "", mend
        )
    if z > FAR_M:
        unlikely(
            f"{entries.where(pose)}: the camera stands {z:.4g} m above the ground; if the file's unit is cm "
            "or "
            "mm, say so by unit"
        )
