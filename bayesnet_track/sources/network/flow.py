"""How the pictures of a network source come, and whether they have an end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

SEGMENTED = frozenset({"hls", "dash"})
"""FFmpeg's demuxers of playlists: pictures come by the segment, some seconds of them at once."""

WITHOUT_RATE = frozenset({"mpjpeg", "mjpeg"})
"""FFmpeg's demuxers that say 25 pictures a second, whatever comes."""


@dataclass(frozen=True)
class Flow:
    """How the pictures of a network source come.

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
