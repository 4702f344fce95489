"""The browser view of a session: tracks in a thread of its own, and serves the page that asks."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, Self

import cv2

from bayesnet_track.journal.writer import OutputError
from bayesnet_track.runtime.annotation.answers import AnswerError, in_force
from bayesnet_track.runtime.annotation.asking import BoxMark, Frames, Runs
from bayesnet_track.runtime.annotation.session import Session
from bayesnet_track.runtime.live_view.controls import Refused
from bayesnet_track.runtime.live_view.server import Server
from bayesnet_track.view.run_page import annotate_page

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
