"""Pictures of a reader and their time: nominal interval and gaps, the end, and every K-th picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.events.runs import OUTDATED
from bayesnet_track.observation.planes import Depth
from bayesnet_track.sources.paths import SourceError

DEFAULT_RATE = Fraction(25)
FEW_STEPS = 8
_CONSTANT_SHARE = 0.9
_MAX_SNAP = 0.25


@dataclass(frozen=True)
class Timing:
    """Conversion of a stream's time stamps to times in nominal frame intervals.

    Attributes:
        tick: seconds of one unit of a time stamp (the stream's time base).
        interval: nominal frame interval in seconds.
        gap_from: steps of this many intervals or more count as a gap.
        is_constant: whether nine in ten steps have the nominal length.
    """

    tick: Fraction
    interval: Fraction
    gap_from: float
    is_constant: bool

    @property
    def interval_s(self) -> float:
        """The nominal frame interval in seconds."""
        return float(self.interval)

    def intervals(self, ticks: int) -> float:
        """Time of a stamp, `ticks` after the origin, in intervals.

        A time within the stamps' rounding of a whole number is that number.

        >>> Timing(Fraction(1, 1000), Fraction(1, 30), 1.5, True).intervals(67)
        2.0
        """
        exact = ticks * self.tick / self.interval
        nearest = round(exact)
        return (
            float(nearest)
            if abs(exact - nearest) <= min(float(self.tick / self.interval), _MAX_SNAP)
            else float(exact)
        )


@dataclass(frozen=True)
class Declared:
    """Length that a container declares.

    Attributes:
        frames: number of frames, or None.
        duration_s: seconds, or None.
        slack_s: how much a whole file may fall short of `duration_s`.
        from_zero: whether the duration counts from time 0 (Matroska) or from the first picture.
    """

    frames: int | None
    duration_s: float | None
    slack_s: float
    from_zero: bool = False


def timing_of(stream: Any, stamps: Sequence[int]) -> Timing:
    """The timing of a stream from the sorted stamps of its first packets (may be empty).

    The nominal interval is the median step. Stamps are rounded to ticks, so where a rate that the stream
    declares agrees with the median to one tick, that rate is taken, else the mean of the steps within one
    tick of the median. A step counts as a gap from 1.5 times the 95 % quantile of the steps on: 1.5 intervals
    at a constant rate, more where the rate varies.
    """
    tick = Fraction(stream.time_base or Fraction(1, 1000))
    rates = (stream.guessed_rate, stream.average_rate, stream.base_rate)
    # An unknown rate is None or, from PyAV 19, the untrue 0/0.
    declared = [1 / Fraction(rate) for rate in rates if rate and rate > 0]
    steps = sorted(later - earlier for earlier, later in pairwise(stamps) if later > earlier)
    # A cut through reordered pictures leaves holes among the last stamps, so few of them prove little.
    if len(steps) < FEW_STEPS:
        likely = [interval for interval in declared if not steps or 8 * interval >= steps[0] * tick]
        if likely or not steps:
            return Timing(tick, likely[0] if likely else 1 / DEFAULT_RATE, 1.5, True)
    median = steps[(len(steps) - 1) // 2]
    close_steps = [step for step in steps if abs(step - median) <= 1]
    agreeing = [interval for interval in declared if abs(interval - median * tick) <= tick]
    interval = agreeing[0] if agreeing else Fraction(sum(close_steps), len(close_steps)) * tick
    tolerance = max(1.0, 0.1 * median)
    constant = sum(abs(step - median) <= tolerance for step in steps) >= _CONSTANT_SHARE * len(steps)
    long_step = steps[min(int(0.95 * len(steps)), len(steps) - 1)] * tick / interval
    return Timing(tick, interval, 1.5 if constant else max(1.5, 1.5 * float(long_step)), constant)


def declared_by(container: Any, stream: Any, timing: Timing) -> Declared:
    """Length that the container declares: its number of frames, else its duration (MP4 and MKV).

    Other containers declare nothing: FFmpeg's duration of them is a guess from what is there.
    """
    slack = (0.75 if timing.is_constant else timing.gap_from) * timing.interval_s
    tagged = _seconds(stream.metadata.get("DURATION", ""))
    if stream.duration is not None and stream.duration > 0:
        duration: float | None = float(stream.duration * timing.tick)
    elif tagged is not None:
        duration = tagged
    elif container.duration is not None and container.duration > 0:
        duration = container.duration / 1e6
        # Sound may last longer. A second stream of pictures is often one made up by damage.
        slack += 1.0 if any(other_stream.type != "video" for other_stream in container.streams) else 0.0
    else:
        duration = None
    if stream.frames > 0:
        return Declared(int(stream.frames), duration, slack)
    formats = set(container.format.name.split(","))
    if duration is None or not {"matroska", "mov"} & formats:
        return Declared(None, None, slack)
    frames = round(duration / timing.interval_s) if timing.is_constant else None
    return Declared(frames, duration, slack, "matroska" in formats)


def _seconds(text: str) -> float | None:
    """Seconds of an ``HH:MM:SS.fff`` text; None when it is something else or 0."""
    try:
        hours, minutes, seconds = (float(part) for part in text.split(":"))
    except ValueError:
        return None
    total = 3600 * hours + 60 * minutes + seconds
    return total if 0 < total < 1e9 else None


SEGMENTED = frozenset({"hls", "dash"})
"""FFmpeg's demuxers of playlists: pictures come by the segment, some seconds of them at once."""

WITHOUT_RATE = frozenset({"mpjpeg", "mjpeg"})
"""FFmpeg's demuxers that say 25 pictures a second, whatever comes."""


@dataclass(frozen=True)
class Flow:
    """Arrival of a network source's pictures.

    Attributes:
        endless: why it seems to have no end, or None where it has one.
        is_sure: whether nothing else could be meant by that.
        in_segments: whether they come some seconds at once.
        has_rate: whether the source says how many come in a second.
    """

    endless: str | None = None
    is_sure: bool = True
    in_segments: bool = False
    has_rate: bool = True


def flow_of(container: Any, stream: Any) -> Flow:
    """The flow of what PyAV has opened over the network.

    A multipart stream and a playlist that may still grow have no end. Anything else without a length in
    bytes, frames or seconds may have one that the server does not tell.
    """
    names = set(container.format.name.split(","))
    in_segments, has_rate = bool(names & SEGMENTED), not names & WITHOUT_RATE
    if "mpjpeg" in names:
        return Flow("a multipart stream of images", True, in_segments, has_rate)
    lengths = (container.duration, stream.duration, stream.frames)
    if any(length is not None and length > 0 for length in lengths):
        return Flow(None, True, in_segments, has_rate)
    if in_segments:
        return Flow("a playlist without an end", True, in_segments, has_rate)
    if container.size is None or container.size < 0:  # None from PyAV 19 on
        return Flow("the server declares no length", False, in_segments, has_rate)
    return Flow(None, True, in_segments, has_rate)


Pixels = Callable[[], tuple[NDArray[np.uint8], bool]]

Size = tuple[int, int]
"""Width and height, px."""


class Decoded(Protocol):
    """A picture as a decoder left it, from which pixels of its own size, or fewer, are made."""

    @property
    def size(self) -> Size:
        """Width and height, upright."""

    @property
    def has_color(self) -> bool:
        """False where its three channels would be copies."""

    def pixels(self, size: Size) -> NDArray[np.uint8]:
        """(H, W, 3) uint8 BGR of that size, no larger than its own; raises PictureError."""


@dataclass(frozen=True, eq=False)
class Picture:
    """One picture of a reader.

    Attributes:
        index: its number, from 0.
        time: its time in nominal frame intervals.
        time_s: the same in seconds.
        pixels: gives ((H, W, 3) uint8 BGR, has_color) when asked; raises PictureError.
        skipped: how many before it were dropped, since something newer was there.
        decoded: the picture itself, where its pixels can be made smaller than they are stored.
        complete: makes of these pixels the frame's own and its depth, where the source has depth; raises
            PictureError.
    """

    index: int
    time: float
    time_s: float
    pixels: Pixels
    complete: Callable[[NDArray[np.uint8]], tuple[NDArray[np.uint8], Depth]] | None = None
    skipped: int = 0
    decoded: Decoded | None = None


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


class Strided:
    """The pictures of a reader whose number is `start`, `start` + `stride`, ...; others are not converted.

    Pictures that are left out count as skipped, so that they are not missing.

    Raises:
        SourceError: the reader is live: it leaves out what there is no time for.
    """

    def __init__(self, text: str, reader: Reader, start: int, stride: int) -> None:
        if stride < 1:
            raise SourceError(text, f"stride {stride}", "a whole number from 1 on", "give another stride")
        if getattr(reader, "is_live", False):
            raise SourceError(
                text,
                "a live source with a stride",
                "a stride with files",
                "leave it out: a live source drops the frames that there is no time for",
            )
        self._reader, self._start, self.stride = reader, start, stride
        self.declared_frames, self.frame_interval_s = reader.declared_frames, reader.frame_interval_s
        self.gap_from = reader.gap_from

    def __iter__(self) -> Iterator[ReaderItem]:
        for item in self._reader:
            if not isinstance(item, Picture):
                yield item
            elif item.index >= self._start and (item.index - self._start) % self.stride == 0:
                yield replace(item, skipped=item.skipped + self.stride - 1)

    def close(self) -> None:
        """Let go of the files."""
        self._reader.close()


def strided(text: str, reader: Reader, start: int | None, stride: int) -> Reader:
    """The reader itself where `stride` is 1; otherwise as `Strided`, closed where that is refused."""
    if stride == 1:
        return reader
    try:
        return Strided(text, reader, start or 0, stride)
    except SourceError:
        reader.close()
        raise
