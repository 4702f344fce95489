"""Opening a source of frames from the text a person gives: file, folder, glob, camera index or URL."""

from __future__ import annotations

import glob
import os
from pathlib import Path

from bayesnet_track.sources.frames import OnResize, Source, SourceItem
from bayesnet_track.sources.origin import Origin
from bayesnet_track.sources.paths import (
    _SCHEME,
    IMAGE_SUFFIXES,
    KINDS,
    SourceError,
    _in_folder,
    _matching,
    _nearest,
)
from bayesnet_track.sources.readers import Reader
from bayesnet_track.sources.stride import strided

__all__ = ["Source", "SourceError", "SourceItem", "open_source"]

LIVE_SCHEMES = frozenset({"rtsp", "rtsps"})
NETWORK_SCHEMES = frozenset({"http", "https", "rtsp", "rtsps"})


def open_source(
    text: str,
    start: int | None = None,
    end: int | None = None,
    allow_network: bool = False,
    on_resize: OnResize = "stop",
    isolate_decoder: bool = False,
    stride: int = 1,
) -> Source:
    """The source that `text` names.

    `start` and `end` are frame indices, from 0, `end` exclusive. URLs are opened only with `allow_network`;
    every other protocol (`concat:`, `subfile,`, `file:`, `pipe:`, ...) is refused. `on_resize` says what a
    change of frame size does: "stop" ends the source, "rescale" brings the picture to the first one's size.
    `isolate_decoder` decodes in a process of its own, held down by limits (`isolated.IsolatedReader`): the
    same frames, and a decoder that crashes, hangs or takes too much memory ends the source, not the program.
    With `stride` K only every K-th frame is handed out, from `start` on; numbers and times stay the source's.

    Raises:
        SourceError: nothing can be read there; says what was found, what is allowed and how to mend it.
    """
    check_range(text, start, end)
    reader = make_reader(text, allow_network, isolate_decoder, start or 0)
    reader = strided(text, reader, start, stride)
    origin = Origin(
        "plain",
        text,
        text,
        start,
        end,
        on_resize,
        allow_network,
        isolate_decoder=isolate_decoder,
        stride=stride,
    )
    return Source(text, reader, start, end, on_resize, origin)


def check_range(text: str, start: int | None, end: int | None) -> None:
    """Refuse a range without a frame; raises SourceError."""
    first = start or 0
    if first < 0 or (end is not None and end <= first):
        raise SourceError(
            text,
            f"start {start} and end {end} hold no frame",
            "0 <= start < end, counted from 0, end exclusive",
            "give another range",
        )


def make_reader(text: str, allow_network: bool, isolate: bool = False, start: int = 0) -> Reader:
    """The reader of what `text` names, as `open_source` takes it; raises SourceError.

    Pixels of pictures before `start` are not asked for.
    """
    if not text or "\0" in text:
        raise SourceError(text, "it is empty or holds a NUL", KINDS, "name a source")
    if text.isascii() and text.isdigit():
        if isolate:
            raise SourceError(text, "a camera decodes no file", "isolation of files and URLs", "leave it out")
        from bayesnet_track.sources.camera import camera_reader

        return camera_reader(text)
    path = Path(text)
    scheme = _SCHEME.match(text)
    if scheme:
        _check_scheme(text, scheme.group(1).lower(), allow_network)
        if scheme.group(1).lower() in LIVE_SCHEMES:
            from bayesnet_track.sources.stream import stream_reader

            return stream_reader(lambda: _video(text, True, isolate, 0))
        return _video(text, True, isolate, start)
    try:
        if path.is_dir():
            return _images(text, _in_folder(text, path), isolate, start)
        if path.is_file():
            if not os.access(path, os.R_OK):
                raise SourceError(text, "permission denied", KINDS, "make the file readable")
            if path.suffix.lower() in IMAGE_SUFFIXES:
                return _images(text, [path], isolate, start)
            return _video(text, False, isolate, start)
        if path.exists():
            raise SourceError(text, "it is neither a regular file nor a folder", KINDS, "give one of these")
    except PermissionError as error:
        raise SourceError(text, "permission denied", KINDS, "make it readable") from error
    except OSError as error:
        raise SourceError(text, f"{error.strerror}", KINDS, "check the name") from error
    if glob.has_magic(text):
        return _images(text, _matching(text), isolate, start)
    raise SourceError(text, "no such file or folder", KINDS, _nearest(path))


def _check_scheme(text: str, scheme: str, allow_network: bool) -> None:
    if scheme not in NETWORK_SCHEMES:
        raise SourceError(
            text,
            f"the protocol {scheme!r} is refused",
            KINDS,
            "give a plain path (./ in front if its name has a colon)",
        )
    if not allow_network:
        raise SourceError(
            text,
            "it is on the network",
            "network sources with --allow-network (allow_network=True)",
            "add that",
        )


def _images(text: str, paths: list[Path], isolate: bool, start: int) -> Reader:
    from bayesnet_track.sources.images import ImageReader

    reader = ImageReader(text, paths)
    if not isolate:
        return reader
    from bayesnet_track.sources.isolated import IsolatedReader

    return IsolatedReader(text, reader, start=start)


def _video(text: str, network: bool, isolate: bool, start: int) -> Reader:
    if isolate:
        from bayesnet_track.sources.isolated import IsolatedReader

        return IsolatedReader(text, network=network, start=start)
    from bayesnet_track.sources.video import VideoReader

    return VideoReader(text, network)
