"""Reading other tools' files: where they lie, their text and numbers, upright boxes of their shapes."""

from __future__ import annotations

import json
import math
import re
import tempfile
import xml.etree.ElementTree as Tree
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from bayesnet_track.runtime.annotation.answers import Box
from bayesnet_track.runtime.annotation.asking import BoxMark
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.sources.entrances.notices import heard, notice
from bayesnet_track.sources.mot_lines import NotTextError, read_text
from bayesnet_track.sources.paths import is_junk, natural_key

Marks = Mapping[str, Mapping[int, BoxMark]]


class MismatchError(ValueError):
    """A file that does not fit the video; the first mismatch: where, what was found, what is needed."""


@dataclass(frozen=True)
class Document:
    """Annotations of a video: target -> frame -> mark.

    Attributes:
        images: names of the files that the frames come from; empty where they are not image files.
    """

    video: Video
    marks: Marks
    images: Sequence[str] = ()

    @property
    def labels(self) -> dict[str, int]:
        """Label -> number from 1, in the order in which targets came."""
        names = dict.fromkeys(map(label_of, self.marks))
        return {name: number for number, name in enumerate(names, 1)}

    def boxes(self) -> Iterator[tuple[int, str, BoxMark, Box]]:
        """Number of the target from 1, its name, mark and box, by target and frame."""
        for number, (target, of_target) in enumerate(self.marks.items(), 1):
            for frame in sorted(of_target):
                box = of_target[frame].box
                if box is not None:
                    yield number, target, of_target[frame], box

    def image(self, frame: int) -> str:
        """The file name of a frame: that of its source, or else its number."""
        return self.images[frame] if self.images else f"{frame:06d}.jpg"

    def image_stem(self, frame: int) -> str:
        """The same without its suffix; the number where two images differ in nothing but that."""
        stems = {PurePath(name).stem for name in self.images}
        return PurePath(self.image(frame)).stem if len(stems) == len(self.images) else f"{frame:06d}"


def label_of(target: str) -> str:
    """The class of a target: its name without the number at its end ("ball 2" is a ball)."""
    return re.sub(r"[ _#-]*\d+$", "", target) or "target"


def check_frame_size(width: object, height: object, video: Video, place: str) -> None:
    """Refuse frames of another size; raises MismatchError."""
    if (width, height) != (video.width, video.height):
        raise MismatchError(
            f"{place}: frames of {width}x{height} px; the video has {video.width}x{video.height} px"
        )


def rounded(value: float, digits: int = 3) -> float:
    """Rounded, without a negative zero."""
    return round(value, digits) + 0.0


TEXTS = frozenset({".xml", ".json", ".txt", ".names", ".data", ".yaml", ".yml", ".ini"})
OTHERS = frozenset({".gz", ".tgz", ".tar", ".bz2", ".xz", ".7z", ".rar", ".zst"})
MOST_BYTES = 1 << 30
LISTS = frozenset({"classes", "labels", "train", "val", "valid", "validation", "test", "trainval"})
"""Names of text files that list classes or images."""


@contextmanager
def unpacked_folder(path: Path) -> Iterator[Path]:
    """The folder with the texts of a zip, which is gone afterwards; any other path as it is.

    Errors and notices name files below the zip.

    Raises:
        MismatchError: the zip is damaged, has a password or holds more than 1 GiB of text, or another archive
            is given.
    """
    if path.suffix.lower() in OTHERS and path.is_file():
        raise MismatchError(f"{path}: of archives only a zip is read; unpack it")
    if path.is_dir() or not zipfile.is_zipfile(path):
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="bayesnet_track_zip_") as folder:
        root = Path(folder) / path.name
        root.mkdir()
        _unpack(path, root)
        sentences: list[str] = []
        try:
            with heard(sentences.append):
                yield root
        except MismatchError as error:
            raise MismatchError(str(error).replace(str(root), str(path))) from error
        for sentence in sentences:
            notice(sentence.replace(str(root), str(path)))


def _unpack(path: Path, root: Path) -> None:
    try:
        with zipfile.ZipFile(path) as archive:
            members = [entry for entry in archive.infolist() if _is_text(entry.filename)]
            if sum(entry.file_size for entry in members) > MOST_BYTES:
                raise MismatchError(f"{path}: more than 1 GiB of text in it; unzip it")
            for member in members:
                archive.extract(member, root)
    except (zipfile.BadZipFile, RuntimeError, NotImplementedError, EOFError, ValueError) as error:
        if isinstance(error, MismatchError):
            raise
        raise MismatchError(f"{path}: the zip cannot be read ({error}); unzip it") from error


def _is_text(name: str) -> bool:
    member = Path(name)
    return not name.endswith("/") and member.suffix.lower() in TEXTS and not is_junk(member)


def annotations_in(folder: Path) -> Path:
    """The annotations of a folder: its file in a known place, or itself where it is a folder of YOLO.

    CVAT writes `annotations.xml`, `annotations/instances_default.json` and `gt/gt.txt`, Roboflow
    `train/_annotations.coco.json`. Raises MismatchError where several would do.
    """
    candidates = [folder / "annotations.xml", folder / "gt" / "gt.txt"]
    candidates += sorted(folder.glob("annotations/instances_*.json"))
    present = [file for file in candidates if file.is_file()]
    if not present and not label_folders(folder):
        patterns = ("*.xml", "*.json", "annotations/*.json", "*/_annotations.coco.json")
        present = sorted(file for pattern in patterns for file in folder.glob(pattern) if not is_junk(file))
        present += label_files(folder)[:1] if present else []
    if len(present) > 1:
        names = ", ".join(str(file.relative_to(folder)) for file in present)
        raise MismatchError(f"{folder}: {names}: name the file that is meant, or leave the others out")
    return present[0] if present else folder


def label_folders(folder: Path) -> list[Path]:
    """Folders of YOLO's labels below a folder, if they are not in itself."""
    candidates = [folder / "labels", *sorted(folder.glob("obj_*_data")), *sorted(folder.glob("*/labels"))]
    return [folder_of_labels for folder_of_labels in candidates if folder_of_labels.is_dir()]


def label_files(folder: Path) -> list[Path]:
    """The files of YOLO's labels below a folder, in natural order; lists of classes and images are none."""
    texts = [file for labels in label_folders(folder) for file in labels.rglob("*.txt")]
    return sorted(
        (file for file in texts or folder.glob("*.txt") if _has_labels(file, folder)), key=natural_key
    )


def _has_labels(file: Path, folder: Path) -> bool:
    stem = file.stem.lower()
    is_list = stem in LISTS or stem.startswith("readme")
    return not is_list and not is_junk(file.relative_to(folder)) and file.is_file()


def text_of_file(file: Path) -> str:
    """A whole file as text; raises MismatchError where it is none."""
    try:
        return read_text(file)
    except NotTextError as error:
        raise MismatchError(str(error)) from error


CHUNK = 1 << 16
LARGEST_FRAME = 10**9


def read_json(path: Path) -> Any:
    """The content of a JSON file in UTF-8, UTF-16 or UTF-32; raises MismatchError where it is none."""
    try:
        return json.loads(path.read_bytes(), object_pairs_hook=_once)
    except RecursionError as error:
        raise MismatchError(f"{path}: it is no JSON that can be read (nested too deeply)") from error
    except ValueError as error:
        raise MismatchError(f"{path}: it is no JSON ({error})") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    mapping = dict(pairs)
    if len(mapping) < len(pairs):
        met = set[str]()
        twice = next(key for key, _ in pairs if key in met or met.add(key))  # type: ignore[func-returns-value]
        raise ValueError(f"an object has the key {twice!r} twice")
    return mapping


class _Builder(Tree.TreeBuilder):
    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise MismatchError("it has a <!DOCTYPE>, which may declare entities; CVAT writes none")


def read_xml(path: Path) -> Tree.Element:
    """The root of an XML file without a DTD, in any encoding; raises MismatchError where it is none."""
    parser = Tree.XMLParser(target=_Builder())
    data = path.read_bytes()
    try:
        for start in range(0, len(data), CHUNK):  # an error in a chunk ends it
            parser.feed(data[start : start + CHUNK])
        root: Tree.Element = parser.close()
    except MismatchError as error:
        raise MismatchError(f"{path}: {error}") from error
    except (Tree.ParseError, ValueError, LookupError) as error:
        raise MismatchError(f"{path}: it is no XML ({error})") from error
    return root


def number(value: object, name: str, place: str) -> float:
    """A number, or a text of one; NaN and infinity are numbers here. Raises MismatchError."""
    try:
        if not isinstance(value, str | int | float) or isinstance(value, bool):
            raise ValueError
        return float(value)
    except OverflowError:
        return math.inf
    except ValueError as error:
        raise MismatchError(f"{place}: {name} {_shown(value)}; a number is needed") from error


def whole_value(value: object, name: str, place: str) -> int:
    """A whole number below 10⁹, or a text of one; raises MismatchError."""
    parsed = number(value, name, place)
    if not (math.isfinite(parsed) and parsed.is_integer() and abs(parsed) <= LARGEST_FRAME):
        raise MismatchError(f"{place}: {name} {_shown(value)}; a whole number is needed")
    return int(parsed)


def corner_box(values: object, name: str, place: str) -> Box:
    """Four numbers x, y, w, h; raises MismatchError."""
    if not isinstance(values, Sequence) or isinstance(values, str) or len(values) != 4:
        raise MismatchError(f"{place}: {name} {_shown(values)}; four numbers x, y, w, h are needed")
    x, y, w, h = (number(value, name, place) for value in values)
    return x, y, w, h


def identity_text(value: object, name: str, place: str) -> str:
    """An identity as text, exactly: a number is the same as its text. Raises MismatchError."""
    if isinstance(value, float) and value.is_integer() and abs(value) < 2**53:
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int | str) or value == "":
        raise MismatchError(f"{place}: {name} {_shown(value)}; a whole number or a text is needed")
    return str(value)


def needed(value: object, keys: Iterable[str], place: str) -> Mapping[str, Any]:
    """An object that has all the keys; raises MismatchError."""
    if not isinstance(value, Mapping):
        raise MismatchError(f"{place}: {_shown(value)}; an object is needed")
    for key in keys:
        if key not in value:
            raise MismatchError(f"{place}: the key {key!r} is missing; it has {', '.join(value) or 'none'}")
    return value


def list_at(values: object, place: str) -> list[Any]:
    """A list; raises MismatchError."""
    if not isinstance(values, list):
        raise MismatchError(f"{place}: {_shown(values)}; a list is needed")
    return values


def _shown(value: object) -> str:
    text = repr(value) if not isinstance(value, int) or abs(value) < 10**40 else "a number of many digits"
    return text if len(text) <= 60 else f"{text[:57]}..."


LONGEST_RLE = 1 << 27
"""Characters or counts of a mask, far beyond any frame."""


def box_around(points: Sequence[tuple[float, float]]) -> Box:
    """The smallest upright box with all points in it; NaN where a coordinate is not finite.

    >>> box_around([(3.0, 1.0), (1.0, 2.0), (2.0, 7.0)])
    (1.0, 1.0, 2.0, 6.0)
    """
    if not points or not all(math.isfinite(value) for point in points for value in point):
        return (math.nan,) * 4
    xs, ys = [x for x, _ in points], [y for _, y in points]
    return min(xs), min(ys), max(xs) - min(xs), max(ys) - min(ys)


def pairs(values: Iterable[float]) -> list[tuple[float, float]]:
    """Points of x, y, x, y, ...; raises ValueError where one has no y."""
    coordinates = list(values)
    return list(zip(coordinates[::2], coordinates[1::2], strict=True))


def turned_box(box: Box, degrees: float, corner: bool = False) -> Box:
    """The upright box around `box` turned clockwise about its centre, or about its top-left corner.

    >>> [round(value, 3) for value in turned_box((10.0, 10.0, 20.0, 10.0), 90.0)]
    [15.0, 5.0, 10.0, 20.0]
    >>> [round(value, 3) for value in turned_box((10.0, 10.0, 20.0, 10.0), 90.0, corner=True)]
    [0.0, 10.0, 10.0, 20.0]
    """
    x, y, w, h = box
    if not all(map(math.isfinite, (*box, degrees))):
        return (math.nan,) * 4
    if w <= 0 or h <= 0:
        return box
    cx, cy = (x, y) if corner else (x + w / 2, y + h / 2)
    sine, cosine = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    corners = [(x, y), (x + w, y), (x + w, y + h), (x, y + h)]
    return box_around(
        [
            (cx + cosine * (px - cx) - sine * (py - cy), cy + sine * (px - cx) + cosine * (py - cy))
            for px, py in corners
        ]
    )


def ellipse_box(centre: tuple[float, float], radii: tuple[float, float], degrees: float) -> Box:
    """The upright box around an ellipse turned clockwise about its centre.

    >>> [round(value, 3) for value in ellipse_box((10.0, 10.0), (4.0, 2.0), 90.0)]
    [8.0, 6.0, 4.0, 8.0]
    """
    (cx, cy), (rx, ry) = centre, radii
    if not all(map(math.isfinite, (cx, cy, rx, ry, degrees))):
        return (math.nan,) * 4
    sine, cosine = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    w, h = math.hypot(rx * cosine, ry * sine), math.hypot(rx * sine, ry * cosine)
    return cx - w, cy - h, 2 * w, 2 * h


def mask_box(counts: str | Sequence[int], height: int) -> Box:
    """The box around a mask in COCO's run-length code: columns from the left, runs of 0 and 1 in turn.

    `counts` are the runs, or COCO's compressed text of them. Raises ValueError where they are neither.

    >>> mask_box([1, 2, 2, 2, 13], height=5)
    (0.0, 0.0, 2.0, 3.0)
    >>> mask_box("1220;", height=5)
    (0.0, 0.0, 2.0, 3.0)
    """
    runs = _runs(counts) if isinstance(counts, str) else counts
    if height < 1 or any(type(run) is not int or run < 0 for run in runs):
        raise ValueError("the runs of a mask are whole numbers from 0, its height is above 0")
    position, left, right, top, bottom = 0, math.inf, -math.inf, math.inf, -math.inf
    for number, run in enumerate(runs):
        if number % 2 and run:
            first, end = divmod(position, height), divmod(position + run - 1, height)
            left, right = min(left, first[0]), max(right, end[0])
            is_wrapped = first[0] != end[0]  # it goes on in the next column, and so touches both ends
            top = min(top, 0 if is_wrapped else first[1])
            bottom = max(bottom, height - 1 if is_wrapped else end[1])
        position += run
    if left > right:
        return (math.nan,) * 4
    return float(left), float(top), float(right - left + 1), float(bottom - top + 1)


def _runs(text: str) -> list[int]:
    """COCO's text: 5 bits a character, lowest first; from the fourth on, differences to the last but one."""
    runs: list[int] = []
    position = 0
    while position < min(len(text), LONGEST_RLE):
        value, shift, continues = 0, 0, True
        while continues:
            if position >= len(text) or not 48 <= ord(text[position]) < 112:
                raise ValueError("the text of a mask is damaged")
            bits = ord(text[position]) - 48
            value |= (bits & 31) << shift
            continues, shift, position = bool(bits & 32), shift + 5, position + 1
            if not continues and bits & 16:
                value |= -1 << shift
        runs.append(value + runs[-2] if len(runs) > 2 else value)
    return runs
