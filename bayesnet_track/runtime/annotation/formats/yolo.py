"""YOLO: a folder with `labels/000000.txt` for each frame (`class cx cy w h` in parts of it)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from bayesnet_track.runtime.annotation.answers import Answer
from bayesnet_track.runtime.annotation.formats.document import Document, MismatchError, given_box, label_of
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.sources.paths import natural_key


def as_yolo(document: Document) -> dict[str, bytes]:
    """Name -> content of the files. It has no place for identities, nor for where a box comes from."""
    video, labels = document.video, document.labels
    lines: list[list[str]] = [[] for _ in range(video.frames)]
    for _, target, mark, (x, y, w, h) in document.boxes():
        numbers = (x + w / 2) / video.width, (y + h / 2) / video.height, w / video.width, h / video.height
        shown = " ".join(f"{value + 0.0:.8f}" for value in numbers)
        lines[mark.frame].append(f"{labels[label_of(target)] - 1} {shown}\n")
    files = {f"labels/{frame:06d}.txt": "".join(own).encode() for frame, own in enumerate(lines)}
    return {"classes.txt": "".join(f"{name}\n" for name in labels).encode(), **files}


def read_yolo(path: Path, video: Video) -> list[Answer]:
    """Every box as given: one target of each class, for the format has no identities.

    Raises:
        MismatchError: it does not fit the video, or a frame has two boxes of a class.
        OSError: it cannot be read.
    """
    folder = path / "labels" if (path / "labels").is_dir() else path
    files = sorted((one for one in folder.glob("*.txt") if one.name != "classes.txt"), key=natural_key)
    if len(files) != video.frames:
        raise MismatchError(f"{folder}: {len(files)} files of labels; the video has {video.frames} frames")
    named = path / "classes.txt"
    classes = named.read_text(encoding="utf-8").split("\n") if named.is_file() else []
    return [answer for frame, file in enumerate(files) for answer in _answers(file, frame, classes, video)]


def _answers(file: Path, frame: int, classes: list[str], video: Video) -> Iterator[Answer]:
    seen = set()
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
        if not line.strip():
            continue
        place = f"{file}:{number}"
        try:
            kind, *rest = line.split()
            index, (cx, cy, w, h) = int(kind), (float(word) for word in rest)
        except ValueError as error:
            raise MismatchError(f"{place}: {line.strip()!r}; `class cx cy w h` is needed") from error
        if max(abs(cx), abs(cy), w, h) > 1.5:
            raise MismatchError(f"{place}: {line.strip()!r}; parts of the frame are needed, from 0 to 1")
        if index in seen:
            raise MismatchError(
                f"{place}: a second box of class {index}; YOLO does not say which target it is"
            )
        seen.add(index)
        label = classes[index].strip() if 0 <= index < len(classes) else f"class {index}"
        box = ((cx - w / 2) * video.width, (cy - h / 2) * video.height, w * video.width, h * video.height)
        yield given_box(frame, f"{label} 1", box, video, place)
