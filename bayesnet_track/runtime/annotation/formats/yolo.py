"""YOLO: a folder with a file of labels for each frame (`class cx cy w h` in parts of it)."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from bayesnet_track.runtime.annotation.answers import Answer
from bayesnet_track.runtime.annotation.formats.archives import LISTS, label_files, text_of
from bayesnet_track.runtime.annotation.formats.document import Document, MismatchError, label_of
from bayesnet_track.runtime.annotation.formats.numbering import frames_of_names
from bayesnet_track.runtime.annotation.formats.rows import Row, answers_of
from bayesnet_track.runtime.annotation.formats.texts import whole
from bayesnet_track.runtime.annotation.formats.yolo_lines import Line, boxes_of, parse_line
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.paths import IMAGE_SUFFIXES

CLASS_FILES = ("classes.txt", "obj.names", "data.yaml", "dataset.yaml", "data.yml", "dataset.yml")
UNNAMED = "without an identity (`class cx cy w h id`) it is not said which target it is"


def as_yolo(document: Document) -> dict[str, bytes]:
    """Name -> content of the files. It has no place for identities, nor for where a box comes from."""
    video, labels = document.video, document.labels
    lines: list[list[str]] = [[] for _ in range(video.frames)]
    for _, target, mark, (x, y, w, h) in document.boxes():
        numbers = (x + w / 2) / video.width, (y + h / 2) / video.height, w / video.width, h / video.height
        shown = " ".join(f"{value + 0.0:.8f}" for value in numbers)
        lines[mark.frame].append(f"{labels[label_of(target)] - 1} {shown}\n")
    files = {f"labels/{document.image_stem(n)}.txt": "".join(own).encode() for n, own in enumerate(lines)}
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
    about = _about(path)
    frames = _frames(path, list(files), video, images)
    lines = []
    for name, file in files.items():
        for n, line in enumerate(text_of(file).splitlines(), 1):
            if line.strip():
                lines.append((frames[name], parse_line(line, f"{name}:{n}", str(path))))
    _say_late(path, set(frames.values()) - {frame for frame, _ in lines}, video)
    return answers_of(_rows(lines, about, video, path), video, path, unnamed=UNNAMED)


def _frames(path: Path, names: Sequence[str], video: Video, images: Sequence[str]) -> dict[str, int]:
    """Name of a file -> frame. Images that the folder lists or holds show where numbers begin, too."""
    listed = set[str]()
    for list_file in (path / f"{stem}.txt" for stem in sorted(LISTS - {"classes", "labels"})):
        if list_file.is_file():
            listed |= {line.strip() for line in text_of(list_file).splitlines() if line.strip()}
    listed |= {file.name for file in (path / "images").rglob("*") if file.suffix.lower() in IMAGE_SUFFIXES}
    return frames_of_names(names, video, images, str(path), listed)


def _about(path: Path) -> Mapping[str, Any]:
    """What the folder, or the one above its labels, says: `names` of classes by number, `kpt_shape`."""
    is_part = "labels" in (path.name, path.parent.name) or path.name.startswith("obj_")
    places = [path, path.parent, path.parent.parent] if is_part else [path]
    for file in (place / name for place in places for name in CLASS_FILES):
        if not file.is_file():
            continue
        if file.suffix in (".yaml", ".yml"):
            return _about_of_yaml(file)
        lines = text_of(file).rstrip().split("\n")
        return {"names": {n: line.strip() for n, line in enumerate(lines) if line.strip()}}
    return {"names": {}}


def _about_of_yaml(file: Path) -> Mapping[str, Any]:
    try:
        given = yaml.safe_load(text_of(file))
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise MismatchError(f"{file}: it is no YAML ({str(error).splitlines()[0]})") from error
    names = given.get("names") if isinstance(given, Mapping) else None
    if isinstance(names, list):
        names = dict(enumerate(names))
    if not isinstance(names, Mapping) or any(not isinstance(one, str | int) for one in names.values()):
        raise MismatchError(
            f"{file}: `names` of the classes are needed, a list of texts or numbers with texts"
        )
    named = {whole(key, "class", str(file)): str(name) for key, name in names.items()}
    return {"names": named, "kpt_shape": given.get("kpt_shape")}


def _rows(
    lines: Sequence[tuple[int, Line]], about: Mapping[str, Any], video: Video, path: Path
) -> Iterator[Row]:
    names = about["names"]
    read = boxes_of([line for _, line in lines], about.get("kpt_shape"), path)
    tracked = any(one.identity is not None for one in read)
    left = [one.line.place for one in read if tracked and one.identity is None]
    if left:
        notice(
            f"{path}: {len(left)} of {len(read)} boxes have no identity, and are left out: at {left[0]}"
            + (" and others" if len(left) > 1 else "")
        )
    unnamed = sorted({one.line.kind for one in read} - names.keys())
    if unnamed and names:
        notice(f"{path}: classes without a name: {', '.join(map(str, unnamed))}; {len(names)} have one")
    for (frame, _), one in zip(lines, read, strict=True):
        if tracked and one.identity is None:
            continue
        label = names.get(one.line.kind, f"class {one.line.kind}")
        key = one.identity if tracked else one.line.kind
        yield Row(one.line.place, frame, key, label, one.box(video), one.shape)


def _say_late(path: Path, empty: Collection[int], video: Video) -> None:
    """Warn of files behind the video; of those with boxes, the boxes are said."""
    late = [frame for frame in empty if frame >= video.frames]
    if late:
        notice(
            f"{path}: {len(late)} empty files of labels are of frames {min(late)} to {max(late)} (counted "
            f"from 0); the video has frames 0 to {video.frames - 1}"
        )
