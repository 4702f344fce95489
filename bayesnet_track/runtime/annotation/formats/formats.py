"""All formats by name: writing a folder of files, and reading a file of any of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from bayesnet_track.journal.atomic import write_atomically
from bayesnet_track.journal.writer import output_error
from bayesnet_track.runtime.annotation.answers import Answer
from bayesnet_track.runtime.annotation.formats.coco import as_coco, read_coco, read_json
from bayesnet_track.runtime.annotation.formats.cvat import as_cvat, read_cvat
from bayesnet_track.runtime.annotation.formats.document import Document, MismatchError
from bayesnet_track.runtime.annotation.formats.label_studio import as_label_studio, read_label_studio
from bayesnet_track.runtime.annotation.formats.mot import as_mot, read_mot
from bayesnet_track.runtime.annotation.formats.yolo import as_yolo, read_yolo
from bayesnet_track.runtime.annotation.frame_store import Video

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


def read_annotations(path: Path, video: Video) -> list[Answer]:
    """The answers that a file of any format gives; it is known by what it holds.

    Raises:
        MismatchError: it does not fit the video; says the first mismatch.
        OSError: it cannot be read.
    """
    if path.is_dir():
        return read_yolo(path, video)
    if path.suffix.lower() == ".xml":
        return read_cvat(path, video)
    if path.suffix.lower() != ".json":
        return read_mot(path, video)
    content = read_json(path)
    if isinstance(content, dict) and "images" in content:
        return read_coco(path, video)
    if isinstance(content, dict | list):
        return read_label_studio(path, video)
    raise MismatchError(f"{path}: neither COCO nor Label Studio")
