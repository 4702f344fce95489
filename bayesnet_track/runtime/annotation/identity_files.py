"""The files of identities: answers, a line each, and the tracks of a run under the identities that follow."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from bayesnet_track.journal.writer import LineFile, write_atomically
from bayesnet_track.runtime.annotation.identity_queue import (
    IdentityAnswer,
    IdentityAnswerError,
    IdentityQueue,
)

NAME = "identities.jsonl"
FORMAT, VERSION = "bayesnet_track identities", 1


def spans_of(queue: IdentityQueue, labels: Sequence[Sequence[str]]) -> list[tuple[str, int, int, str]]:
    """Target, first and last frame, and the identity that it has from one to the other."""
    spans = []
    for path, names in zip(queue.tracklets.paths, labels, strict=True):
        turns = [0, *(k + 1 for k, (a, b) in enumerate(pairwise(names)) if a != b), len(names)]
        for first, end in pairwise(turns):
            spans.append((path.target, int(path.frame[first]), int(path.frame[end - 1]), names[first]))
    return spans


def write_tracks(queue: IdentityQueue, mot: str, folder: Path) -> int:
    """Write `tracks.txt`, the run's lines under their identities, and `identities.csv`; boxes left out.

    `mot` is the run's own `tracks.txt`. A number of an identity is that of the target whose name it is.

    Raises:
        OutputError: it cannot be written.
    """
    labels = queue.labels()
    numbers = {path.target: k + 1 for k, path in enumerate(queue.tracklets.paths)}
    of_number = {number: k for k, number in enumerate(numbers.values())}
    rows = [
        dict(zip(path.frame.tolist(), names, strict=True))
        for path, names in zip(queue.tracklets.paths, labels, strict=True)
    ]
    lines, left_out = [], 0
    for line in mot.splitlines():
        frame, number, rest = line.split(",", 2)
        name = rows[of_number[int(number)]].get(int(frame) - 1, "")
        if not name:
            left_out += 1
            continue
        identity = numbers.setdefault(name, len(numbers) + 1)
        lines.append(f"{frame},{identity},{rest}\n")
    table = ["target,first_frame,last_frame,identity\n"]
    table += [
        f"{_cell(target)},{first},{last},{_cell(name)}\n"
        for target, first, last, name in spans_of(queue, labels)
    ]
    write_atomically(folder / "tracks.txt", "".join(lines).encode())
    write_atomically(folder / "identities.csv", "".join(table).encode())
    return left_out


def _cell(text: str) -> str:
    return '"{}"'.format(text.replace('"', '""')) if any(mark in text for mark in ',"\n') else text


class IdentityFileError(ValueError):
    """A file of answers that cannot be gone on with; says file, line and what was found."""


def open_answers(path: Path, run_sha256: str, queue: IdentityQueue) -> LineFile:
    """Read the answers that a file holds into the queue, and give the file for more.

    A last line that was torn by a crash is left out.

    Raises:
        IdentityFileError: it is of another run, or damaged.
        OutputError: it cannot be written.
    """
    header = json.dumps({"format": FORMAT, "format_version": VERSION, "run": run_sha256}) + "\n"
    if not path.is_file() or not path.stat().st_size:
        write_atomically(path, header.encode())
        return LineFile(path, after=path.stat().st_size)
    data = path.read_bytes()
    lines = data.decode("utf-8", errors="replace").splitlines()
    if json_object(lines[0]) != json.loads(header):
        raise IdentityFileError(f"{path}, line 1: these are no answers about this run; give another folder")
    is_torn = not data.endswith(b"\n")
    kept = lines[1:-1] if is_torn else lines[1:]
    give_lines(queue, kept, str(path), 2)
    if is_torn:
        text = "".join(f"{line}\n" for line in [lines[0], *kept])
        write_atomically(path, text.encode())
    return LineFile(path, after=path.stat().st_size)


def give_lines(queue: IdentityQueue, lines: Sequence[str], name: str, first: int = 1) -> list[IdentityAnswer]:
    """Give the answers of lines of JSON; raises IdentityFileError with file and line."""
    given = []
    for number, line in enumerate(lines, first):
        if not line.strip():
            continue
        message = json_object(line)
        if message is None:
            raise IdentityFileError(
                f"{name}, line {number}: {line[:60]!r}; needed is an object such as "
                '{"frame": 120, "target": "4", "answer": "swap", "other": "9"}'
            )
        try:
            given.append(queue.give(message))
        except IdentityAnswerError as error:
            raise IdentityFileError(f"{name}, line {number}: {error}") from error
    return given


def json_object(line: str) -> dict[str, Any] | None:
    """The object of a line, or None."""
    try:
        parsed = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return parsed if isinstance(parsed, dict) else None


def keep_answer(file: LineFile, answer: IdentityAnswer) -> None:
    """Add an answer to its file, on the disk when it returns; raises OutputError."""
    file.append(json.dumps(answer.as_dict()))
    file.flush()
    file.sync()
