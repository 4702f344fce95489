"""A live network stream as a source, decoded by PyAV."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Protocol

from bayesnet_track.observation.image_headers import PictureError
from bayesnet_track.sources.frames import Damage, Picture, Reader
from bayesnet_track.sources.live import Image, LiveReader, Unreadable
from bayesnet_track.sources.timing import Flow

MOST_AHEAD_S = 5.0
"""Times of a playlist that jump by more than this are those of another recording, which begins now."""


class FlowingReader(Reader, Protocol):
    """A reader that knows how its pictures come."""

    @property
    def flow(self) -> Flow:
        """How they come."""


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
        now = time.monotonic()
        ahead = MOST_AHEAD_S if self._zero is None else self._zero + time_s - now
        if abs(ahead) < MOST_AHEAD_S:
            self._is_cancelled.wait(max(ahead, 0.0))
        else:
            self._zero = now - time_s

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
