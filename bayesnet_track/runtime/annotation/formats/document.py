"""What every format is written from, and how a file is refused that does not fit the video."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath

from bayesnet_track.runtime.annotation.answers import Box
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.runtime.annotation.fusing import Mark

Marks = Mapping[str, Mapping[int, Mark]]


class MismatchError(ValueError):
    """A file that does not fit the video; the first mismatch: where, what was found, what is needed."""


@dataclass(frozen=True)
class Document:
    """Annotations of a video: target -> frame -> mark.

    Attributes:
        images: names of the files that the frames come from; empty where they are not image files.
    """

    video: Video
    marks: Marks
    images: Sequence[str] = ()

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

    def image(self, frame: int) -> str:
        """The file name of a frame: that of its source, or else its number."""
        return self.images[frame] if self.images else f"{frame:06d}.jpg"

    def image_stem(self, frame: int) -> str:
        """The same without its suffix; the number where two images differ in nothing but that."""
        stems = {PurePath(name).stem for name in self.images}
        return PurePath(self.image(frame)).stem if len(stems) == len(self.images) else f"{frame:06d}"


def label_of(target: str) -> str:
    """What a target is: its name without the number at its end ("ball 2" is a ball)."""
    return re.sub(r"[ _#-]*\d+$", "", target) or "target"


def check_size(width: object, height: object, video: Video, place: str) -> None:
    """Refuse frames of another size; raises MismatchError."""
    if (width, height) != (video.width, video.height):
        raise MismatchError(
            f"{place}: frames of {width}x{height} px; the video has {video.width}x{video.height} px"
        )


def tidy(value: float, digits: int = 3) -> float:
    """Rounded, without a negative zero."""
    return round(value, digits) + 0.0
