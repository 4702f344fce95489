"""A session: answers on the disk, the annotations that they give, and the question that is open."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from bayesnet_track.journal.writer import output_error
from bayesnet_track.runtime.annotation.answers import (
    UNDO,
    Answer,
    AnswerError,
    Box,
    by_target,
    in_force,
    read_answer,
)
from bayesnet_track.runtime.annotation.answers_file import (
    NAME,
    AnswersFileError,
    Header,
    append_answers,
    first_difference,
    read_answers,
    write_header,
)
from bayesnet_track.runtime.annotation.asking import Annotations, Asking, annotate
from bayesnet_track.runtime.annotation.formats.document import Document
from bayesnet_track.runtime.annotation.tracked import Found, Runs


@dataclass
class Session:
    """The answers of one video, on the disk as soon as they are given. Called from several threads.

    What is tracked is a function of the answers alone, so that a session that is gone on with days later
    has the same annotations as one that was never left.

    Attributes:
        annotations: of the answers that `update` has looked at.
        version: counts the answers that were given or taken back.
    """

    path: Path
    header: Header
    answers: list[Answer] = field(default_factory=list)
    annotations: Annotations = field(default_factory=Annotations)
    version: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def give(self, given: Mapping[str, Any]) -> None:
        """Take an answer, or an undo; raises AnswerError, or OutputError where it cannot be kept."""
        video = self.header.video
        if given.get("kind") == "correct" and "box" not in given:
            given = {**given, "box": self._shown(given)}
        answer = read_answer(given, video.frames, video.width, video.height)
        with self._lock:
            kept = in_force(self.answers)
            if answer == UNDO and not kept:
                raise AnswerError("there is no answer to take back")
            if answer.kind == "gone" and not any(one.target == answer.target for one in kept):
                raise AnswerError(f"{answer.target} has no box yet")
            self._keep([answer])

    def give_new(self, answers: Iterable[Answer]) -> None:
        """Take answers of another tool's file, where nobody has answered before; raises OutputError."""
        with self._lock:
            known = {(one.target, one.frame) for one in self.answers}
            self._keep([one for one in answers if (one.target, one.frame) not in known])

    def update(self, runs: Runs, notice: Callable[[str, int], None] = lambda target, frame: None) -> bool:
        """Track what the answers ask for; False where another answer came meanwhile: then nothing changed.

        `notice` is told target and frame while it tracks.
        """
        with self._lock:
            version, answers = self.version, by_target(in_force(self.answers))

        def is_stale() -> bool:
            return self.version != version

        try:
            asking = Asking(self.header.threshold, self.header.patience)
            found = []
            for target, own in answers.items():
                watched = _Watched(runs, is_stale, partial(notice, target))
                found.append(annotate({target: own}, watched, self.frames, asking))
        except _StaleError:
            return False
        with self._lock:
            if is_stale():
                return False
            marks = {target: own for one in found for target, own in one.marks.items()}
            self.annotations = Annotations(marks, tuple(q for one in found for q in one.questions))
            return True

    @property
    def frames(self) -> int:
        """Frames of the video."""
        return self.header.video.frames

    @property
    def document(self) -> Document:
        """The annotations, for writing."""
        return Document(self.header.video, self.annotations.marks)

    def _shown(self, given: Mapping[str, Any]) -> Box:
        mark = self.annotations.marks.get(str(given.get("target")), {}).get(given.get("frame", -1))
        if mark is None or mark.box is None:
            raise AnswerError(f"frame {given.get('frame')} shows no box of {given.get('target')} to confirm")
        return mark.box

    def _keep(self, answers: list[Answer]) -> None:
        append_answers(self.path, answers)
        self.answers += answers
        self.version += 1


def open_session(folder: Path, header: Header) -> tuple[Session, str | None]:
    """The session of a folder: a new one, or the one that it holds, and what was different when it began.

    Raises:
        AnswersFileError: the answers were given to another video, or are damaged.
        OutputError: the folder cannot be made or written.
    """
    path = folder / NAME
    try:
        folder.mkdir(parents=True, exist_ok=True)
        is_there = path.is_file() and path.stat().st_size > 0
    except OSError as error:
        raise output_error(folder, error) from error
    if not is_there:
        write_header(path, header)
        return Session(path, header), None
    kept, answers = read_answers(path)
    difference = first_difference(kept, header)
    if difference is not None and difference.startswith("another video"):
        raise AnswersFileError(f"{path}: {difference}; give the video of these answers, or another folder")
    return Session(path, header, answers, version=1), difference


class _StaleError(Exception):
    pass


@dataclass(frozen=True)
class _Watched:
    runs: Runs
    is_stale: Callable[[], bool]
    notice: Callable[[int], None]

    def at(self, start: int, box: Box, frame: int) -> Found:
        if self.is_stale():
            raise _StaleError
        self.notice(frame)
        return self.runs.at(start, box, frame)
