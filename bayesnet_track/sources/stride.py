"""Every K-th frame of a source, with the numbers and times that the frames have in the source."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from bayesnet_track.sources.paths import SourceError
from bayesnet_track.sources.readers import Picture, Reader, ReaderItem


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
