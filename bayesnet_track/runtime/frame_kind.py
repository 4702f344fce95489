"""What all frames of a run, or of a tracker, have in common."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

from bayesnet_track.journal.text.wording import plural
from bayesnet_track.observation.planes import Frame


@dataclass(frozen=True)
class FrameKind:
    """Size, colour and pixels of a frame.

    Attributes:
        width: columns.
        height: rows.
        has_color: whether it has colour; None for either.
        channels: values per pixel.
        dtype: name of their type.
    """

    width: int
    height: int
    has_color: bool | None
    channels: int
    dtype: str

    @classmethod
    def of(cls, frame: Frame) -> Self:
        """That of a frame."""
        image = frame.image
        channels = image.shape[2] if image.ndim == 3 else 1
        return cls(frame.width, frame.height, frame.has_color, channels, image.dtype.name)

    @property
    def of_either_color(self) -> Self:
        """The same, whether or not it has colour."""
        return replace(self, has_color=None)

    def __str__(self) -> str:
        """In words: "640x480 colour"."""
        shade = {True: " colour", False: " gray", None: ""}[self.has_color]
        is_usual = (self.channels, self.dtype) == (3, "uint8")
        pixels = "" if is_usual else f" with {plural(self.channels, 'channel')} of {self.dtype}"
        return f"{self.width}x{self.height}{shade}{pixels}"

    def check(self, frame: Frame, otherwise: str) -> None:
        """Refuse a frame of another kind; `otherwise` says what else can be done. Raises ValueError."""
        kind = FrameKind.of(frame)
        if (kind.of_either_color if self.has_color is None else kind) != self:
            raise ValueError(
                f"frame {frame.index} is {kind}, the frames before it are {self}; "
                f"bring it to their size and channels, or {otherwise}"
            )
