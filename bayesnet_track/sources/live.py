"""Live sources, cameras and streams: a thread reads, the tracker takes the newest, a stall is waited out.

Pictures that come while the tracker is busy are dropped, so that what is tracked is never old. Times are
those of arrival, so that the belief is predicted over the true time between the pictures that are used. When
nothing comes for a while, the connection is given up and made again, after longer and longer pauses.
"""

from __future__ import annotations

import statistics
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.observation.image_files import PictureError
from bayesnet_track.sources.entrances.levels import Levels, ValueRange
from bayesnet_track.sources.paths import SourceError
from bayesnet_track.sources.timing import Damage, Dropped, Flow, Picture, Reader, ReaderItem, Stalled

STALL_S = 2.0
"""Seconds without a picture after which a connection counts as stalled."""

CONNECT_S = 10.0
"""Seconds that a new connection may take to its first picture."""

PAUSE_S, LONGEST_PAUSE_S = 0.5, 15.0
"""Pause before the second attempt in a row, which doubles up to the longest; the first has none."""

GIVE_UP_S = 120.0
"""Seconds without a picture after which the source has ended."""

TELL_S, SELDOM_S = 1.0, 60.0
"""Seconds between two notices of dropped pictures: the first, doubling up to the last."""

RATE_PICTURES, RATE_S, DEFAULT_RATE = 8, 1.5, 25.0
"""Pictures, and at most seconds, over which an undeclared rate is measured; what it is without them."""

Image = tuple[NDArray[np.uint8], bool]


@dataclass(frozen=True)
class Unreadable:
    """Pictures that came and cannot be used.

    Attributes:
        pictures: how many; 0 where that is not known yet.
        reason: what is wrong with them.
    """

    pictures: int
    reason: str


class _Connection(Protocol):
    """An open connection: pictures as ((H, W, 3) uint8 BGR, has_color), until it ends or breaks."""

    def __iter__(self) -> Iterator[Image | Unreadable]: ...

    def close(self) -> None:
        """Let go of the device or connection; called by the thread that reads it."""


class LiveReader:
    """The newest pictures of what `connect` opens, until nothing comes for `give_up_s`.

    Args:
        connect: opens it; raises where it cannot.
        first: what was opened already, or None.
        frame_interval_s: seconds between pictures, as the source says; measured where it is None.
        stall_s: seconds without a picture that count as a stall.
        connect_s: seconds that a new connection may take.
        give_up_s: seconds without a picture after which it has ended.
        pause_s: pause before the second attempt in a row, which then doubles.

    Attributes:
        counts_dropped: whether the index counts dropped pictures, too.
    """

    gap_from = 2.0
    declared_frames: int | None = None
    is_live = True

    def __init__(
        self,
        connect: Callable[[], _Connection],
        frame_interval_s: float | None,
        first: _Connection | None = None,
        *,
        stall_s: float = STALL_S,
        connect_s: float = CONNECT_S,
        give_up_s: float = GIVE_UP_S,
        pause_s: float = PAUSE_S,
    ) -> None:
        self.counts_dropped = True
        self._connect, self._stall_s, self._connect_s = connect, stall_s, connect_s
        self._give_up_s, self._pause_s = give_up_s, pause_s
        self._listener = _Listener(connect if first is None else lambda: first)
        self._is_closed, self._connecting = threading.Event(), threading.Lock()
        self.frame_interval_s = frame_interval_s or self._listener.measured_interval_s()

    def close(self) -> None:
        """Let go of it; a picture that is waited for is not waited for any more."""
        with self._connecting:
            self._is_closed.set()
            self._listener.abandon()

    def __iter__(self) -> Iterator[ReaderItem]:
        began: float | None = None
        last_moment = time.monotonic()
        index = attempts = 0
        outdated, unreadable, reported = _Drops(), _Drops(), ""
        while not self._is_closed.is_set():
            patience = self._stall_s if self._listener.taken else self._connect_s
            arrived = self._listener.take(patience)
            if arrived is not None:
                moment, skipped = arrived.moment, arrived.outdated + arrived.unreadable
                began = moment if began is None else began
                index += skipped if self.counts_dropped else 0
                if count := outdated.take_due(moment, arrived.outdated):
                    yield Dropped(index, count)
                if count := unreadable.take_due(moment, arrived.unreadable):
                    yield Dropped(index, count, arrived.fault)
                time_s = moment - began
                image = _getter_of(arrived.image)
                yield Picture(index, time_s / self.frame_interval_s, time_s, image, skipped=skipped)
                last_moment, attempts, index, reported = moment, 0, index + 1, ""
                continue
            waited = time.monotonic() - last_moment
            reason = self._listener.ending(patience)
            self._listener.abandon()
            if waited >= self._give_up_s:
                yield Damage(index, f"the source gave no picture for {waited:.0f} s: {reason}")
                return
            attempts += 1
            if reason != reported:  # while it stays the same, a line for each attempt says nothing new
                yield Stalled(index, waited, reason, attempts)
            reported = reason
            if attempts > 1:
                self._is_closed.wait(min(self._pause_s * 2.0 ** (attempts - 2), LONGEST_PAUSE_S))
            with self._connecting:
                if self._is_closed.is_set():
                    return
                self._listener = _Listener(self._connect)


@dataclass(frozen=True)
class _Arrival:
    """The newest picture, and how many before it were not taken: outdated ones, and unreadable ones."""

    moment: float
    image: Image
    outdated: int
    unreadable: int
    fault: str


class _Listener:
    """A thread that reads one connection and keeps its newest picture."""

    def __init__(self, connect: Callable[[], _Connection]) -> None:
        self.taken, self._reason = 0, ""
        self._unreadable, self._fault, self._is_faulty = 0, "", False
        self._moments: list[float] = []
        self._connect = connect
        self._news = threading.Condition()
        self._newest: tuple[float, Image] | None = None
        self._came = 0
        self._is_over = self._is_abandoned = False
        self._feed: _Connection | None = None
        # What hangs in a driver cannot be woken: such a thread is left alone, and ends with the process.
        threading.Thread(target=self._listen, name="live source", daemon=True).start()

    def measured_interval_s(self) -> float:
        """Seconds between the first pictures, at a whole rate from 2 a second on; these count as taken."""
        deadline = time.monotonic() + RATE_S
        with self._news:
            for count in range(1, RATE_PICTURES + 1):
                remaining = deadline - time.monotonic()
                self._news.wait_for(lambda: len(self._moments) >= count or self._is_over, remaining)  # noqa: B023
            steps = [later - earlier for earlier, later in pairwise(self._moments)]
            self.taken, self._unreadable = max(self._came - 1, 0), 0
        rate = 1.0 / max(statistics.median(steps), 1e-3) if steps else DEFAULT_RATE
        return 1.0 / (round(rate) if rate >= 2.0 else rate)

    def ending(self, patience_s: float) -> str:
        """Reason that no picture comes any more."""
        fault = f": {self._fault}" if self._is_faulty else ""
        return self._reason or f"no picture for {patience_s:g} s{fault}"

    def take(self, patience_s: float) -> _Arrival | None:
        """The newest picture; None when none comes."""
        with self._news:
            self._news.wait_for(lambda: self._newest is not None or self._is_over, patience_s)
            if self._newest is None:
                return None
            moment, image = self._newest
            arrival = _Arrival(moment, image, self._came - self.taken - 1, self._unreadable, self._fault)
            self._newest, self.taken, self._unreadable = None, self._came, 0
            return arrival

    def abandon(self) -> None:
        """Read no further; a wait between the pictures of a segment ends at once."""
        with self._news:
            self._is_abandoned = self._is_over = True
            self._news.notify_all()
            cancel = getattr(self._feed, "cancel", None)
        if cancel is not None:
            cancel()

    def _listen(self) -> None:
        reason = "the connection ended"
        try:
            feed = self._connect()
            with self._news:
                self._feed = feed
            try:
                for item in feed:
                    with self._news:
                        if self._is_abandoned:
                            return
                        self._accept(item)
            finally:
                with self._news:
                    self._feed = None
                feed.close()
        except Exception as error:  # whatever a driver says: the connection is made again
            reason = str(getattr(error, "found", None) or error or type(error).__name__)
        with self._news:
            self._reason, self._is_over = reason, True
            self._news.notify_all()

    def _accept(self, item: Image | Unreadable) -> None:
        if isinstance(item, Unreadable):
            self._unreadable += item.pictures
            self._fault, self._is_faulty = item.reason, True
            return
        self._is_faulty = False
        moment = time.monotonic()
        self._newest = moment, item
        self._came += 1
        if len(self._moments) < RATE_PICTURES:
            self._moments.append(moment)
        self._news.notify_all()


class _Drops:
    """Counts dropped pictures, and says when to tell of them: seldom, where it goes on."""

    def __init__(self) -> None:
        self._unreported, self._due, self._every_s = 0, 0.0, TELL_S

    def take_due(self, moment: float, dropped: int) -> int:
        """Number to report now; 0 when it is not the time, or there are none."""
        self._unreported += dropped
        if not self._unreported or moment < self._due:
            return 0
        count, self._unreported = self._unreported, 0
        self._due, self._every_s = moment + self._every_s, min(2.0 * self._every_s, SELDOM_S)
        return count


def _getter_of(image: Image) -> Any:
    return lambda: image


CAMERA_RATE = 30.0
MAX_INDEX = 2**31 - 1


class _Camera:
    """The pictures of the camera with this index, as they come.

    Raises:
        SourceError: there is no such camera.
    """

    def __init__(self, index: str, levels: Levels) -> None:
        import cv2

        self._levels = levels
        # OpenCV takes 32 bits, and Python reads no number of thousands of digits.
        number = int(index) if len(index) < len(str(MAX_INDEX)) else MAX_INDEX
        self._camera: Any = cv2.VideoCapture(number)
        if not self._camera.isOpened():
            raise SourceError(
                index,
                "no camera with this index can be opened",
                "index of a connected camera",
                "check the connection",
            )
        rate = float(self._camera.get(cv2.CAP_PROP_FPS))
        self.frame_interval_s = 1.0 / (rate if np.isfinite(rate) and rate > 0 else CAMERA_RATE)

    def __iter__(self) -> Iterator[Image]:
        while True:
            ok, image = self._camera.read()
            if not ok:
                raise OSError("the camera stopped giving pictures")
            yield self._levels(image)

    def close(self) -> None:
        """Let go of the camera."""
        self._camera.release()


def camera_reader(index: str, value_range: ValueRange | None = None) -> LiveReader:
    """The newest pictures of a camera, in units of the rate that it declares (else 30 a second).

    Raises:
        SourceError: there is no such camera.
    """
    levels = Levels(f"camera {index}", value_range)
    first = _Camera(index, levels)
    return LiveReader(lambda: _Camera(index, levels), first.frame_interval_s, first)


MAX_AHEAD_S = 5.0
"""Times of a playlist that jump by more than this are those of another recording, which begins now."""


class FlowingReader(Reader, Protocol):
    """A reader that knows how its pictures come."""

    @property
    def flow(self) -> Flow:
        """Flow of the pictures."""


class Open(Protocol):
    """Opens the stream; raises SourceError."""

    def __call__(self) -> FlowingReader: ...


class Stream:
    """The pictures of a reader as they come; what is damaged is left out, and is the reason if it ends.

    Pictures that come in segments are given at the pace of their own times: else all but the last of each
    would be outdated.
    """

    def __init__(self, reader: FlowingReader) -> None:
        self._reader = reader
        self._is_cancelled = threading.Event()
        self._zero: float | None = None

    def __iter__(self) -> Iterator[Image | Unreadable]:
        reason, expected = "the stream ended", 0
        for item in self._reader:
            if isinstance(item, Damage):
                reason = item.reason
                yield Unreadable(0, reason)
            elif isinstance(item, Picture):
                if item.index > expected:
                    yield Unreadable(item.index - expected, reason)
                expected = item.index + 1
                if self._reader.flow.in_segments:
                    self._keep_pace(item.time_s)
                try:
                    yield item.pixels()
                except PictureError as error:
                    reason = str(error)
                    yield Unreadable(1, reason)
        raise OSError(reason)

    def _keep_pace(self, time_s: float) -> None:
        clock_s = time.monotonic()
        lead_s = MAX_AHEAD_S if self._zero is None else self._zero + time_s - clock_s
        if abs(lead_s) < MAX_AHEAD_S:
            self._is_cancelled.wait(max(lead_s, 0.0))
        else:
            self._zero = clock_s - time_s

    def cancel(self) -> None:
        """Wake the thread that reads, where it waits for the time of a picture."""
        self._is_cancelled.set()

    def close(self) -> None:
        """Let go of the connection."""
        self._reader.close()


def stream_reader(connect: Open, first: FlowingReader | None = None) -> LiveReader:
    """The newest pictures of a live stream, where `first` is open already; raises what `connect` raises."""
    first = connect() if first is None else first
    interval_s = first.frame_interval_s if first.flow.has_rate else None
    return LiveReader(lambda: Stream(connect()), interval_s, Stream(first))
