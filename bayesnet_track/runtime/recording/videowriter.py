"""The annotated video as a file that stays readable when the writer is killed: MKV, or fragmented MP4."""

from __future__ import annotations

from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal import disk
from bayesnet_track.journal.writer import OutputError
from bayesnet_track.runtime.recording.remux import DiskFile, remux

SUFFIXES = {".mkv": "matroska", ".mp4": "mp4"}
_CLUSTER_S = 1
LONGEST_SIDE = 1920
"""Pixels of the longer side of a video, where nothing else is asked for."""
LEAST_SIDE = 16


def video_size(width: int, height: int, longest: int) -> tuple[int, int]:
    """Columns and rows of the video of frames of a size: even, and none above `longest`.

    >>> video_size(3840, 2160, 1920), video_size(65, 49, 1920)
    ((1920, 1080), (64, 48))
    """
    shrink = min(1.0, longest / max(width, height))
    if shrink == 1.0:
        return width - width % 2, height - height % 2
    return max(2, 2 * int(width * shrink / 2)), max(2, 2 * int(height * shrink / 2))


class VideoWriter:
    """A video sink for BGR frames of one size.

    ``.mkv`` (Matroska, a new cluster every second) or ``.mp4`` (fragmented at every key frame); H.264 where
    the library has libx264, else MPEG-4. An odd width or height is cut by one pixel, as 4:2:0 needs. Larger
    frames than `longest_side` px are scaled down to that.

    Raises:
        OutputError: another suffix, or the file cannot be created or written.
    """

    def __init__(
        self, path: Path, width: int, height: int, frame_interval_s: float, longest_side: int = LONGEST_SIDE
    ) -> None:
        import av

        self.path, self._place = path, path.absolute()
        self._faults = (av.error.FFmpegError, OSError, ValueError)
        if path.suffix.lower() not in SUFFIXES:
            raise OutputError(f"{path}: a video is written as {' or '.join(SUFFIXES)}")
        if width < 2 or height < 2:
            raise OutputError(f"{path}: a video needs at least 2x2 px, not {width}x{height}")
        rate = max(Fraction(1.0 / frame_interval_s).limit_denominator(1001), Fraction(1, 1001))
        self._size = video_size(width, height, longest_side)
        self._is_scaled = max(width, height) > longest_side
        codec = "libx264" if "libx264" in av.codecs_available else "mpeg4"
        options = {"cluster_time_limit": str(1000 * _CLUSTER_S), "flush_packets": "1"}
        if path.suffix.lower() == ".mp4":
            options = {"movflags": "frag_keyframe+empty_moov+default_base_moof", "flush_packets": "1"}
        # Without random identifiers, equal pictures make equal files.
        options["fflags"] = "+bitexact"
        # Without reordering and look-ahead a frame is in the file as soon as its cluster is.
        tuning = {"preset": "superfast", "crf": "23", "tune": "zerolatency"} if codec == "libx264" else {}
        self._count = 0
        self._container: Any = None
        try:
            self._file = disk.open_raw(path, "w+b")
        except OSError as error:
            raise self._error(error) from error
        try:
            self._output = DiskFile(self._file)
            self._container = av.open(
                self._output, mode="w", format=SUFFIXES[path.suffix.lower()], options=options
            )
            self._stream: Any = self._container.add_stream(codec, rate=rate, options=tuning)
            self._stream.width, self._stream.height = self._size
            self._stream.pix_fmt = "yuv420p"
            self._stream.codec_context.gop_size = max(1, round(rate * _CLUSTER_S))
            if codec == "mpeg4":
                self._stream.bit_rate = max(400_000, int(self._size[0] * self._size[1] * float(rate) * 0.2))
            # Otherwise the file would be made at the first frame.
            self._container.start_encoding()
        except self._faults as error:
            self._abandon()
            raise self._error(error) from error
        self._time_base = 1 / rate

    def write(self, image: NDArray[np.uint8]) -> None:
        """Add a frame, (H, W, 3) uint8 BGR."""
        import av

        width, height = self._size
        try:
            disk.check_held(self._file, self._place, self._output.size)
            if not self._is_scaled:
                image = image[:height, :width]
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="bgr24")
            if self._is_scaled:
                frame = frame.reformat(width, height, "yuv420p", interpolation="AREA")
            frame.pts, frame.time_base = self._count, self._time_base
            self._count += 1
            for packet in self._stream.encode(frame):
                self._container.mux(packet)
        except self._faults as error:
            self._abandon()
            raise self._error(error) from error

    def finish(self) -> None:
        """Close the file, and wait until the disk has it; an MP4 is no longer fragmented then."""
        self._end()
        try:
            disk.check_held(self._file, self._place, self._output.size)
            self._output.check()
            disk.sync(self._file)
        except OSError as error:
            raise self._error(error) from error
        finally:
            self._file.close()
        if self._count and self.path.suffix.lower() == ".mp4":
            try:
                remux(self.path)
            except self._faults as error:
                raise self._error(error) from error

    def close(self) -> None:
        """Close the file; safe to call twice."""
        self._end()
        self._file.close()

    def _end(self) -> None:
        if self._container is None:
            return
        try:
            for packet in self._stream.encode() if self._count else ():
                self._container.mux(packet)
            self._container.close()
            self._container = None
        except self._faults as error:
            self._abandon()
            raise self._error(error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _abandon(self) -> None:
        container, self._container = self._container, None
        if container is not None:
            with suppress(*self._faults):
                container.close()
        self._file.close()

    def _error(self, error: Exception) -> OutputError:
        if isinstance(error, disk.LostFileError):
            return OutputError(f"{self.path}: {error}")
        said = getattr(error, "strerror", None) or error
        return OutputError(f"{self.path}: cannot write the video: {said}")
