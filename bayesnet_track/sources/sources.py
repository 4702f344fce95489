"""Opening a source of frames from the text a person gives: file, folder, glob, camera index or URL."""

from __future__ import annotations

import glob
import os
from pathlib import Path
from typing import TYPE_CHECKING

from bayesnet_track.observation.image_files import pages_of
from bayesnet_track.observation.settings import setting
from bayesnet_track.sources.entrances.levels import ValueRange, value_range_of
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.frames import OnResize, Source, SourceItem
from bayesnet_track.sources.images import HEAD_BYTES
from bayesnet_track.sources.origin import Origin
from bayesnet_track.sources.paths import (
    _SCHEME,
    IMAGE_SUFFIXES,
    KINDS,
    SourceError,
    _in_folder,
    _matching,
    _nearest,
    is_file,
    natural_key,
    shown_address,
)
from bayesnet_track.sources.timing import Reader, strided

if TYPE_CHECKING:
    from bayesnet_track.sources.video import VideoReader

__all__ = ["Source", "SourceError", "SourceItem", "open_source"]

SUFFIX = ".csv"
DETECTION_SUFFIXES = frozenset({SUFFIX, ".txt", ".jsonl"})
"""A file of detections stands for a source of their times, without images."""

LIVE_SCHEMES = frozenset({"rtsp", "rtsps"})
NETWORK_SCHEMES = frozenset({"http", "https", "rtsp", "rtsps"})


def open_source(
    text: str,
    start: int | None = None,
    end: int | None = None,
    allow_network: bool = False,
    on_resize: OnResize = "stop",
    stride: int = 1,
    live: bool | None = None,
    value_range: ValueRange | None = None,
    size: tuple[int, int] | None = None,
    lazy: bool = False,
) -> Source:
    """The source that `text` names.

    `start` and `end` are frame indices, from 0, `end` exclusive. URLs are opened only with `allow_network`;
    every other protocol (`concat:`, `subfile,`, `file:`, `pipe:`, ...) is refused. `on_resize` says what a
    change of frame size does: "stop" ends the source, "rescale" brings the picture to the first one's size.
    With `stride` K only every K-th frame is handed out, from `start` on; numbers and times stay the source's.
    Of a URL, `live` says whether the newest frame is to be read and a broken connection made again (True), or
    every frame up to the end (False). None finds out: RTSP, a multipart stream of images (MJPEG), a playlist
    without an end, and, with a notice, a stream of no declared length are live.
    `value_range` are the values that become black and white in frames of 8 bits (`entrances.levels.to_bgr`).
    `size` is the width and height, px, of frames that a file of detections stands for, where no file with it
    has them. With `lazy` frames of files after the first are decoded when somebody asks for their images.

    Raises:
        SourceError: nothing can be read there; says what was found, what is allowed and how to mend it.
    """
    check_range(text, start, end)
    value_range = _checked_values(text, value_range)
    lazy = lazy and is_file(text)  # cameras and streams give each picture once
    reader = make_reader(text, allow_network, live, value_range, size, lazy)
    reader = strided(text, reader, start, stride)
    description = shown_address(text)
    origin = Origin(
        "plain",
        text,
        description,
        start,
        end,
        on_resize,
        allow_network,
        stride=stride,
        value_range=value_range,
        size=size,
        lazy=lazy,
    )
    return Source(description, reader, start, end, on_resize, origin, lazy)


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


def _checked_values(text: str, value_range: ValueRange | None) -> ValueRange | None:
    try:
        return value_range_of(value_range)
    except ValueError as error:
        raise SourceError(text, str(error), "LOW,HIGH with LOW below HIGH", "give another range") from error


def make_reader(
    text: str,
    allow_network: bool,
    live: bool | None = None,
    value_range: ValueRange | None = None,
    size: tuple[int, int] | None = None,
    lazy: bool = False,
) -> Reader:
    """The reader of what `text` names, as `open_source` takes it; raises SourceError."""
    if not text or "\0" in text:
        raise SourceError(text, "it is empty or holds a NUL", KINDS, "name a source")
    if text.isascii() and text.isdigit():
        if live is False:
            raise SourceError(text, "a camera has no end", "URLs that are read as files", "leave it out")
        from bayesnet_track.sources.live import camera_reader

        return camera_reader(text, value_range)
    path = Path(text)
    scheme = _SCHEME.match(text)
    if scheme:
        _check_scheme(text, scheme.group(1).lower(), allow_network)
        live = True if live is None and scheme.group(1).lower() in LIVE_SCHEMES else live
        return _of_network(text, live, value_range)
    if live:
        raise SourceError(
            text, "a file is not live: every frame of it is read", "cameras and URLs", "leave it out"
        )
    try:
        if path.is_dir():
            return _images(text, _in_folder(text, path), value_range)
        if path.is_file():
            if not os.access(path, os.R_OK):
                raise SourceError(text, "permission denied", KINDS, "make the file readable")
            if path.suffix.lower() in IMAGE_SUFFIXES and not _is_animated_png(path):
                return _images(text, [path], value_range)
            if path.suffix.lower() in DETECTION_SUFFIXES:
                return _without_images(text, size)
            return _video(text, False, value_range, lazy)
        if path.exists():
            raise SourceError(text, "it is neither a regular file nor a folder", KINDS, "give one of these")
    except PermissionError as error:
        raise SourceError(text, "permission denied", KINDS, "make it readable") from error
    except OSError as error:
        raise SourceError(text, f"{error.strerror}", KINDS, "check the name") from error
    if glob.has_magic(text):
        return _images(text, _matching(text), value_range)
    raise SourceError(text, "no such file or folder", KINDS, _nearest(path))


def _is_animated_png(path: Path) -> bool:
    """True if a file is a PNG of several frames, which is read as a video."""
    try:
        with path.open("rb") as file:
            pages = pages_of(path.name, file.read(HEAD_BYTES)) if path.suffix.lower() == ".png" else None
    except OSError:
        return False
    return pages is not None


def _without_images(text: str, size: tuple[int, int] | None) -> Reader:
    """The frames of a file of boxes, or the times of a CSV of what sensors measured."""
    from bayesnet_track.sources.detection_files import BoxReader, names_boxes
    from bayesnet_track.sources.scan_files import ScanReader

    try:
        is_of_sensors = text.lower().endswith(SUFFIX) and not names_boxes(text)
        return ScanReader(text) if is_of_sensors else BoxReader(text, size)
    except (OSError, ValueError) as error:
        if text.lower().endswith(SUFFIX):
            raise SourceError(text, str(error), KINDS, "mend the file") from error
        reason = f"it is no video, and as a file of boxes: {error}"
        raise SourceError(text, reason, KINDS, "give a video, or mend the file") from error


def _of_network(text: str, live: bool | None, value_range: ValueRange | None) -> Reader:
    reader = _video(text, True, value_range)
    flow = reader.flow
    if live is False or (live is None and flow.endless is None):
        return reader
    if live is None and not flow.is_sure:
        notice(
            f"{shown_address(text)}: taken as live, since {flow.endless}: the newest frame is tracked, the "
            f"others are dropped; {setting('--no-live')} reads every frame"
        )
    from bayesnet_track.sources.live import stream_reader

    return stream_reader(lambda: _video(text, True, value_range), reader)


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
            f"network sources with {setting('--allow-network')}",
            "add that",
        )


def _images(text: str, paths: list[Path], value_range: ValueRange | None) -> Reader:
    from bayesnet_track.sources.images import ImageReader, check_names, say_other_images, say_strays

    check_names(text, paths)
    if Path(text).is_dir():
        say_other_images(text, paths[0].parent)
        say_strays(text, sorted(paths, key=natural_key))
    return ImageReader(text, paths, value_range)


def _video(text: str, network: bool, value_range: ValueRange | None, lazy: bool = False) -> VideoReader:
    from bayesnet_track.sources.video import VideoReader

    return VideoReader(text, network, value_range, lazy)
