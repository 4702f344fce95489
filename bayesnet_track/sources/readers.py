"""What readers of images, videos and cameras give: raw pictures, and what was wrong with the source."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.events.runs import OUTDATED
from bayesnet_track.observation.planes import Depth

Pixels = Callable[[], tuple[NDArray[np.uint8], bool]]


@dataclass(frozen=True, eq=False)
class Picture:
    """One picture of a reader.

    Attributes:
        index: its number, from 0.
        time: its time in nominal frame intervals.
        time_s: the same in seconds.
        pixels: gives ((H, W, 3) uint8 BGR, has_color) when asked; raises PictureError.
        skipped: how many before it were dropped, since something newer was there.
        complete: makes of these pixels the frame's own and its depth, where the source has depth; raises
            PictureError.
    """

    index: int
    time: float
    time_s: float
    pixels: Pixels
    complete: Callable[[NDArray[np.uint8]], tuple[NDArray[np.uint8], Depth]] | None = None
    skipped: int = 0


@dataclass(frozen=True)
class Damage:
    """Something a reader could not read.

    Attributes:
        index: number of the next picture.
        reason: what the decoder said.
        truncated: True when the source ends before its declared end.
    """

    index: int
    reason: str
    truncated: bool = False


@dataclass(frozen=True)
class Dropped:
    """Pictures of a live source that were dropped since this was last told.

    Attributes:
        index: number of the next picture.
        pictures: how many.
        reason: why.
    """

    index: int
    pictures: int
    reason: str = OUTDATED


@dataclass(frozen=True)
class Stalled:
    """A live source gave no picture for a while, and is connected to anew.

    Attributes:
        index: number of the next picture.
        seconds: since the last picture.
        reason: what was wrong.
        attempt: how often it has been tried since the last picture, this time included.
    """

    index: int
    seconds: float
    reason: str
    attempt: int


ReaderItem = Picture | Damage | Dropped | Stalled


class Reader(Protocol):
    """Raw pictures in order."""

    @property
    def declared_frames(self) -> int | None:
        """Number of frames that the source declares, or None."""

    @property
    def frame_interval_s(self) -> float:
        """Nominal seconds between frames."""

    @property
    def gap_from(self) -> float:
        """Steps of time from this length on, in nominal intervals, count as a gap."""

    def __iter__(self) -> Iterator[ReaderItem]: ...

    def close(self) -> None:
        """Let go of files and devices."""
