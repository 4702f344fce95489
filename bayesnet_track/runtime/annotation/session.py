"""A session: answers on the disk, the annotations that they give, and the question that is open."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from bayesnet_track.engine.starts import Start, StartError, check_box
from bayesnet_track.journal.writer import LineFile, output_error, write_atomically
from bayesnet_track.runtime.annotation.answers import (
    BEFORE,
    NAME,
    UNDO,
    Answer,
    AnswerError,
    AnswersFileError,
    Box,
    Header,
    append_answers,
    describe_mended,
    find_alike,
    first_difference,
    in_force,
    mend_names,
    read_answer,
    read_answers,
    write_answers,
)
from bayesnet_track.runtime.annotation.asking import (
    Annotations,
    Asking,
    BoxMark,
    FrameQuestion,
    Runs,
    TrackedBox,
    annotate_target,
    fail,
)
from bayesnet_track.runtime.annotation.formats.reading import Document
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.sources.entrances.notices import few, notice


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
    file: LineFile
    answers: list[Answer] = field(default_factory=list)
    annotations: Annotations = field(default_factory=Annotations)
    version: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _is_closed: bool = False

    def give(self, message: Mapping[str, Any]) -> None:
        """Take an answer, or an undo; raises AnswerError, or OutputError where it cannot be kept."""
        video = self.header.video
        if message.get("kind") == "correct" and "box" not in message:
            message = {**message, "box": self._shown(message)}
        answer = read_answer(message, video.frames, video.width, video.height)
        with self._lock:
            standing = in_force(self.answers)
            if answer == UNDO and not standing:
                raise AnswerError("there is no answer to take back")
            fault = (
                None if answer.box is None else describe_untrackable(answer.box, video, self.header.max_side)
            )
            if fault is not None:
                raise AnswerError(fault)
            if answer.kind == "gone" and not any(previous.target == answer.target for previous in standing):
                raise AnswerError(f"{answer.target} has no box yet")
            self._keep([answer])

    def give_new(self, answers: Iterable[Answer], place: str) -> None:
        """Take answers of another tool's file, `place`, where nobody has answered before; raises OutputError.

        Names that no target can have are mended. What is not used, or not as it stands there, is said.
        """
        imported = list(answers)
        with self._lock:
            recorded = {(answer.target, answer.frame): answer for answer in self.answers if answer != UNDO}
            targets, of_target = {target for target, _ in recorded}, by_target(imported)

            def is_others(name: str, name_in_session: str) -> bool:
                """Unless the target came by that name out of the same file before."""
                same = (
                    recorded.get((name_in_session, answer.frame)) == replace(answer, target=name_in_session)
                    for answer in of_target[name]
                )
                return name_in_session in targets and not any(same)

            mended = mend_names(of_target, is_others)
            if mended:
                notice(f"{place}: {describe_mended(mended)}")
            imported = [
                replace(answer, target=mended.get(answer.target, answer.target)) for answer in imported
            ]
            _notice_unused(place, imported, recorded)
            for answer, lookalike in find_alike(
                [*(key[0] for key in recorded), *(answer.target for answer in imported)]
            ):
                notice(f"{place}: {answer!r} and {lookalike!r} look alike and are two targets")
            self._keep([answer for answer in imported if (answer.target, answer.frame) not in recorded])

    def update(self, runs: Runs, hear: Callable[[str, int], None] = lambda target, frame: None) -> bool:
        """Track what the answers ask for; False where another answer came meanwhile: then nothing changed.

        A target that cannot be tracked is asked about, and the others are tracked. `hear` is told target and
        frame while it tracks.
        """
        with self._lock:
            version, answers = self.version, by_target(in_force(self.answers))

        def is_stale() -> bool:
            return self.version != version or self._is_closed

        marks: dict[str, Mapping[int, BoxMark]] = {}
        questions = []
        try:
            for target, of_target in answers.items():
                watched = _Watched(runs, is_stale, partial(hear, target), of_target[0].frame)
                marks[target], question = self._track(target, of_target, watched)
                questions += [] if question is None else [question]
        except _StaleError:
            return False
        with self._lock:
            if is_stale():
                return False
            self.annotations = Annotations(marks, tuple(questions))
            return True

    def _track(
        self, target: str, of_target: Sequence[Answer], watched: _Watched
    ) -> tuple[Mapping[int, BoxMark], FrameQuestion | None]:
        """The marks of a target and what is asked about it: where it fails, the given ones, and why."""
        video, max_side = self.header.video, self.header.max_side
        for answer in of_target:
            fault = None if answer.box is None else describe_untrackable(answer.box, video, max_side)
            if fault is not None:
                return fail(target, of_target, answer.frame, f"{fault}; give another box, or `gone`")
        try:
            asking = Asking(self.header.threshold, self.header.patience)
            return annotate_target(target, of_target, watched, self.frames, asking)
        except _StaleError:
            raise
        except Exception as error:
            reason = str(error) if isinstance(error, StartError) else f"{type(error).__name__}: {error}"
            return fail(target, of_target, watched.frame, reason)

    def close(self) -> None:
        """Write no more, and take nothing from what is still being tracked."""
        with self._lock:
            self._is_closed = True
            self.file.close()

    @property
    def frames(self) -> int:
        """Frames of the video."""
        return self.header.video.frames

    @property
    def document(self) -> Document:
        """The annotations, for writing."""
        return Document(self.header.video, self.annotations.marks)

    def _shown(self, message: Mapping[str, Any]) -> Box:
        target, frame = message.get("target"), message.get("frame")
        mark: BoxMark | None = None
        if isinstance(target, str) and isinstance(frame, int):
            mark = self.annotations.marks.get(target, {}).get(frame)
        if mark is None or mark.box is None:
            raise AnswerError(f"frame {frame} shows no box of {target} to confirm")
        return mark.box

    def _keep(self, answers: list[Answer]) -> None:
        append_answers(self.file, answers)
        self.answers += answers
        self.version += 1


def open_session(folder: Path, header: Header) -> tuple[Session, str | None]:
    """The session of a folder: a new one, or the one that it holds, and what was different when it began.

    What was torn by a crash, or cannot be the name of a target, is mended in the file and said; the file as
    it was stays beside it.

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
        write_answers(path, header)
        return Session(path, header, LineFile(path, after=path.stat().st_size)), None
    stored = read_answers(path)
    difference = first_difference(stored.header, header)
    if difference is not None and difference.startswith("another video"):
        raise AnswersFileError(f"{path}: {difference}; give the video of these answers, or another folder")
    if stored.mended:
        write_atomically(folder / BEFORE, path.read_bytes())
        for sentence in stored.mended:
            notice(f"{sentence}; the file as it was is {folder / BEFORE}")
    if stored.mended or not stored.is_whole:
        write_answers(path, stored.header, stored.answers)
    file = LineFile(path, after=path.stat().st_size)
    return Session(path, header, file, list(stored.answers), version=1), difference


def _notice_unused(
    place: str, imported: Sequence[Answer], recorded: Mapping[tuple[str, int], Answer]
) -> None:
    """Say what of an import is not used: other boxes where there is an answer, all but the last of two."""
    contradicted = [
        answer
        for answer in imported
        if (answer.target, answer.frame) in recorded and recorded[answer.target, answer.frame] != answer
    ]
    if contradicted:
        places = few([f"{answer.target} in frame {answer.frame}" for answer in contradicted])
        notice(
            f"{place}: {len(contradicted)} of {len(imported)} boxes are not used, "
            f"the session has other answers: {places}"
        )
    newest = {(answer.target, answer.frame): answer for answer in imported if answer.box is not None}
    twice = [
        answer
        for answer in imported
        if answer.box is not None and newest[answer.target, answer.frame].box != answer.box
    ]
    if twice:
        places = few([f"{answer.target} in frame {answer.frame}" for answer in twice])
        notice(f"{place}: {len(twice)} of {len(imported)} boxes are not used, another one follows: {places}")


class _StaleError(Exception):
    pass


@dataclass
class _Watched:
    """Runs that say how far they are.

    Attributes:
        frame: the one that was asked for last.
    """

    runs: Runs
    is_stale: Callable[[], bool]
    hear: Callable[[int], None]
    frame: int

    def at(self, start: int, box: Box, frame: int) -> TrackedBox:
        if self.is_stale():
            raise _StaleError
        self.frame = frame
        self.hear(frame)
        return self.runs.at(start, box, frame)


def by_target(answers: Iterable[Answer]) -> dict[str, tuple[Answer, ...]]:
    """Target -> its answers by frame, the last of a frame; targets in the order in which they came."""
    frames: dict[str, dict[int, Answer]] = {}
    for answer in answers:
        frames.setdefault(answer.target, {})[answer.frame] = answer
    return {
        target: tuple(of_target[frame] for frame in sorted(of_target)) for target, of_target in frames.items()
    }


def describe_untrackable(box: Box, video: Video, max_side: int | None = None) -> str | None:
    """The reason why a tracker refuses to start from the box in a frame of the video; None if it does not.

    >>> describe_untrackable((10, 10, 0.5, 20), Video("a.mp4", 9, 320, 240, 0.04))
    'start box 10,10,0.5,20: width and height must be at least 1 px'
    """
    try:
        check_box(box, video.width, video.height)
        Resizing.to(video.width, video.height, max_side).start(Start(box))
    except StartError as error:
        return str(error)
    return None
