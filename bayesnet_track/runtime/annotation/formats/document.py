"""What every format is written from and read to, and how a file is refused that does not fit the video."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from bayesnet_track.runtime.annotation.answers import Answer, AnswerError, Box, read_box
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.runtime.annotation.fusing import Mark

Marks = Mapping[str, Mapping[int, Mark]]


class MismatchError(ValueError):
    """A file that does not fit the video; the first mismatch: where, what was found, what is needed."""


@dataclass(frozen=True)
class Document:
    """Annotations of a video: target -> frame -> mark."""

    video: Video
    marks: Marks

    @property
    def labels(self) -> dict[str, int]:
        """Label -> number from 1, in the order in which targets came."""
        names = dict.fromkeys(map(label_of, self.marks))
        return {name: number for number, name in enumerate(names, 1)}

    def boxes(self) -> Iterator[tuple[int, str, Mark, Box]]:
        """Number of the target from 1, its name, mark and box, by target and frame."""
        for number, (target, own) in enumerate(self.marks.items(), 1):
            for frame in sorted(own):
                box = own[frame].box
                if box is not None:
                    yield number, target, own[frame], box


def label_of(target: str) -> str:
    """What a target is: its name without the number at its end ("ball 2" is a ball)."""
    return re.sub(r"[ _#-]*\d+$", "", target) or "target"


def number_names(labels: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Key of a target in a file -> its name here, from (key, label): "ball 1", "ball 2"."""
    counts: dict[str, int] = {}
    names = {}
    for key, label in labels:
        if key not in names:
            counts[label] = counts.get(label, 0) + 1
            names[key] = f"{label} {counts[label]}"
    return names


def given_box(frame: int, target: str, box: Iterable[float], video: Video, place: str) -> Answer:
    """A box of a file as an answer; raises MismatchError at `place`."""
    if not 0 <= frame < video.frames:
        raise MismatchError(
            f"{place}: frame {frame} (counted from 0); the video has frames 0 to {video.frames - 1}"
        )
    try:
        return Answer(
            "box", frame, target, read_box([float(value) for value in box], video.width, video.height)
        )
    except (AnswerError, ValueError, TypeError) as error:
        raise MismatchError(f"{place}: {error}") from error


def check_size(width: object, height: object, video: Video, place: str) -> None:
    """Refuse frames of another size; raises MismatchError."""
    if (width, height) != (video.width, video.height):
        raise MismatchError(
            f"{place}: frames of {width}x{height} px; the video has {video.width}x{video.height} px"
        )


def check_frames(frames: object, video: Video, place: str) -> None:
    """Refuse another number of frames; raises MismatchError."""
    if frames != video.frames:
        raise MismatchError(f"{place}: {frames} frames; the video has {video.frames}")


def tidy(value: float, digits: int = 3) -> float:
    """Rounded, without a negative zero."""
    return round(value, digits) + 0.0
