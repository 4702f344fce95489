"""A live network stream (RTSP) as a source, decoded by PyAV."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from bayesnet_track.observation.image_size import PictureError
from bayesnet_track.sources.live import Image, LiveReader
from bayesnet_track.sources.readers import Damage, Picture, Reader


class Open(Protocol):
    """Opens the stream; raises SourceError."""

    def __call__(self) -> Reader: ...


class Stream:
    """The pictures of a reader as they come; what is damaged is left out, and is the reason if it ends."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader

    def __iter__(self) -> Iterator[Image]:
        reason = "the stream ended"
        for item in self._reader:
            if isinstance(item, Damage):
                reason = item.reason
            elif isinstance(item, Picture):
                try:
                    yield item.pixels()
                except PictureError as error:
                    reason = str(error)
        raise OSError(reason)

    def cancel(self) -> None:
        """Wake the thread that reads, where that can be done from another one."""
        cancel = getattr(self._reader, "cancel", None)
        if cancel is not None:
            cancel()

    def close(self) -> None:
        """Let go of the connection."""
        self._reader.close()


def stream_reader(connect: Open) -> LiveReader:
    """The newest pictures of a live stream; raises what `connect` raises."""
    first = connect()
    return LiveReader(lambda: Stream(connect()), first.frame_interval_s, Stream(first))
