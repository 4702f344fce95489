"""The browser view of the identities of a run: serves the page that asks, and takes what it answers.

The files of identities: answers, a line each, and the tracks of a run under the identities that follow.
"""

from __future__ import annotations

import json
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np

from bayesnet_track.adapt.tracklets import TrackPath
from bayesnet_track.journal.writer import LineFile, OutputError, write_atomically
from bayesnet_track.numerics.arrays import Image
from bayesnet_track.runtime.annotation.identity_queue import (
    IdentityAnswer,
    IdentityAnswerError,
    IdentityQuestion,
    IdentityQueue,
)
from bayesnet_track.runtime.live_view.controls import Refused
from bayesnet_track.runtime.live_view.server import Server
from bayesnet_track.view.run_page import identities_page

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
        frame, number, box_text = line.split(",", 2)
        name = rows[of_number[int(number)]].get(int(frame) - 1, "")
        if not name:
            left_out += 1
            continue
        identity = numbers.setdefault(name, len(numbers) + 1)
        lines.append(f"{frame},{identity},{box_text}\n")
    table = ["target,first_frame,last_frame,identity\n"]
    table += [
        f"{_cell(target)},{first},{final},{_cell(name)}\n"
        for target, first, final, name in spans_of(queue, labels)
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
    answers = lines[1:-1] if is_torn else lines[1:]
    give_lines(queue, answers, str(path), 2)
    if is_torn:
        text = "".join(f"{line}\n" for line in [lines[0], *answers])
        write_atomically(path, text.encode())
    return LineFile(path, after=path.stat().st_size)


def give_lines(queue: IdentityQueue, lines: Sequence[str], name: str, first: int = 1) -> list[IdentityAnswer]:
    """Give the answers of lines of JSON; raises IdentityFileError with file and line."""
    answers = []
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
            answers.append(queue.give(message))
        except IdentityAnswerError as error:
            raise IdentityFileError(f"{name}, line {number}: {error}") from error
    return answers


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


WAIT_S = 3.0
LARGEST_SIDE, QUALITY = 1280, 85
AROUND = 12
"""Frames that are shown before the end and after the start that a question is about."""


class JpegFrames:
    """Frames as JPEG, in a temporary file without a name."""

    def __init__(self, images: Iterable[tuple[int, Image]] = ()) -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115
        self._places: dict[int, tuple[int, int]] = {}
        self._lock = threading.Lock()
        end = 0
        for frame, image in images:
            scale = min(LARGEST_SIDE / max(image.shape[:2]), 1.0)
            size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
            smaller = cv2.resize(image, size, interpolation=cv2.INTER_AREA) if scale < 1.0 else image
            is_encoded, data = cv2.imencode(".jpg", smaller, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
            if is_encoded:
                self._file.write(data.tobytes())
                self._places[frame] = (end, len(data))
                end += len(data)

    def at(self, frame: int) -> tuple[int, bytes] | None:
        """A frame, where there is one."""
        if frame not in self._places:
            return None
        start, length = self._places[frame]
        with self._lock:
            self._file.seek(start)
            return frame, self._file.read(length)


class IdentityServer:
    """Serves the page of a queue of doubtful identities.

    Args:
        queue: of a run.
        file: to which answers are added.
        about: name, width, height, frames and out, for the page.
        most: questions that are listed.
        pictures: of the run; none where its source is gone.
        address: host and port to listen at; None for a free one.

    Raises:
        OSError: the port is taken, or the host is not one of this machine.
    """

    def __init__(
        self,
        queue: IdentityQueue,
        file: LineFile,
        header: Mapping[str, Any],
        limit: int,
        pictures: JpegFrames,
        address: tuple[str, int | None] = ("127.0.0.1", None),
    ) -> None:
        self._queue, self._file, self._about, self._most = queue, file, header, limit
        self._pictures, self._news = pictures, threading.Condition()
        self._version, self._is_left, self._is_closed = 1, False, False
        self._body: dict[str, Any] = {}
        self._update()
        self._page = identities_page()
        self._server = Server(self, *address)

    @property
    def address(self) -> str:
        """The address of the page, with its token."""
        return self._server.address

    def wait(self, give_up: Callable[[], bool]) -> None:
        """Until the person has left, or `give_up`."""
        while not (self._is_left or give_up()):
            time.sleep(0.05)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._news:
            self._is_closed = True
            self._news.notify_all()
        self._server.close()

    # What the server asks for.

    def page(self) -> tuple[bytes, str]:
        """The page, and its content security policy."""
        return self._page

    def feed(self, first: int, seen_version: int) -> bytes:
        """The questions, as soon as they are others than those of `seen_version`."""
        with self._news:
            self._news.wait_for(lambda: self._version != seen_version or self._is_closed, WAIT_S)
            answer = {"version": self._version, "left": self._is_left, "about": self._about, **self._body}
        return json.dumps(answer, allow_nan=False).encode()

    def picture(self, frame: int) -> tuple[int, bytes] | None:
        """A frame as JPEG."""
        return self._pictures.at(frame)

    def ask(self, request: Mapping[str, Any]) -> None:
        """`{"do": "answer", ...}` as `IdentityQueue.give` takes it, or `{"do": "leave"}`; raises Refused."""
        with self._news:
            if request.get("do") == "leave":
                self._is_left = True
            elif request.get("do") == "answer":
                try:
                    keep_answer(self._file, self._queue.give(request))
                except (IdentityAnswerError, OutputError) as error:
                    raise Refused(str(error)) from error
                self._update()
            else:
                raise Refused("no such thing to do")
            self._version += 1
            self._news.notify_all()

    def _update(self) -> None:
        questions = self._queue.questions()
        self._body = {
            "answers": len(self._queue.in_force),
            "changed": self._queue.changed,
            "left_over": len(questions),
            "questions": [self._shown(question) for question in questions[: self._most]],
        }

    def _shown(self, question: IdentityQuestion) -> dict[str, Any]:
        """A question with the boxes of all that it is about, around the doubtful frames."""
        ends = [candidate.frame for candidate in question.candidates if candidate.frame is not None]
        first, final = max(min(ends, default=question.frame) - AROUND, 0), question.frame + AROUND
        names = dict.fromkeys([question.target, *(candidate.target for candidate in question.candidates)])
        boxes = {
            path.target: _boxes_of(path, first, final)
            for path in self._queue.tracklets.paths
            if path.target in names
        }
        tracklets = self._queue.tracklets
        continued = tracklets.before(tracklets.starts[question.target, question.frame])
        return {
            "target": question.target,
            "frame": question.frame,
            "first": first,
            "last": final,
            "shown": question.shown,
            "swap": question.swap,
            "keep": continued is not None,
            "doubt": question.doubt,
            "candidates": [
                {"target": candidate.target, "probability": candidate.probability, "frame": candidate.frame}
                for candidate in question.candidates
            ],
            "boxes": boxes,
        }


def _boxes_of(path: TrackPath, first: int, final: int) -> list[list[float] | None]:
    """The corner boxes of a path in frames `first` to `final`, where it is shown."""
    boxes: list[list[float] | None] = [None] * (final - first + 1)
    low, high = np.searchsorted(path.frame, [first, final + 1]).tolist()
    for row in range(low, high):
        if path.shown[row]:
            x, y, w, h = path.boxes[row].tolist()
            boxes[int(path.frame[row]) - first] = [round(value, 1) for value in (x - w / 2, y - h / 2, w, h)]
    return boxes
