"""The browser view of a session: tracks in a thread of its own, and serves the page that asks.

All formats by name, and the shortest of them, MOT.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2

from bayesnet_track.journal.writer import OutputError, output_error, write_atomically
from bayesnet_track.runtime.annotation.answers import Answer, AnswerError, in_force
from bayesnet_track.runtime.annotation.asking import BoxMark, Frames, Runs
from bayesnet_track.runtime.annotation.formats.cvat import as_cvat, read_cvat
from bayesnet_track.runtime.annotation.formats.json_formats import (
    annotations_as_coco,
    as_label_studio,
    read_coco,
    read_label_studio,
)
from bayesnet_track.runtime.annotation.formats.reading import (
    Document,
    MismatchError,
    annotations_in,
    read_json,
    text_of_file,
    unpacked_folder,
)
from bayesnet_track.runtime.annotation.formats.rows import Row, answers_of
from bayesnet_track.runtime.annotation.formats.yolo import as_yolo, read_yolo
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.runtime.annotation.session import Session
from bayesnet_track.runtime.live_view.controls import Refused
from bayesnet_track.runtime.live_view.server import Server
from bayesnet_track.sources.entrances.notices import few, heard, notice
from bayesnet_track.sources.entrances.text_lines import IMPORT, explain_json
from bayesnet_track.sources.mot_lines import MotLines, parse_mot
from bayesnet_track.view.run_page import annotate_page

NO_TRACK = -1
IGNORED = 0.0
"""The confidence of a box that is not to be scored: regions that are ignored, and other classes."""


def _as_mot(document: Document) -> bytes:
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
        lines = parse_mot(text_of_file(path), str(path))
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
    return [line.strip() or "target" for line in text_of_file(file).rstrip().split("\n")] if is_there else []


WRITERS: Mapping[str, Callable[[Document], Mapping[str, bytes]]] = {
    "coco": lambda document: {"coco.json": annotations_as_coco(document)},
    "mot": lambda document: {"mot.txt": _as_mot(document)},
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
    with unpacked_folder(path) as place:
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


WAIT_S = 3.0
"""Seconds that an answer to the page waits for news."""

PROGRESS_S = 0.2
LARGEST_SIDE = 1920
QUALITY = 90
SHORT = {"given": "g", "tracked": "t", "interpolated": "i", "gone": "x"}
UNKNOWN = "."


class AnnotationServer:
    """Serves the page of a session, and tracks what its answers ask for.

    Args:
        session: whose answers are shown and taken.
        frames: of the video.
        runs: of the tracker on them.
        out: where the annotations will be, for the page.
        host: address to listen at.
        port: port to listen at; None for a free one.

    Raises:
        OSError: the port is taken, or the host is not one of this machine.
    """

    def __init__(
        self,
        session: Session,
        frames: Frames,
        runs: Runs,
        out: str,
        host: str = "127.0.0.1",
        port: int | None = None,
    ) -> None:
        self._session, self._frames, self._runs, self._out = session, frames, runs, out
        self._news = threading.Condition()
        self._version = self._marks_version = 1
        self._done = -1
        self._busy: dict[str, Any] | None = None
        self._told = 0.0
        self._trouble = ""
        self._is_closed = self._is_left = False
        self._page = annotate_page()
        self._server = Server(self, host, port)
        self._worker = threading.Thread(target=self._work, name="annotate", daemon=True)
        self._worker.start()

    @property
    def address(self) -> str:
        """The address of the page, with its token."""
        return self._server.address

    def wait(self, give_up: Callable[[], bool]) -> None:
        """Until the person has left, and everything is tracked that was asked for; or until `give_up`."""
        while not give_up() and not (self._is_left and not self.is_behind):
            time.sleep(0.05)

    def close(self) -> None:
        """Serve and track no more."""
        with self._news:
            self._is_closed = True
            self._news.notify_all()
        self._server.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # What the server asks for.

    def page(self) -> tuple[bytes, str]:
        """The page, and its content security policy."""
        return self._page

    def feed(self, first: int, seen_version: int) -> bytes:
        """The state of the session; with the marks, unless the page has those of number `first`."""
        with self._news:
            self._news.wait_for(lambda: self._version != seen_version or self._is_closed, WAIT_S)
            annotations = self._session.annotations
            video = self._session.header.video
            answer: dict[str, Any] = {
                "version": self._version,
                "marks": self._marks_version,
                "busy": self._busy,
                "behind": self.is_behind,
                # Once, with the marks that it is of: the page keeps it until the person closes it.
                "trouble": "" if self._marks_version == first else self._trouble,
                "left": self._is_left,
                "answers": len(in_force(self._session.answers)),
                "about": {
                    "name": video.name,
                    "frames": video.frames,
                    "width": video.width,
                    "height": video.height,
                    "interval": video.frame_interval_s,
                    "threshold": self._session.header.threshold,
                    "graph": self._session.header.graph_name,
                    "out": self._out,
                },
                "questions": [
                    {"target": question.target, "frame": question.frame, "reason": question.reason}
                    for question in annotations.questions
                ],
            }
        if self._marks_version != first:
            answer["targets"] = [_row(name, marks, video.frames) for name, marks in annotations.marks.items()]
        return json.dumps(answer, allow_nan=False).encode()

    def picture(self, frame: int) -> tuple[int, bytes] | None:
        """A frame as JPEG, at most 1920 px wide or high."""
        frame = min(max(frame, 0), len(self._frames) - 1)
        image = self._frames.image(frame)
        scale = LARGEST_SIDE / max(image.shape[:2])
        if scale < 1.0:
            size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        is_encoded, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        return (frame, data.tobytes()) if is_encoded else None

    def ask(self, request: Mapping[str, Any]) -> None:
        """`{"do": "answer", ...}` with what `read_answer` takes, or `{"do": "leave"}`; raises Refused."""
        if request.get("do") == "leave":
            self._is_left = True
        elif request.get("do") == "answer":
            try:
                self._session.give(request)
            except (AnswerError, OutputError) as error:
                raise Refused(str(error)) from error
        else:
            raise Refused("no such thing to do")
        self._tell()

    @property
    def is_tracked(self) -> bool:
        """True if every answer is tracked."""
        return not (self.is_behind or self._trouble)

    @property
    def is_behind(self) -> bool:
        """True if an answer is not tracked yet."""
        return self._done != self._session.version

    def _tell(self) -> None:
        with self._news:
            self._version += 1
            self._news.notify_all()

    def _work(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self.is_behind or self._is_closed)
                if self._is_closed:
                    return
                version, self._trouble = self._session.version, ""
            try:
                is_done: bool | None = self._session.update(self._runs, self._notice)
                failed = self._session.annotations.failures if is_done else ()
                self._trouble = "; ".join(
                    f"{question.target}, frame {question.frame}: {question.reason}" for question in failed
                )
            except Exception as error:
                self._trouble = f"tracking failed: {type(error).__name__}: {error}"
                is_done = None
            with self._news:
                if is_done is not False:  # else there is another answer
                    self._done = version
                    self._marks_version += 1
                self._busy = None
            self._tell()

    def _notice(self, target: str, frame: int) -> None:
        if self._is_closed:
            raise SystemExit  # ends the thread alone
        now_s = time.monotonic()
        if now_s - self._told >= PROGRESS_S:
            self._told, self._busy = now_s, {"target": target, "frame": frame}
            self._tell()


def _row(name: str, of_target: Mapping[int, BoxMark], frames: int) -> dict[str, Any]:
    marks = [of_target.get(frame) for frame in range(frames)]
    return {
        "name": name,
        "how": "".join(UNKNOWN if mark is None else SHORT[mark.how] for mark in marks),
        "percent": [0 if mark is None else round(100 * mark.probability) for mark in marks],
        "boxes": [
            None if mark is None or mark.box is None else [round(value, 2) for value in mark.box]
            for mark in marks
        ],
    }
