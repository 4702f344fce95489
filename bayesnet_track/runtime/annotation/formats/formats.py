"""All formats by name, and the shortest of them, MOT."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from bayesnet_track.journal.writer import output_error, write_atomically
from bayesnet_track.runtime.annotation.answers import Answer
from bayesnet_track.runtime.annotation.formats.cvat import as_cvat, read_cvat
from bayesnet_track.runtime.annotation.formats.json_formats import (
    as_coco,
    as_label_studio,
    read_coco,
    read_label_studio,
)
from bayesnet_track.runtime.annotation.formats.reading import (
    Document,
    MismatchError,
    annotations_in,
    read_json,
    text_of,
    unpacked,
)
from bayesnet_track.runtime.annotation.formats.rows import Row, answers_of
from bayesnet_track.runtime.annotation.formats.yolo import as_yolo, read_yolo
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.sources.entrances.notices import few, heard, notice
from bayesnet_track.sources.entrances.text_lines import IMPORT, explain_json
from bayesnet_track.sources.mot_lines import MotLines, parse_mot

NO_TRACK = -1
IGNORED = 0.0
"""The confidence of a box that is not to be scored: regions that are ignored, and other classes."""


def as_mot(document: Document) -> bytes:
    """Text; the confidence is the probability, 1 where given. Names and what is gone have no place in it."""
    rows = sorted((mark.frame, number, mark, box) for number, _, mark, box in document.boxes())
    text = ""
    for frame, number, mark, box in rows:
        corner = ",".join(f"{value + 0.0:.3f}" for value in box)
        text += f"{frame + 1},{number},{corner},{mark.probability:.6f},-1,-1,-1\n"
    return text.encode()


def read_mot(path: Path, video: Video) -> list[Answer]:
    """Every box as given: target N is the file's identity N. Frames without a box say nothing.

    Boxes of confidence 0 are left out with a notice, as they are from ground truth.

    A class that the file, or CVAT's `labels.txt` beside it, gives a name to is the target's: "car 3".

    Raises:
        MismatchError: it does not fit the video, or is no MOT.
        OSError: it cannot be read.
    """
    try:
        lines = parse_mot(text_of(path), str(path))
    except ValueError as error:
        raise MismatchError(str(error)) from error
    scored = lines.only(lines.rest[:, 0] != IGNORED)
    if len(scored) < len(lines):
        reason = (
            f"{len(lines) - len(scored)} of {len(lines)} boxes have confidence 0, which says not to be scored"
        )
        if not len(scored):
            raise MismatchError(
                f"{path}: {reason}: no box can be used; write confidence 1 for those that count"
            )
        notice(
            f"{path}: {reason}, and are left out: at line {few(lines.numbers[lines.rest[:, 0] == IGNORED])}"
        )
    rows = list(_rows(scored, _classes(path)))
    free = [row for row in rows if row.key == NO_TRACK]
    if free:
        reason = f"{len(free)} of {len(rows)} boxes have the identity -1, so that no target is known"
        if len(free) == len(rows):
            raise MismatchError(f"{path}: {reason}")
        notice(f"{path}: {reason}, and are left out: at {few([row.place for row in free])}")
        rows = [row for row in rows if row.key != NO_TRACK]
    return answers_of(rows, video, path, {row.key: f"{row.label} {row.key}" for row in rows})


def _rows(lines: MotLines, classes: list[str]) -> Iterator[Row]:
    columns = (lines.numbers, lines.frames, lines.ids, lines.boxes, lines.classes)
    for number, frame, identity, box, kind in zip(*(column.tolist() for column in columns), strict=True):
        yield Row(f"line {number}", frame, identity, _label(kind, classes), tuple(box))


def _label(kind: str, classes: list[str]) -> str:
    """The name of a class that a file gives by name, or by number where `labels.txt` has the names."""
    try:
        number = int(float(kind)) - 1
    except (ValueError, OverflowError):
        return kind or "target"
    return classes[number] if 0 <= number < len(classes) else "target"


def _classes(path: Path) -> list[str]:
    file = path.with_name("labels.txt")
    is_there = file.is_file() and file != path
    return [line.strip() or "target" for line in text_of(file).rstrip().split("\n")] if is_there else []


WRITERS: Mapping[str, Callable[[Document], Mapping[str, bytes]]] = {
    "coco": lambda document: {"coco.json": as_coco(document)},
    "mot": lambda document: {"mot.txt": as_mot(document)},
    "cvat": lambda document: {"cvat.xml": as_cvat(document)},
    "label-studio": lambda document: {"label_studio.json": as_label_studio(document)},
    "yolo": lambda document: {f"yolo/{name}": data for name, data in as_yolo(document).items()},
}
"""Format -> name and content of its files, from the folder of the annotations."""


def write_formats(folder: Path, formats: tuple[str, ...], document: Document) -> None:
    """Write the files of each format into the folder; raises OutputError."""
    for name in formats:
        for file, data in WRITERS[name](document).items():
            try:
                (folder / file).parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise output_error(folder / file, error) from error
            write_atomically(folder / file, data)


def read_annotations(path: Path, video: Video, images: Sequence[str] = ()) -> list[Answer]:
    """The answers that a file, a folder or a zip of any format gives; it is known by what it holds.

    `images` are the names of the files that the frames come from, if there are such.

    Raises:
        MismatchError: it does not fit the video, or gives no box; says the first mismatch.
        OSError: it cannot be read.
    """
    why: list[str] = []
    with heard(why.append):
        answers = _read(path, video, images)
    if not any(answer.kind == "box" for answer in answers):
        reasons = "; ".join(sentence.removeprefix(f"{path}: ") for sentence in why)
        raise MismatchError(f"{path}: no box can be used: {reasons or 'it holds none'}")
    for sentence in why:
        notice(sentence)
    return answers


def _read(path: Path, video: Video, images: Sequence[str]) -> list[Answer]:
    with unpacked(path) as place:
        file = annotations_in(place) if place.is_dir() else place
        if file.is_dir():
            return read_yolo(file, video, images)
        if file.suffix.lower() == ".xml":
            return read_cvat(file, video, images)
        if file.suffix.lower() != ".json":
            return read_mot(file, video)
        content = read_json(file)
        if isinstance(content, dict) and "images" in content:
            return read_coco(file, video, images)
        tool = explain_json(content)
        if tool is not None and not tool.endswith(IMPORT):
            raise MismatchError(f"{file}: it is {tool}")
        first = content[0] if isinstance(content, list) and content else content
        if not isinstance(first, dict) or "bbox" in first or "items" in first:
            raise MismatchError(
                f"{file}: neither COCO (an object with images and annotations) nor a task of Label Studio; "
                "results of detections and Datumaro's JSON do not say which image is which frame"
            )
        return read_label_studio(file, video)
