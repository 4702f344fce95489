"""The file of answers: a header, then a line for each answer as it is given; it only grows."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bayesnet_track.journal.writer import output_error
from bayesnet_track.runtime.annotation.answers import Answer, AnswerError, read_answer
from bayesnet_track.runtime.annotation.frame_store import Video

FORMAT = "bayesnet_track answers"
VERSION = 1
NAME = "answers.jsonl"


class AnswersFileError(ValueError):
    """A file of answers that cannot be gone on with; says file, line and what was found."""


@dataclass(frozen=True)
class Header:
    """What the answers were given to, and what tracks between them.

    Attributes:
        graph: SHA-256 of the graph's text.
        graph_name: its name.
        version: of this package.
        max_side: longest side of the frames that are tracked in, px; None for the video's own size.
    """

    video: Video
    graph_name: str
    graph: str
    seed: int
    threshold: float
    patience: int
    version: str
    max_side: int | None = None


def write_header(path: Path, header: Header) -> None:
    """Begin a file; raises OutputError."""
    line = {"format": FORMAT, "format_version": VERSION, **asdict(header)}
    if header.max_side is None:
        del line["max_side"]
    _append(path, [line])


def append_answers(path: Path, answers: Iterable[Answer]) -> None:
    """Add answers behind the others, on the disk when it returns; raises OutputError."""
    _append(path, [one.as_dict() for one in answers])


def _append(path: Path, lines: Iterable[dict[str, Any]]) -> None:
    text = "".join(json.dumps(line, allow_nan=False) + "\n" for line in lines)
    try:
        with path.open("ab") as file:
            file.write(text.encode())
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise output_error(path, error) from error


def read_answers(path: Path) -> tuple[Header, list[Answer]]:
    """The header and all answers; a last line that was torn by a crash is cut off the file.

    Raises:
        AnswersFileError: it is no such file, or a line of it is damaged.
        OSError: it cannot be read.
    """
    data = path.read_bytes()
    whole = data[: data.rfind(b"\n") + 1]
    if whole != data:
        os.truncate(path, len(whole))
    first, *rest = whole.splitlines() or [b""]
    header = _read_header(path, first)
    video = header.video
    answers = []
    for number, line in enumerate(rest, 2):
        try:
            answers.append(read_answer(_object(line), video.frames, video.width, video.height))
        except AnswerError as error:
            raise AnswersFileError(f"{path}, line {number}: {error}") from error
    return header, answers


def _read_header(path: Path, line: bytes) -> Header:
    try:
        given = _object(line)
        if given.get("format") != FORMAT:
            raise AnswerError("no header of answers")
        if given.get("format_version") != VERSION:
            raise AnswerError(f"format version {given.get('format_version')!r}; this program reads {VERSION}")
        del given["format"], given["format_version"]
        return Header(**{**given, "video": Video(**given["video"])})
    except (AnswerError, TypeError, KeyError) as error:
        raise AnswersFileError(f"{path}, line 1: {error}") from error


def _object(line: bytes) -> dict[str, Any]:
    try:
        given = json.loads(line)
    except ValueError as error:
        raise AnswerError("it is no JSON") from error
    if not isinstance(given, dict):
        raise AnswerError("an object is needed")
    return given


def first_difference(kept: Header, now: Header) -> str | None:
    """What of the video or of the tracker is not what the answers were given to; None when all is.

    When it asks may change: that changes no box.
    """
    for name in ("frames", "width", "height", "pixels"):
        was, found = getattr(kept.video, name), getattr(now.video, name)
        if was != found:
            where = "frames differ (SHA-256)" if name == "pixels" else f"{name}: {found}, it was {was}"
            return f"another video: {where}"
    for name in ("graph_name", "graph", "seed", "max_side", "version"):
        was, found = getattr(kept, name), getattr(now, name)
        if was != found:
            return f"{name.replace('_', ' ')}: {found}, it was {was}"
    return None
