"""Frames of every source: raw images, items with their time, errors, and the rules of time and size.

A *reader* (images, video, camera) gives raw pictures; `Source` turns them into frames and into the journal's
events about the source. The rules, the same for every kind of source:

- **Index.** Frames are counted from 0 at the start of the source. A picture that cannot be decoded keeps its
  number: the next frame's index is one higher.
- **Time** is in nominal frame intervals. Where it jumps, `FramesMissing` comes before the frame after
  the gap. Where it stands still or runs backwards, `SourceDamaged` ends the source.
- **Size.** A picture of another size, or gray where the first was in colour or the other way round, gives
  `FrameSizeChanged`; then the source ends ("stop"), or the picture is resized to the first one's size
  ("rescale"; never where the frames carry depth).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.events.runs import (
    FramesDropped,
    FrameSizeChanged,
    FramesMissing,
    SourceDamaged,
    SourceStalled,
)
from bayesnet_track.observation.image_files import PictureError
from bayesnet_track.observation.planes import Depth, Frame, read_only
from bayesnet_track.sources.entrances.notices import few
from bayesnet_track.sources.origin import Origin, changed_since, stamps
from bayesnet_track.sources.paths import SourceError, hide_secrets
from bayesnet_track.sources.timing import Damage, Decoded, Dropped, Picture, Reader, Size, Stalled

OnResize = Literal["stop", "rescale"]


@dataclass(frozen=True, eq=False)
class Undecoded:
    """A picture that is decoded when pixels are asked for, taken to be as the first one was.

    Attributes:
        picture: it.
        size: width and height.
        has_color: False where its three channels would be copies.
        on_resize: what is done where it has another size.
        refuse: told why it cannot be decoded.
    """

    picture: Picture
    size: Size
    has_color: bool
    on_resize: OnResize
    refuse: Callable[[int, str], None]

    def pixels(self, size: Size) -> NDArray[np.uint8]:
        """(H, W, 3) uint8 BGR of that size; raises PictureError."""
        try:
            image, has_color = self.picture.pixels()
            if (actual := image.shape[1::-1]) != self.size and self.on_resize == "stop":
                raise PictureError("{}x{} px, and the first one {}x{}".format(*actual, *self.size))
            if has_color != self.has_color and self.on_resize == "stop":
                gray, color = ("it", "the first one") if self.has_color else ("the first one", "it")
                raise PictureError(f"{gray} is gray, and {color} has colour")
        except PictureError as error:
            self.refuse(self.picture.index, str(error))
            raise
        return image if image.shape[1::-1] == size else _resize(image, *size)


class DecodedFrame(Frame):
    """A frame whose pixels are made when they are asked for: the whole image, or directly a smaller one."""

    _decoded: Decoded | None = None
    _smaller: NDArray[np.uint8] | None = None

    @classmethod
    def from_decoded(cls, decoded: Decoded, index: int, time: float, time_s: float, **fields: Any) -> Self:
        """The frame of a picture, with further `fields`; no pixel is made yet."""
        frame = cls.__new__(cls)
        frame.__dict__.update(
            index=index,
            time=time,
            has_color=decoded.has_color,
            time_s=time_s,
            _decoded=decoded,
            **{"depth": None, "stride": 1, "inputs": {}, "cameras": None, "last_frames": {}, **fields},
        )
        return frame

    @cached_property
    def image(self) -> NDArray[np.uint8]:
        """The image; raises PictureError."""
        assert self._decoded is not None
        return read_only(self._decoded.pixels(self._decoded.size))

    @property
    def is_made(self) -> bool:
        """True if somebody asked for the image, and it could be made."""
        return "image" in self.__dict__

    @property
    def is_readable(self) -> bool:
        """True if the image can be made, which is done; else its source says why before its next frame."""
        with suppress(PictureError):
            _ = self.image
        return self.is_made

    @property
    def height(self) -> int:
        """Rows of the image."""
        return super().height if self._decoded is None else self._decoded.size[1]

    @property
    def width(self) -> int:
        """Columns of the image."""
        return super().width if self._decoded is None else self._decoded.size[0]

    def smaller(self, size: Size) -> NDArray[np.uint8] | None:
        """The image in a smaller size, made once; None where only the whole one is there."""
        if self._decoded is None:
            return None
        if self._smaller is None or self._smaller.shape[1::-1] != size:
            self.__dict__["_smaller"] = read_only(self._decoded.pixels(size))
        return self._smaller

    def __reduce__(self) -> tuple[type[Frame], tuple[Any, ...]]:
        return Frame, tuple(getattr(self, field.name) for field in fields(Frame))


SourceItem = Frame | FramesMissing | FramesDropped | FrameSizeChanged | SourceDamaged | SourceStalled
EndReason = Literal["end_of_source", "source_truncated", "source_damaged", "frame_size_changed"]


class Source:
    """An opened source: a context manager and a one-way iterator of `SourceItem`.

    Attributes:
        description: the source as given, but for passwords.
        width: columns of the first frame.
        height: rows of the first frame.
        has_color: whether the first frame has colour.
        has_depth: whether the first frame has a second eye or points.
        declared_frames: number of frames that the whole source declares, or None.
        expected_frames: how many of them lie between `start` and `end`, or None.
        frame_interval_s: nominal seconds between frames.
        stride: every how many-th frame is handed out.
        is_live: whether it goes on however long a frame takes, as a camera does.
        frames: frames handed out so far.
        tracked: the size that frames are tracked in, where that is a smaller one: then nothing but pixels of
            this size is made, until somebody asks for a frame's image.
        end_reason: why it ended, in the words of `RunEnded.reason`; end_of_source while nothing is wrong.
        origin: how it was opened, where it can be opened again.
        lazy: whether frames after the first are decoded when somebody asks for their images; of one that
            cannot be decoded is told before the next, once, and of earlier ones no more.

    Raises:
        SourceError: no frame can be read.
    """

    def __init__(
        self,
        description: str,
        reader: Reader,
        start: int | None,
        end: int | None,
        on_resize: OnResize,
        origin: Origin | None = None,
        lazy: bool = False,
    ) -> None:
        self.description, self.origin = hide_secrets(description), origin
        self.declared_frames = reader.declared_frames
        self.frame_interval_s = reader.frame_interval_s
        self.is_live = bool(getattr(reader, "is_live", False))
        self.stride = int(getattr(reader, "stride", 1))
        self.frames = 0
        self.tracked: Size | None = None
        self.end_reason: EndReason = "end_of_source"
        self._reader = reader
        self._start, self._end, self._on_resize = start or 0, end, on_resize
        self.lazy, self._refused = lazy, list[SourceDamaged]()
        self._untold = -1
        self._stamps = {} if origin is None else stamps(origin.files())
        self._items = _gathered(self._read())
        self._ahead: list[SourceItem] = []
        try:
            first = self._first_frame()
        except BaseException:
            self.close()
            raise
        self.width, self.height, self.has_color = first.width, first.height, first.has_color
        self.has_depth = first.depth is not None

    @property
    def expected_frames(self) -> int | None:
        """Number of frames between `start` and `end`; None when the source declares no number."""
        if self.declared_frames is None:
            return None if self._end is None else -(-(self._end - self._start) // self.stride)
        stop = self.declared_frames if self._end is None else min(self._end, self.declared_frames)
        return max(-(-(stop - self._start) // self.stride), 0)

    @property
    def numbers(self) -> range:
        """Numbers of the frames between `start` and `end`; up to `sys.maxsize` where it declares no end."""
        ends = [end for end in (self._end, self.declared_frames) if end is not None]
        return range(self._start, max(min(ends, default=sys.maxsize), self._start), self.stride)

    @property
    def first_frame(self) -> Frame | None:
        """The first frame; None once it was handed out."""
        return next((item for item in self._ahead if isinstance(item, Frame)), None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of files and devices; safe to call twice."""
        self._items.close()
        self._reader.close()

    def __iter__(self) -> Iterator[SourceItem]:
        return self

    def __next__(self) -> SourceItem:
        item = self._ahead.pop(0) if self._ahead else next(self._items)
        self.frames += isinstance(item, Frame)
        return item

    def _first_frame(self) -> Frame:
        for item in self._items:
            self._ahead.append(item)
            if isinstance(item, Frame):
                return item
        reasons = list(dict.fromkeys(i.reason for i in self._ahead if isinstance(i, SourceDamaged)))
        reason_text = (
            reasons[0] + (f"; and {len(reasons) - 1} more" if len(reasons) > 1 else "") if reasons else ""
        )
        window = f" from frame {self._start} on" if self._start else ""
        raise SourceError(
            self.description,
            f"no frame can be read{window}" + (f" ({reason_text})" if reason_text else ""),
            "a source with at least one readable frame"
            + ("" if self.declared_frames is None else f"; this one declares {self.declared_frames} frames"),
            "check that the file is whole, or choose an earlier start"
            if self._start
            else "check that it is whole",
        )

    def _read(self) -> Any:
        last_index = self._start - 1
        for item in self._read_frames():
            if isinstance(item, Frame):
                last_index = self._untold = item.index
            yield item
            while self._refused:
                yield self._refused.pop(0)
        changed_files = changed_since(self._stamps)
        if changed_files:
            names = few([path.name for path in changed_files])
            yield self._report_damage(last_index + 1, f"changed while it was read: {names}")

    def _read_frames(self) -> Any:
        first: Frame | None = None
        previous: Frame | None = None
        shape: tuple[int, int, bool] | None = None
        for item in self._reader:
            if self._end is not None and item.index >= self._end and previous is not None:
                return
            if isinstance(item, Damage):
                if item.index >= self._start:
                    yield self._report_damage(item.index, item.reason, item.truncated)
                continue
            if item.index < self._start:
                continue
            if isinstance(item, Dropped):
                yield FramesDropped(item.index, item.pictures, hide_secrets(item.reason))
                continue
            if isinstance(item, Stalled):
                yield SourceStalled(item.index, item.seconds, hide_secrets(item.reason), item.attempt)
                continue
            if previous is not None and not item.time > previous.time:
                yield self._report_damage(
                    item.index,
                    f"time runs backwards or stands still: {item.time_s:.6f} s after {previous.time_s:.6f} s",
                )
                return
            try:
                frame = self._frame(item, first)
            except PictureError as error:
                yield self._report_damage(item.index, str(error))
                continue
            # Pictures that were dropped are not missing: the steps between all that came count.
            steps = item.skipped + 1
            if previous is not None and item.time - previous.time >= steps * self._reader.gap_from:
                yield FramesMissing(item.index, item.time - previous.time - steps)
            frame_shape = (frame.width, frame.height, frame.has_color)
            if shape is not None and frame_shape != shape:
                # Depth cannot be brought to another size: its geometry is that of the pixels.
                action = (
                    "stop" if frame.depth is not None and frame_shape[:2] != shape[:2] else self._on_resize
                )
                yield FrameSizeChanged(item.index, frame_shape[0], frame_shape[1], action)
                if action == "stop":
                    self.end_reason = "frame_size_changed"
                    return
            shape = frame_shape
            if first is not None and frame_shape[:2] != (first.width, first.height):
                frame = replace(frame, image=_resize(frame.image, first.width, first.height))
            previous = frame
            first = first or previous
            yield previous
            if self._end is not None and item.index + 1 >= self._end:
                return

    def _frame(self, picture: Picture, first: Frame | None) -> Frame:
        """The frame of a picture, of which the pixels that are tracked in are made; raises PictureError.

        After the `first` one that is done later where the source is lazy.
        """
        moment = (picture.index, picture.time)
        if self.lazy and first is not None:
            kind = (first.width, first.height), first.has_color, self._on_resize
            undecoded = Undecoded(picture, *kind, self._refuse)
            return DecodedFrame.from_decoded(undecoded, *moment, picture.time_s, stride=self.stride)
        if picture.decoded is not None and picture.complete is None:
            frame = DecodedFrame.from_decoded(picture.decoded, *moment, picture.time_s, stride=self.stride)
            _ = frame.image if self.tracked is None else frame.smaller(self.tracked)
            return frame
        image, has_color = picture.pixels()
        depth: Depth | None = None
        if picture.complete is not None:
            image, depth = picture.complete(image)
        return Frame(*moment, image, has_color, picture.time_s, depth, self.stride)

    def _refuse(self, index: int, reason: str) -> None:
        if index == self._untold:  # who asks again, or for an earlier one, is no part of a run's events
            self._untold = -1
            self._refused.append(self._report_damage(index, reason))

    def _report_damage(self, index: int, reason: str, truncated: bool = False) -> SourceDamaged:
        self.end_reason = "source_truncated" if truncated else "source_damaged"
        return SourceDamaged(index, hide_secrets(reason))


def _gathered(items: Iterable[SourceItem]) -> Generator[SourceItem]:
    """The items; damage of one reason between two frames is one event, with how often and up to where."""
    pending: dict[str, SourceDamaged] = {}
    for item in items:
        if isinstance(item, SourceDamaged):
            first = pending.get(item.reason)
            repeated = first and replace(first, times=first.times + 1, last=item.frame)
            pending[item.reason] = repeated or item
            continue
        yield from pending.values()
        pending.clear()
        yield item
    yield from pending.values()


def _resize(image: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    import cv2

    shrinks = image.shape[0] > height or image.shape[1] > width
    resized = cv2.resize(
        image, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    )
    return np.asarray(resized, dtype=np.uint8)
