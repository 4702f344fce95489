"""Answers: what a person says of targets in frames, their names, and the file that holds them."""

from __future__ import annotations

import json
import math
import re
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, Literal

from bayesnet_track.journal.writer import LineFile, OutputError, write_atomically
from bayesnet_track.observation.settings import setting
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.runtime.resizing import LEAST_MAX_SIDE
from bayesnet_track.sources.entrances.levels import ValueRange, value_range_of

LONGEST_NAME = 80
LONGEST_LABEL = LONGEST_NAME - 10
"""Of a mended name: behind it there is room for a number."""


def describe_fault(name: object) -> str | None:
    """The reason why a target cannot have this name; None if it can.

    >>> describe_fault("ball 1")
    >>> describe_fault("ball\\u00a01")
    "target 'ball\\\\xa01': a name is printable, on one line"
    """
    if not isinstance(name, str) or not name.strip() or len(name) > LONGEST_NAME:
        return f"a target needs a name of 1 to {LONGEST_NAME} characters"
    if not name.isprintable():
        return f"target {name!r}: a name is printable, on one line"
    if name != name.strip():
        return f"target {name!r}: a name neither begins nor ends with a space"
    return None


def mend_names(
    names: Iterable[str], is_others: Callable[[str, str], bool] = lambda name, candidate: False
) -> dict[str, str]:
    """Bad name -> the name in its place, of those that have a fault. Two names never become one.

    `is_others` says of a bad name and a new one whether the new one is another target's.

    Other spaces and control characters become a space, what else is not printable goes, and what is too long
    is cut. A name that is taken gets the next free number.

    >>> mend_names(["ball 1", "ball\\u00a01", "\\tcar  1", ""])
    {'ball\\xa01': 'ball 2', '\\tcar  1': 'car 1', '': 'target 1'}
    """
    distinct = dict.fromkeys(names)
    reserved = {name for name in distinct if describe_fault(name) is None}
    mended = {}
    for name in distinct:
        if name not in reserved:
            mended[name] = _find_free(_tidy(name), partial(_is_taken, name, reserved, is_others))
            reserved.add(mended[name])
    return mended


def describe_mended(mended: dict[str, str]) -> str:
    """A sentence about names that were mended, each as it is from now on."""
    listed = ", ".join(
        f"{_short(name)} is now {mended_name!r}" for name, mended_name in list(mended.items())[:5]
    )
    remainder = f", and {len(mended) - 5} more" if len(mended) > 5 else ""
    return (
        f"names of targets are printable, on one line, of 1 to {LONGEST_NAME} characters, without a space at "
        f"either end: {listed}{remainder}"
    )


def find_alike(names: Iterable[str]) -> list[tuple[str, str]]:
    """Pairs of different names that differ in case or in how a letter is encoded alone.

    >>> find_alike(["car 1", "Car 1", "car 2"])
    [('car 1', 'Car 1')]
    """
    first: dict[str, str] = {}
    pairs = []
    for name in dict.fromkeys(names):
        earlier = first.setdefault(unicodedata.normalize("NFKC", name).casefold(), name)
        if earlier != name:
            pairs.append((earlier, name))
    return pairs


def _tidy(name: str) -> str:
    spaced = "".join(map(_printable, name))
    return " ".join(spaced.split()) or "target 1"


def _printable(letter: str) -> str:
    if letter.isprintable():
        return letter
    return " " if letter.isspace() or unicodedata.category(letter) == "Cc" else ""


def _is_taken(name: str, reserved: set[str], is_others: Callable[[str, str], bool], candidate: str) -> bool:
    return candidate in reserved or is_others(name, candidate)


def _find_free(name: str, is_taken: Callable[[str], bool]) -> str:
    if len(name) <= LONGEST_NAME and not is_taken(name):
        return name
    label, number = re.fullmatch(r"(.*?)[ ]*(\d{0,6})", name).groups()  # type: ignore[union-attr]
    label = label[:LONGEST_LABEL].rstrip() or "target"
    return next(free for n in count(int(number or 1)) if not is_taken(free := f"{label} {n}"))


def _short(name: str) -> str:
    return repr(name) if len(name) <= 40 else f"{name[:40]!r}… ({len(name)} characters)"


Box = tuple[float, float, float, float]
"""Top-left corner x, y, width and height, px."""

Kind = Literal["box", "correct", "gone", "undo"]
KINDS: tuple[Kind, ...] = ("box", "correct", "gone", "undo")


class AnswerError(ValueError):
    """An answer that makes no sense; the message is for the person who gave it."""


@dataclass(frozen=True)
class Answer:
    """One answer.

    Attributes:
        kind: `box`: it is here; `correct`: the box that was shown is right; `gone`: it cannot be seen from
            this frame on, until a box says otherwise; `undo`: the newest answer that is in force is not.
        frame: from 0; 0 of an undo.
        target: name of the target; empty of an undo.
        box: of `box` and `correct`.
    """

    kind: Kind
    frame: int = 0
    target: str = ""
    box: Box | None = None

    def as_dict(self) -> dict[str, Any]:
        """The answer as a line of the file."""
        if self.kind == "undo":
            return {"kind": "undo"}
        line: dict[str, Any] = {"kind": self.kind, "frame": self.frame, "target": self.target}
        return line if self.box is None else {**line, "box": list(self.box)}


UNDO = Answer("undo")


def read_answer(message: Mapping[str, Any], frames: int, width: int, height: int) -> Answer:
    """The answer that a line or a page gives.

    Raises:
        AnswerError: it is none of this video.
    """
    kind = message.get("kind")
    if kind not in KINDS:
        raise AnswerError(f"kind {kind!r}: one of {', '.join(KINDS)} is needed")
    if kind == "undo":
        return UNDO
    frame, target = message.get("frame"), message.get("target")
    if type(frame) is not int or not 0 <= frame < frames:
        raise AnswerError(f"frame {frame!r}: the video has frames 0 to {frames - 1}")
    fault = describe_fault(target)
    if fault is not None:
        raise AnswerError(fault)
    assert isinstance(target, str)
    if kind == "gone":
        return Answer("gone", frame, target)
    return Answer(kind, frame, target, read_box(message.get("box"), width, height))


def read_box(sent: object, width: int, height: int) -> Box:
    """Four finite numbers x, y, w, h with an area that touches the frame; raises AnswerError."""
    values = list(sent) if isinstance(sent, list | tuple) else []
    if len(values) != 4 or any(type(value) not in (int, float) for value in values):
        raise AnswerError(f"box {sent!r}: four numbers x, y, w, h are needed")
    try:
        x, y, w, h = (float(value) for value in values)
    except OverflowError as error:
        raise AnswerError("a box is four numbers of px") from error
    if not all(map(math.isfinite, (x, y, w, h))) or w <= 0 or h <= 0:
        raise AnswerError(f"box {x:g},{y:g},{w:g},{h:g}: width and height above 0 are needed")
    if x >= width or y >= height or x + w <= 0 or y + h <= 0:
        raise AnswerError(f"box {x:g},{y:g},{w:g},{h:g}: it lies outside of the frame of {width}x{height} px")
    return x, y, w, h


def in_force(answers: Iterable[Answer]) -> tuple[Answer, ...]:
    """Answers that no undo took back, in the order in which they were given."""
    standing: list[Answer] = []
    for answer in answers:
        if answer.kind != "undo":
            standing.append(answer)
        elif standing:
            standing.pop()
    return tuple(standing)


FORMAT = "bayesnet_track answers"
VERSION = 1
NAME = "answers.jsonl"
BEFORE = "answers.before.jsonl"
"""The file as it was before something in it was mended."""


class AnswersFileError(ValueError):
    """A file of answers that cannot be gone on with; says file, line and what was found."""


@dataclass(frozen=True)
class Header:
    """The video that the answers were given to, and the tracker between them.

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
    """Contents of a file of answers.

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
    text = "".join(f"{entry}\n" for entry in [json.dumps(line, allow_nan=False), *map(_line, answers)])
    write_atomically(path, text.encode())


def append_answers(file: LineFile, answers: Iterable[Answer]) -> None:
    """Add answers behind the others, on the disk when it returns.

    Raises:
        OutputError: they cannot be written, or something else changed the file; nothing is added then.
    """
    for answer in answers:
        file.append(_line(answer))
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
    objects = []
    torn = []
    for number, line in lines[1:]:
        try:
            objects.append((number, _object(line)))
        except AnswerError as error:
            if is_whole or number != lines[-1][0]:
                raise AnswersFileError(f"{path}, line {number}: {error}") from error
            torn = [f"{path}: the last line, {number}, is unfinished and is left out: {line[:60]!r}"]
    answers, renamed = _read(path, header.video, objects)
    mended = [f"{path}: {describe_mended(renamed)}"] if renamed else []
    return AnswersFile(header, answers, (*mended, *torn), is_whole)


def _read(
    path: Path, video: Video, objects: Sequence[tuple[int, dict[str, Any]]]
) -> tuple[tuple[Answer, ...], dict[str, str]]:
    names = (line["target"] for _, line in objects if isinstance(line.get("target"), str))
    renamed = mend_names(names)
    answers = []
    for number, line in objects:
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
        properties = _object(line)
        if properties.get("format") != FORMAT:
            raise AnswerError("no header of answers")
        if properties.get("format_version") != VERSION:
            raise AnswerError(
                f"format version {properties.get('format_version')!r}; this program reads {VERSION}"
            )
        del properties["format"], properties["format_version"]
        properties["value_range"] = value_range_of(properties.get("value_range"))
        header = Header(**{**properties, "video": Video(**properties["video"])})
    except (ValueError, TypeError, KeyError) as error:
        raise AnswersFileError(f"{path}, line 1: {error}") from error
    for name, (value, kinds, minimum) in {
        "video.frames": (header.video.frames, (int,), 1),
        "video.width": (header.video.width, (int,), 1),
        "video.height": (header.video.height, (int,), 1),
        "graph_name": (header.graph_name, (str,), None),
        "seed": (header.seed, (int,), 0),
        "threshold": (header.threshold, (int, float), 0),
        "patience": (header.patience, (int,), 1),
        "max_side": (header.max_side, (int, type(None)), LEAST_MAX_SIDE),
    }.items():
        is_low = minimum is not None and isinstance(value, int | float) and not value >= minimum
        if type(value) not in kinds or is_low:
            needed = " or ".join(kind.__name__ for kind in kinds if kind is not type(None))
            at_least = "" if minimum is None else f" of at least {minimum}"
            raise AnswersFileError(f"{path}, line 1: {name} {value!r}; {needed}{at_least} is needed")
    return header


def _object(line: bytes) -> dict[str, Any]:
    try:
        parsed = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise AnswerError("it is no JSON") from error
    if not isinstance(parsed, dict):
        raise AnswerError("an object is needed")
    return parsed


def first_difference(stored: Header, current: Header) -> str | None:
    """The first property of the video or of the tracker that differs from the answers'; None if none does.

    When it asks may change: that changes no box.
    """
    for name in ("frames", "width", "height", "pixels"):
        was, value = getattr(stored.video, name), getattr(current.video, name)
        if was != value:
            difference = "frames differ (SHA-256)" if name == "pixels" else f"{name}: {value}, it was {was}"
            if name == "pixels" and stored.value_range != current.value_range:
                ranges = [header.value_range or "none" for header in (current, stored)]
                kept_if = f"without {setting('--range')} it is kept"
                difference += f"; the range of values is {ranges[0]}, it was {ranges[1]} ({kept_if})"
            return f"another video: {difference}"
    for name in ("graph_name", "graph", "seed", "max_side", "version"):
        was, value = getattr(stored, name), getattr(current, name)
        if was != value:
            return f"{name.replace('_', ' ')}: {value}, it was {was}"
    return None
