"""Entries of a calibration file: which cameras it has, and what each entry means.

Names of entries are those that programs use, in any spelling of case and separators: `K`, `camera_matrix`,
`matrix`, `intrinsics`; `D`, `dist`, `distortion_coefficients`; `R`, `rvec`, `rotation`; `t`, `tvec`,
`translation`; `P`, `projection_3x4`; `world_to_camera` or `camera_to_world` (3 x 4 or 4 x 4);
`ground_to_image` or `image_to_ground`.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.calibration_files import CalibrationError, numbers
from bayesnet_track.observation.settings import CalibrationNotice, callers_depth

UNITS: Mapping[str, float] = MappingProxyType(
    {"m": 1.0, "metres": 1.0, "meters": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "ft": 0.3048}
)
"""Unit of lengths in a file -> m."""

_NAMES = {
    "matrix": "k cameramatrix intrinsic intrinsics intrinsicmatrix kmatrix mtx matrix",
    "distortion": "d dist distortion distortions distcoeff distcoeffs distcoefs distortioncoefficients "
    "distortioncoeffs",
    "rotation": "r rotation rotationmatrix rmat rvec rotationvector",
    "translation": "t translation translationvector tvec",
    "projection": "p projection projectionmatrix projection3x4 cameraprojection",
    "world_to_camera": "worldtocamera extrinsic extrinsics extrinsicmatrix rt w2c",
    "camera_to_world": "cameratoworld c2w",
    "ground_to_image": "groundtoimage worldtoimage imagefromground imagefromworld",
    "image_to_ground": "imagetoground imagetoworld groundfromimage worldfromimage",
    "homography": "h homography homographymatrix",
    "pose": "pose transform transformation",
    "size": "size imagesize image resolution imageresolution",
    "width": "imagewidth width framewidth",
    "height": "imageheight height frameheight",
    "fx": "fx",
    "fy": "fy",
    "cx": "cx",
    "cy": "cy",
    "focal": "focalpx",
    "unit": "unit units lengthunit",
    "fisheye": "fisheye",
    "model": "distortionmodel model",
    "name": "name cameraname",
    "pair": "m1 m2 d1 d2 baselinem",
}
_MEANINGS = {alias: meaning for meaning, aliases in _NAMES.items() for alias in aliases.split()}
_GIVES_CAMERA = frozenset(_NAMES) - {"unit", "size", "width", "height", "name", "model", "fisheye", "pair"}
_COMMENTS = re.compile(
    r"comments?|notes?|fps|rms\w*|errors?|\w*reprojection\w*|calibrationtime|date|time|n\w*frames?|board\w*|"
    r"square\w*|flag\w*|metadata|centre|center|rectificationmatrix|medianpx|framesused|points"
)
ENTRIES = (
    "a camera matrix with rotation and translation from world to camera, a 3 x 4 projection, or a homography "
    "(ground_to_image or image_to_ground)"
)


@dataclass(frozen=True)
class Intrinsics:
    """A camera without its place.

    Attributes:
        matrix: (3, 3) camera matrix, px.
        distortion: (k,) coefficients in OpenCV's order.
        size: width and height of its images, px, if known.
        fisheye: the distortion is that of `cv2.fisheye`.
    """

    matrix: Floats
    distortion: Floats
    size: tuple[int, int] | None
    fisheye: bool = False


@dataclass(frozen=True)
class Entries:
    """Entries of one camera.

    Attributes:
        path, text: the file's.
        name: the camera's.
        values: meaning -> values, with the keys under which they stand.
        unknown: keys of which nothing is known.
    """

    path: Path
    text: str
    name: str
    values: Mapping[str, tuple[str, Any]]
    unknown: tuple[str, ...]

    @classmethod
    def chosen(cls, cameras: dict[str, Entries], name: str | None) -> dict[str, Entries]:
        """The camera of a name; all for an empty one; the only one for None."""
        if name == "":
            return cameras
        path = next(iter(cameras.values())).path
        if name is None:
            if len(cameras) > 1:
                raise CalibrationError.of(
                    str(path), f"{len(cameras)} cameras", f"the name of one: {', '.join(cameras)}"
                )
            return cameras
        if name not in cameras:
            raise CalibrationError.of(str(path), f"no camera {name!r}", f"one of {', '.join(cameras)}")
        return {name: cameras[name]}

    @classmethod
    def all_of(cls, path: Path, tree: dict[str, Any], text: str) -> Iterator[tuple[str, Entries]]:
        """Cameras of a file: one in its own entries, or those in nested ones, which share the outer ones."""
        cameras: dict[str, dict[str, Any]] = {}
        if any(_meaning(key) in _GIVES_CAMERA and _by_name(value) is None for key, value in tree.items()):
            cameras[""] = tree
        shared = {
            k: v for k, v in tree.items() if _meaning(k) in ("unit", "size", "width", "height", "model")
        }
        if not cameras:
            for key, value in tree.items():
                stack = _by_name(value) if _meaning(key) in _GIVES_CAMERA else None
                if stack:  # projection_3x4: {1: …, 2: …}
                    for name, part in stack.items():
                        cameras.setdefault(str(name), dict(shared))[key] = part
            inner = chain.from_iterable(
                (value if isinstance(value, Mapping) else dict(enumerate(value))).items()
                for key, value in [("", tree), *tree.items()]
                if isinstance(value, Mapping | list) and (key == "" or not cameras)
            )
            for key, value in inner:
                if isinstance(value, Mapping) and any(_meaning(str(k)) in _GIVES_CAMERA for k in value):
                    name = str(value.get("name", key))
                    if name in cameras and not set(cameras[name]) <= set(shared):
                        raise CalibrationError.of(str(path), f"two cameras are named {name!r}")
                    cameras[name] = {**shared, **value}
        if not cameras and any(_meaning(key) == "pair" for key in tree):
            raise CalibrationError.of(str(path), "calibration of a stereo pair, which has no ground", ENTRIES)
        if not cameras:
            keys = ", ".join(map(str, list(tree)[:12]))
            raise CalibrationError.of(str(path), f"no camera among the entries {keys}", ENTRIES)
        for name, entries in cameras.items():
            yield name, cls._of(path, text, name, entries)

    @classmethod
    def _of(cls, path: Path, text: str, name: str, entries: Mapping[str, Any]) -> Entries:
        values: dict[str, tuple[str, Any]] = {}
        unknown = []
        for key, value in entries.items():
            meaning = _meaning(key)
            if meaning is None:
                if not _COMMENTS.fullmatch(_plain(key)):
                    unknown.append(str(key))
            elif meaning in values:
                location = f"{path}{f', camera {name}' if name else ''}"
                raise CalibrationError.of(
                    location,
                    f"{values[meaning][0]} and {key} both give the {meaning.replace('_', ' ')}",
                    "one",
                )
            else:
                values[meaning] = (str(key), value)
        return cls(path, text, name, values, tuple(unknown))

    def where(self, meaning: str = "") -> str:
        """File, line and camera of an entry."""
        key = self.values[meaning][0] if meaning in self.values else ""
        line = line_of(self.text, key) if key else None
        return f"{self.path}{f':{line}' if line else ''}{f', camera {self.name}' if self.name else ''}"

    def wrong(self, meaning: str, fault: str, remedy: str = "", mend: str = "") -> CalibrationError:
        """An error at an entry, which names its key."""
        key = self.values[meaning][0] if meaning in self.values else meaning
        return CalibrationError.of(self.where(meaning), f"{key} {fault}", remedy, mend)

    def array(self, meaning: str, *shapes: tuple[int, ...]) -> Floats | None:
        """An entry as an array of one of the shapes, None where there is none."""
        if meaning not in self.values:
            return None
        array = numbers(self.values[meaning][1])
        expected = " or ".join(" x ".join(map(str, shape)) for shape in shapes)
        if array is None:
            raise self.wrong(meaning, "is no matrix", f"numbers, {expected}")
        if not np.isfinite(array).all():
            raise self.wrong(meaning, "has a number that is not finite", f"finite numbers, {expected}")
        squeezed = array.reshape(-1) if 1 in array.shape else array
        for shape in shapes:
            if squeezed.shape == shape or (len(shape) == 2 and squeezed.shape == (shape[0] * shape[1],)):
                return squeezed.reshape(shape)
        raise self.wrong(meaning, f"is {' x '.join(map(str, array.shape)) or 'one number'}", expected)

    def size(self) -> tuple[int, int] | None:
        """Width and height of the images, px."""
        entry: Any = None
        if "size" in self.values:
            entry = self.values["size"][1]
            if isinstance(entry, Mapping):
                sides = {_meaning(str(key)): value for key, value in entry.items()}
                entry = [sides.get("width"), sides.get("height")]
        elif {"width", "height"} <= self.values.keys():
            entry = [self.values["width"][1], self.values["height"][1]]
        if entry is None:
            return None
        array = numbers(entry)
        if array is None or array.size != 2 or not (array >= 1).all() or (array % 1).any():
            raise self.wrong(
                "size" if "size" in self.values else "width", "is no size", "width, height in px"
            )
        return int(array.flat[0]), int(array.flat[1])

    def unit(self, requested: str | None) -> float:
        """Metres of the file's unit."""
        if "unit" not in self.values:
            return UNITS[requested or "m"]
        unit = str(self.values["unit"][1]).strip().lower()
        if unit not in UNITS:
            raise self.wrong("unit", f"is {unit!r}", ", ".join(UNITS))
        if requested is not None and UNITS[requested] != UNITS[unit]:
            raise self.wrong("unit", f"is {unit!r}, but unit {requested!r} is given", "one of both")
        return UNITS[unit]

    def intrinsics(self) -> Intrinsics:
        """Camera matrix and distortion."""
        matrix, size = self._matrix(), self.size()
        if size and not (0 < matrix[0, 2] < size[0] and 0 < matrix[1, 2] < size[1]):
            unlikely(
                f"{self.where('matrix')}: the principal point {matrix[0, 2]:g}, {matrix[1, 2]:g} is outside "
                f"an image of {size[0]}x{size[1]}: width and height may be exchanged, or the size another"
            )
        return Intrinsics(matrix, self.distortion(), size, self._fisheye())

    def _matrix(self) -> Floats:
        """(3, 3) camera matrix, of itself or of its four numbers."""
        matrix = self.array("matrix", (3, 3), (4,))
        if matrix is not None and matrix.shape == (3, 3):
            return matrix
        if matrix is not None:
            fx, fy, cx, cy = matrix
        else:
            parts = {name: self.array(name, (), (1,)) for name in ("fx", "fy", "cx", "cy")}
            missing = [name for name, value in parts.items() if value is None]
            if missing:
                fault = "no camera matrix" if len(missing) == 4 else f"no {', '.join(missing)}"
                raise CalibrationError.of(self.where(), fault, "a camera matrix, or fx, fy, cx and cy")
            fx, fy, cx, cy = (float(value.item()) for value in parts.values() if value is not None)
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])

    def _fisheye(self) -> bool:
        model = _plain(str(self.values["model"][1])) if "model" in self.values else ""
        pinhole_models = (
            "",
            "plumbbob",
            "brown",
            "opencv",
            "pinhole",
            "rationalpolynomial",
            "radtan",
            "perspective",
        )
        if model not in (*pinhole_models, "fisheye", "equidistant", "kannalabrandt", "opencvfisheye"):
            raise self.wrong("model", f"is {model!r}", "plumb_bob, rational_polynomial or fisheye")
        return model not in pinhole_models or ("fisheye" in self.values and bool(self.values["fisheye"][1]))

    def distortion(self) -> Floats:
        """Coefficients in the file's order; none if it has none."""
        if "distortion" not in self.values:
            return np.zeros(0)
        array = numbers(self.values["distortion"][1])
        if array is None:
            raise self.wrong("distortion", "is no list of numbers", "4, 5, 8 or 12 coefficients")
        return array.reshape(-1)


def _plain(key: object) -> str:
    return re.sub(r"[^a-z0-9]", "", str(key).lower())


def _meaning(key: object) -> str | None:
    return _MEANINGS.get(_plain(key))


def _by_name(value: Any) -> dict[str, Any] | None:
    """Matrices by the names of cameras, or in a list of several; None for the matrix of one."""
    if isinstance(value, Mapping):
        single = "data" in value
        return None if single else {str(key): part for key, part in value.items()}
    array = numbers(value) if isinstance(value, list) else None
    return {str(n): part for n, part in enumerate(value)} if array is not None and array.ndim == 3 else None


def unlikely(text: str) -> None:
    """Warn, at the line outside of this package, of what a calibration has and is not used or unlikely."""
    warnings.warn(text, CalibrationNotice, stacklevel=callers_depth())


def line_of(text: str, key: str) -> int | None:
    """Line of a key that stands once in a text, from 1; None where it stands more often.

    >>> line_of("a: 1\\nrotation: 2\\n", "rotation")
    2
    """
    word = re.compile(rf"(?<![\w.-]){re.escape(key)}(?![\w.-])")
    lines = [n for n, line in enumerate(text.splitlines(), 1) if word.search(line)]
    closing = [n for n in lines if f"</{key}" in text.splitlines()[n - 1]]
    lines = [n for n in lines if n not in closing] or lines
    return lines[0] if len(lines) == 1 else None
