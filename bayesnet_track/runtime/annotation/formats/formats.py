"""All formats by name: writing a folder of files, and reading a file of any of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from bayesnet_track.journal.writer import output_error, write_atomically
from bayesnet_track.runtime.annotation.answers import Answer
from bayesnet_track.runtime.annotation.formats.cvat import as_cvat, read_cvat
from bayesnet_track.runtime.annotation.formats.formats import as_mot, read_mot
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
    unpacked,
)
from bayesnet_track.runtime.annotation.formats.yolo import as_yolo, read_yolo
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.sources.entrances.notices import heard, notice
from bayesnet_track.sources.entrances.text_lines import IMPORT, explain_json

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
    if not any(one.kind == "box" for one in answers):
        said = "; ".join(sentence.removeprefix(f"{path}: ") for sentence in why)
        raise MismatchError(f"{path}: no box can be used: {said or 'it holds none'}")
    for sentence in why:
        notice(sentence)
    return answers


def _read(path: Path, video: Video, images: Sequence[str]) -> list[Answer]:
    with unpacked(path) as place:
        found = annotations_in(place) if place.is_dir() else place
        if found.is_dir():
            return read_yolo(found, video, images)
        if found.suffix.lower() == ".xml":
            return read_cvat(found, video, images)
        if found.suffix.lower() != ".json":
            return read_mot(found, video)
        content = read_json(found)
        if isinstance(content, dict) and "images" in content:
            return read_coco(found, video, images)
        known = explain_json(content)
        if known is not None and not known.endswith(IMPORT):
            raise MismatchError(f"{found}: it is {known}")
        first = content[0] if isinstance(content, list) and content else content
        if not isinstance(first, dict) or "bbox" in first or "items" in first:
            raise MismatchError(
                f"{found}: neither COCO (an object with images and annotations) nor a task of Label Studio; "
                "results of detections and Datumaro's JSON do not say which image is which frame"
            )
        return read_label_studio(found, video)
