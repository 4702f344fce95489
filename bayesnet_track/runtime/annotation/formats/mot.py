"""MOT: `frame, id, left, top, width, height, confidence, -1, -1, -1`, frames and ids from 1."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from bayesnet_track.runtime.annotation.answers import Answer
from bayesnet_track.runtime.annotation.formats.archives import text_of
from bayesnet_track.runtime.annotation.formats.document import Document, MismatchError
from bayesnet_track.runtime.annotation.formats.rows import Row, answers_of
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.sources.entrances.notices import few, notice
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
        said = (
            f"{len(lines) - len(scored)} of {len(lines)} boxes have confidence 0, which says not to be scored"
        )
        if not len(scored):
            raise MismatchError(
                f"{path}: {said}: no box can be used; write confidence 1 for those that count"
            )
        notice(f"{path}: {said}, and are left out: at line {few(lines.numbers[lines.rest[:, 0] == IGNORED])}")
    rows = list(_rows(scored, _classes(path)))
    free = [row for row in rows if row.key == NO_TRACK]
    if free:
        said = f"{len(free)} of {len(rows)} boxes have the identity -1, so that no target is known"
        if len(free) == len(rows):
            raise MismatchError(f"{path}: {said}")
        notice(f"{path}: {said}, and are left out: at {few([row.place for row in free])}")
        rows = [row for row in rows if row.key != NO_TRACK]
    return answers_of(rows, video, path, {row.key: f"{row.label} {row.key}" for row in rows})


def _rows(lines: MotLines, classes: list[str]) -> Iterator[Row]:
    columns = (lines.numbers, lines.frames, lines.ids, lines.boxes, lines.classes)
    for number, frame, identity, box, kind in zip(*(one.tolist() for one in columns), strict=True):
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
