"""YOLO: a folder with a file of labels for each frame, as boxes, polygons or keypoints."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.runtime.annotation.answers import Answer, Box
from bayesnet_track.runtime.annotation.formats.reading import (
    LISTS,
    Document,
    MismatchError,
    box_around,
    label_files,
    label_of,
    pairs,
    text_of_file,
    whole_value,
)
from bayesnet_track.runtime.annotation.formats.rows import Row, answers_of, frames_of_names
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.paths import IMAGE_SUFFIXES

BEYOND = 1.5
"""Parts of the frame beyond which numbers must be px."""
SLACK = 0.02
"""Parts of the frame by which a box in it may reach out."""
MOST_IN_FRAME = 0.9
_WHOLE = re.compile(r"[+-]?\d{1,30}$", re.ASCII)


@dataclass(frozen=True)
class Line:
    """A line: where it stands, its class, and the words and numbers behind the class."""

    place: str
    kind: int
    words: tuple[str, ...]
    values: tuple[float, ...]


@dataclass(frozen=True)
class Drawn:
    """A shape of a line: `values` in parts of the frame, and the identity that the line ends with."""

    line: Line
    values: tuple[float, ...]
    shape: str
    identity: int | None

    def box(self, video: Video) -> Box:
        """The upright box in px."""
        if self.shape:
            left, top, w, h = box_around(pairs(self.values))
        else:
            cx, cy, w, h = self.values
            left, top = cx - w / 2, cy - h / 2
        return left * video.width, top * video.height, w * video.width, h * video.height


def parse_line(text: str, place: str, path: str) -> Line:
    """A line's class and numbers; raises MismatchError."""
    kind, *words = text.split()
    try:
        values = tuple(float(word) for word in words)
        index = float(kind)
        if not index.is_integer() or abs(index) > 10**6 or len(values) < 4:
            raise ValueError
    except (ValueError, OverflowError) as error:
        raise MismatchError(
            f"{path}, {place}: {text.strip()[:80]!r}; `class cx cy w h`, `class cx cy w h id` or a polygon "
            "`class x y x y x y ...` is needed, separated by spaces"
        ) from error
    return Line(place, int(index), tuple(words), values)


def boxes_of_lines(lines: Sequence[Line], keypoints: object, path: Path) -> list[Drawn]:
    """Boxes that the lines draw; lines of as many numbers are read alike.

    `keypoints` is YOLO's `kpt_shape`, how many points of how many numbers stand behind each box, or None.

    Raises:
        MismatchError: lines have no reading, or two.
    """
    readings: dict[int, Callable[[Line], Drawn]] = {}
    points = _points(keypoints, path)
    for count in sorted({len(line.values) for line in lines}, reverse=True):
        equally_long = [line for line in lines if len(line.values) == count]
        readings[count] = _reading(equally_long, count, points, any(n >= 8 for n in readings), path)
    boxes = [readings[len(line.values)](line) for line in lines]
    for box in boxes:
        if any(math.isfinite(value) and abs(value) > BEYOND for value in box.values):
            raise MismatchError(
                f"{path}, {box.line.place}: {' '.join(box.line.words)[:80]!r}; parts of the frame "
                "are needed, from 0 to 1"
            )
    return boxes


def _points(keypoints: object, path: Path) -> int:
    """The count of numbers of the keypoints of a line."""
    if keypoints is None:
        return 0
    match keypoints:
        case [int(points), int(size)] if points > 0 and size in (2, 3):
            return points * size
    raise MismatchError(f"{path}: kpt_shape in its YAML: [points, 2] or [points, 3] is needed")


def _reading(
    lines: Sequence[Line], count: int, points: int, longer: bool, path: Path
) -> Callable[[Line], Drawn]:
    """Read lines of `count` numbers: a shape, then perhaps a confidence, then an identity."""
    if count == 4 or (points and count == 4 + points):
        return lambda line: _box(line, None)
    ends_whole = all(_WHOLE.match(line.words[-1]) for line in lines)
    if points and count == 6 + points and ends_whole:
        return lambda line: _box(line, _identity(line))
    if count == 5 and not ends_whole:
        return _with_confidence(lines, path, None)
    if count == 5 or (points and count == 5 + points):
        return _with_last(lines, ends_whole, path, _box)
    if count % 2:
        if (count - 4) % 3 == 0 and all(set(line.values[6::3]) <= {0, 1, 2} for line in lines):
            raise MismatchError(
                f"{path}, {lines[0].place}: {count + 1} columns fit two readings: a box with keypoints `x y "
                "visible`, and a polygon with an identity; data.yaml says by `kpt_shape` which it is"
            )
        return _with_last(lines, ends_whole, path, _polygon)
    if ends_whole and _are_shares(line.values[-2] for line in lines):
        if (count >= 8 or longer) and all(line.values[-1] in (0, 1) for line in lines):
            ended = "a box" if count == 6 else f"a polygon of {count // 2 - 1} points"
            raise MismatchError(
                f"{path}, {lines[0].place}: {count + 1} columns fit two readings: a polygon of {count // 2} "
                f"points, and {ended} with a confidence and the identity {lines[0].words[-1]}; write the "
                "coordinates with a decimal point, or leave the confidence out"
            )
        if count == 6:
            return _with_confidence(lines, path, _identity)
        return lambda line: _polygon(line, _identity(line), 2)
    return lambda line: _polygon(line, None, 0)


def _with_confidence(
    lines: Sequence[Line], path: Path, identity: Callable[[Line], int | None] | None
) -> Callable[[Line], Drawn]:
    """Boxes before or behind their confidence, as tools have both: the boxes that are in the frame decide."""
    behind = " id" if identity else ""
    first = [line.values[0] for line in lines]
    confidence_last, confidence_first = (
        np.array([line.values[start : start + 4] for line in lines]) for start in (0, 1)
    )
    is_usual, is_other = (
        float(_in_frame(boxes).mean()) >= MOST_IN_FRAME for boxes in (confidence_last, confidence_first)
    )
    if not identity and is_other and not is_usual and all(_WHOLE.match(line.words[0]) for line in lines):
        raise MismatchError(
            f"{path}, {lines[0].place}: the second column holds whole numbers ({min(first):g} to "
            f"{max(first):g}): identities, or confidences; write `class cx cy w h id`, or "
            "`class cx cy w h confidence`"
        )
    if is_other and not is_usual and _are_shares(first):
        notice(
            f"{path}: lines are read as `class confidence cx cy w h{behind}`, since so boxes are in the frame"
        )
        return lambda line: Drawn(line, line.values[1:5], "", identity(line) if identity else None)
    if is_other != is_usual or not _are_shares(first):
        if identity:
            return lambda line: _box(line, identity(line))
        return _with_last(lines, False, path, _box)
    fit = "fit" if is_other else "do not fit any of"
    raise MismatchError(
        f"{path}, {lines[0].place}: {' '.join(lines[0].words)[:80]!r} and the other lines {fit} two "
        f"readings, `class cx cy w h confidence{behind}` and `class confidence cx cy w h{behind}`; leave the "
        f"confidence out: `class cx cy w h{behind}`"
    )


def _in_frame(boxes: Floats) -> NDArray[np.bool_]:
    """(N,) whether boxes cx, cy, w, h (N, 4) in parts of the frame have an area and lie in it."""
    half = boxes[:, 2:] / 2
    fits = (boxes[:, :2] - half >= -SLACK) & (boxes[:, :2] + half <= 1 + SLACK) & (half > 0)
    return np.asarray(fits.all(axis=1), dtype=np.bool_)


def _with_last(
    lines: Sequence[Line],
    ends_whole: bool,
    path: Path,
    draw: Callable[[Line, int | None, int], Drawn],
) -> Callable[[Line], Drawn]:
    """One number behind what is drawn: an identity if all are whole, a confidence if all are shares."""
    if ends_whole:
        return lambda line: draw(line, _identity(line), 1)
    if _are_shares(line.values[-1] for line in lines):
        return lambda line: draw(line, None, 1)
    strange = next(line for line in lines if not _WHOLE.match(line.words[-1]))
    raise MismatchError(
        f"{path}, {strange.place}: the last column is {strange.words[-1]} here, and up to "
        f"{max(line.values[-1] for line in lines):g} elsewhere: as identities all of them are whole numbers, "
        "as confidences from 0 to 1"
    )


def _identity(line: Line) -> int | None:
    """The last number; none if it is below 0, as of a box that no track has."""
    identity = int(line.words[-1])
    return identity if identity >= 0 else None


def _are_shares(values: Iterable[float]) -> bool:
    return all(0 <= value <= 1 for value in values)


def _box(line: Line, identity: int | None, _: int = 0) -> Drawn:
    return Drawn(line, line.values[:4], "", identity)


def _polygon(line: Line, identity: int | None, behind: int) -> Drawn:
    values = line.values[: len(line.values) - behind]
    return Drawn(line, values, "rotated box or polygon" if len(values) == 8 else "polygon", identity)


CLASS_FILES = ("classes.txt", "obj.names", "data.yaml", "dataset.yaml", "data.yml", "dataset.yml")
UNNAMED = "without an identity (`class cx cy w h id`) it is not said which target it is"


def as_yolo(document: Document) -> dict[str, bytes]:
    """Name -> content of the files. It has no place for identities, nor for where a box comes from."""
    video, labels = document.video, document.labels
    lines: list[list[str]] = [[] for _ in range(video.frames)]
    for _, target, mark, (x, y, w, h) in document.boxes():
        numbers = (x + w / 2) / video.width, (y + h / 2) / video.height, w / video.width, h / video.height
        coordinates = " ".join(f"{value + 0.0:.8f}" for value in numbers)
        lines[mark.frame].append(f"{labels[label_of(target)] - 1} {coordinates}\n")
    files = {f"labels/{document.image_stem(n)}.txt": "".join(texts).encode() for n, texts in enumerate(lines)}
    return {"classes.txt": "".join(f"{name}\n" for name in labels).encode(), **files}


def read_yolo(path: Path, video: Video, images: Sequence[str] = ()) -> list[Answer]:
    """Every box as given: of the target with its identity, or of one target of each class.

    A file belongs to the frame that its name says (`numbering`); a frame without a file has no object.

    Raises:
        MismatchError: it does not fit the video, a line has no reading or two, or a frame has two boxes of a
            class without identities.
        OSError: it cannot be read.
    """
    files = {str(file.relative_to(path)): file for file in label_files(path)}
    if not files:
        raise MismatchError(f"{path}: no file of labels (*.txt) in it, in labels/ or in obj_train_data/")
    settings = _about(path)
    frames = _frames(path, list(files), video, images)
    lines = []
    for name, file in files.items():
        for n, line in enumerate(text_of_file(file).splitlines(), 1):
            if line.strip():
                lines.append((frames[name], parse_line(line, f"{name}:{n}", str(path))))
    _say_late(path, set(frames.values()) - {frame for frame, _ in lines}, video)
    return answers_of(_rows(lines, settings, video, path), video, path, unnamed=UNNAMED)


def _frames(path: Path, names: Sequence[str], video: Video, images: Sequence[str]) -> dict[str, int]:
    """Name of a file -> frame. Images that the folder lists or holds show where numbers begin, too."""
    listed = set[str]()
    for list_file in (path / f"{stem}.txt" for stem in sorted(LISTS - {"classes", "labels"})):
        if list_file.is_file():
            listed |= {line.strip() for line in text_of_file(list_file).splitlines() if line.strip()}
    listed |= {file.name for file in (path / "images").rglob("*") if file.suffix.lower() in IMAGE_SUFFIXES}
    return frames_of_names(names, video, images, str(path), listed)


def _about(path: Path) -> Mapping[str, Any]:
    """Settings of the folder, or of the one above its labels: `names` of classes by number, `kpt_shape`."""
    is_part = "labels" in (path.name, path.parent.name) or path.name.startswith("obj_")
    places = [path, path.parent, path.parent.parent] if is_part else [path]
    for file in (place / name for place in places for name in CLASS_FILES):
        if not file.is_file():
            continue
        if file.suffix in (".yaml", ".yml"):
            return _about_of_yaml(file)
        lines = text_of_file(file).rstrip().split("\n")
        return {"names": {n: line.strip() for n, line in enumerate(lines) if line.strip()}}
    return {"names": {}}


def _about_of_yaml(file: Path) -> Mapping[str, Any]:
    try:
        content = yaml.safe_load(text_of_file(file))
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise MismatchError(f"{file}: it is no YAML ({str(error).splitlines()[0]})") from error
    names = content.get("names") if isinstance(content, Mapping) else None
    if isinstance(names, list):
        names = dict(enumerate(names))
    if not isinstance(names, Mapping) or any(not isinstance(label, str | int) for label in names.values()):
        raise MismatchError(
            f"{file}: `names` of the classes are needed, a list of texts or numbers with texts"
        )
    named = {whole_value(key, "class", str(file)): str(name) for key, name in names.items()}
    return {"names": named, "kpt_shape": content.get("kpt_shape")}


def _rows(
    lines: Sequence[tuple[int, Line]], settings: Mapping[str, Any], video: Video, path: Path
) -> Iterator[Row]:
    names = settings["names"]
    read = boxes_of_lines([line for _, line in lines], settings.get("kpt_shape"), path)
    tracked = any(box.identity is not None for box in read)
    left = [box.line.place for box in read if tracked and box.identity is None]
    if left:
        notice(
            f"{path}: {len(left)} of {len(read)} boxes have no identity, and are left out: at {left[0]}"
            + (" and others" if len(left) > 1 else "")
        )
    unnamed = sorted({box.line.kind for box in read} - names.keys())
    if unnamed and names:
        notice(f"{path}: classes without a name: {', '.join(map(str, unnamed))}; {len(names)} have one")
    for (frame, _), box in zip(lines, read, strict=True):
        if tracked and box.identity is None:
            continue
        label = names.get(box.line.kind, f"class {box.line.kind}")
        key = box.identity if tracked else box.line.kind
        yield Row(box.line.place, frame, key, label, box.box(video), box.shape)


def _say_late(path: Path, empty: Collection[int], video: Video) -> None:
    """Warn of files behind the video; of those with boxes, the boxes are said."""
    late = [frame for frame in empty if frame >= video.frames]
    if late:
        notice(
            f"{path}: {len(late)} empty files of labels are of frames {min(late)} to {max(late)} (counted "
            f"from 0); the video has frames 0 to {video.frames - 1}"
        )
