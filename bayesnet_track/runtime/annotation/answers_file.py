"""The file of answers: a header, then a line for each answer as it is given; it only grows."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bayesnet_track.journal.writer import LineFile, OutputError, write_atomically
from bayesnet_track.observation.settings import setting
from bayesnet_track.runtime.annotation.answers import (
    Answer,
    AnswerError,
    describe_mended,
    mend_names,
    read_answer,
)
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.runtime.resizing import LEAST_MAX_SIDE
from bayesnet_track.sources.entrances.levels import ValueRange, value_range_of

FORMAT = "bayesnet_track answers"
VERSION = 1
NAME = "answers.jsonl"
BEFORE = "answers.before.jsonl"
"""The file as it was before something in it was mended."""


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
        value_range: the values that become black and white; None for all that the type of the values holds.
    """

    video: Video
    graph_name: str
    graph: str
    seed: int
    threshold: float
    patience: int
    version: str
    max_side: int | None = None
    value_range: ValueRange | None = None


@dataclass(frozen=True)
class AnswersFile:
    """What a file holds.

    Attributes:
        mended: a sentence for each thing that was not read as it stands there.
        is_whole: whether it ends as every file of answers does, in a newline.
    """

    header: Header
    answers: tuple[Answer, ...]
    mended: tuple[str, ...] = ()
    is_whole: bool = True


def write_answers(path: Path, header: Header, answers: Iterable[Answer] = ()) -> None:
    """Write a file anew, whole or not at all; raises OutputError."""
    line = {"format": FORMAT, "format_version": VERSION, **asdict(header)}
    for name in ("max_side", "value_range"):
        if line[name] is None:
            del line[name]
    text = "".join(f"{one}\n" for one in [json.dumps(line, allow_nan=False), *map(_line, answers)])
    write_atomically(path, text.encode())


def append_answers(file: LineFile, answers: Iterable[Answer]) -> None:
    """Add answers behind the others, on the disk when it returns.

    Raises:
        OutputError: they cannot be written, or something else changed the file; nothing is added then.
    """
    for one in answers:
        file.append(_line(one))
    try:
        file.flush()
    except OutputError as error:
        if error.errno is not None:
            raise
        raise OutputError(f"{error}; end this command and start it again: it reads the file anew") from error
    file.sync()


def _line(answer: Answer) -> str:
    return json.dumps(answer.as_dict(), allow_nan=False)


def read_answers(path: Path) -> AnswersFile:
    """The header and all answers; changes nothing on the disk.

    A last line that was torn by a crash is left out, and names that no target can have are mended.

    Raises:
        AnswersFileError: it is no such file, or a line of it is damaged or cannot be read.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise AnswersFileError(f"{path}: {error.strerror}") from error
    is_whole = data.endswith(b"\n")
    lines = [(number, line) for number, line in enumerate(data.splitlines(), 1) if line.strip()]
    header = _read_header(path, lines[0][1] if lines else b"")
    given = []
    torn = []
    for number, line in lines[1:]:
        try:
            given.append((number, _object(line)))
        except AnswerError as error:
            if is_whole or number != lines[-1][0]:
                raise AnswersFileError(f"{path}, line {number}: {error}") from error
            torn = [f"{path}: the last line, {number}, is unfinished and is left out: {line[:60]!r}"]
    answers, renamed = _read(path, header.video, given)
    mended = [f"{path}: {describe_mended(renamed)}"] if renamed else []
    return AnswersFile(header, answers, (*mended, *torn), is_whole)


def _read(
    path: Path, video: Video, given: Sequence[tuple[int, dict[str, Any]]]
) -> tuple[tuple[Answer, ...], dict[str, str]]:
    names = (line["target"] for _, line in given if isinstance(line.get("target"), str))
    renamed = mend_names(names)
    answers = []
    for number, line in given:
        target = line.get("target")
        if isinstance(target, str):
            line = {**line, "target": renamed.get(target, target)}
        try:
            answers.append(read_answer(line, video.frames, video.width, video.height))
        except AnswerError as error:
            raise AnswersFileError(f"{path}, line {number}: {error}") from error
    return tuple(answers), renamed


def _read_header(path: Path, line: bytes) -> Header:
    try:
        given = _object(line)
        if given.get("format") != FORMAT:
            raise AnswerError("no header of answers")
        if given.get("format_version") != VERSION:
            raise AnswerError(f"format version {given.get('format_version')!r}; this program reads {VERSION}")
        del given["format"], given["format_version"]
        given["value_range"] = value_range_of(given.get("value_range"))
        header = Header(**{**given, "video": Video(**given["video"])})
    except (ValueError, TypeError, KeyError) as error:
        raise AnswersFileError(f"{path}, line 1: {error}") from error
    for name, (value, kinds, least) in {
        "video.frames": (header.video.frames, (int,), 1),
        "video.width": (header.video.width, (int,), 1),
        "video.height": (header.video.height, (int,), 1),
        "graph_name": (header.graph_name, (str,), None),
        "seed": (header.seed, (int,), 0),
        "threshold": (header.threshold, (int, float), 0),
        "patience": (header.patience, (int,), 1),
        "max_side": (header.max_side, (int, type(None)), LEAST_MAX_SIDE),
    }.items():
        is_low = least is not None and isinstance(value, int | float) and not value >= least
        if type(value) not in kinds or is_low:
            needed = " or ".join(kind.__name__ for kind in kinds if kind is not type(None))
            at_least = "" if least is None else f" of at least {least}"
            raise AnswersFileError(f"{path}, line 1: {name} {value!r}; {needed}{at_least} is needed")
    return header


def _object(line: bytes) -> dict[str, Any]:
    try:
        given = json.loads(line)
    except (ValueError, RecursionError) as error:
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
            if name == "pixels" and kept.value_range != now.value_range:
                ranges = [one.value_range or "none" for one in (now, kept)]
                kept_if = f"without {setting('--range')} it is kept"
                where += f"; the range of values is {ranges[0]}, it was {ranges[1]} ({kept_if})"
            return f"another video: {where}"
    for name in ("graph_name", "graph", "seed", "max_side", "version"):
        was, found = getattr(kept, name), getattr(now, name)
        if was != found:
            return f"{name.replace('_', ' ')}: {found}, it was {was}"
    return None
