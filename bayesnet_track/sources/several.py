"""Sources of several cameras, merged by nominal time to steps; and all kinds of sources, opened again."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.events.runs import FramesMissing, SourceDamaged
from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.frames import DecodedFrame, EndReason, Source, SourceItem
from bayesnet_track.sources.origin import Origin
from bayesnet_track.sources.paths import SourceError
from bayesnet_track.sources.scenes.library import SceneSource
from bayesnet_track.sources.sources import open_source
from bayesnet_track.sources.stereo_source import open_stereo_source
from bayesnet_track.sources.timing import Size

TOGETHER = 0.1
"""Frames of different cameras no farther apart than this share of the shortest interval are one step."""


class _CameraSource(Protocol):
    """A source of one camera, such as `frames.Source`."""

    description: str
    width: int
    height: int
    has_color: bool
    frame_interval_s: float
    is_live: bool
    end_reason: EndReason

    @property
    def expected_frames(self) -> int | None:
        """Number of frames to come, where it is declared."""

    def close(self) -> None:
        """Let go of files and devices."""

    def __iter__(self) -> Iterator[SourceItem]: ...


@dataclass(frozen=True, eq=False)
class LastImage:
    """The image of a step: that of its frame where somebody looked at it, else an earlier one.

    Attributes:
        frame: of the camera whose images are shown; None where it has none.
        earlier: (H, W, 3) uint8, BGR.
        has_color: whether that camera has colour.
    """

    frame: Frame | None
    earlier: NDArray[np.uint8]
    has_color: bool

    @property
    def size(self) -> Size:
        """Width and height."""
        height, width = self.earlier.shape[:2]
        return width, height

    def pixels(self, size: Size) -> NDArray[np.uint8]:
        """(H, W, 3) uint8 BGR, of its own size."""
        frame = self.frame
        is_made = frame is not None and not (isinstance(frame, DecodedFrame) and not frame.is_made)
        return frame.image if frame is not None and is_made else self.earlier


@dataclass
class SeveralSources:
    """The frames of several cameras as steps, in the order of their times; a context manager.

    The frames of a step are at most `TOGETHER` of the shortest frame interval apart, one of each camera. Its
    time is that of the first of them, its image the last one that the first camera gave, of frames that are
    decoded when somebody asks the last one that was. It ends when all sources have ended.

    Attributes:
        sources: camera -> its opened source.
        start: the first step that is handed out; those before it are read and dropped.
        end: step to stop before; None for all.
        frames: steps handed out so far.

    Raises:
        SourceError: a source has no times in seconds, or is live, so that nobody knows what is yet to come.
    """

    sources: Mapping[str, _CameraSource]
    start: int | None = None
    end: int | None = None
    frames: int = 0
    end_reason: EndReason = "end_of_source"
    has_depth: bool = False
    is_live: bool = False
    _closing: ExitStack = field(default_factory=ExitStack)

    def __post_init__(self) -> None:
        for source in self.sources.values():
            self._closing.callback(source.close)
        for camera, source in self.sources.items():
            if source.is_live:
                raise SourceError(
                    source.description,
                    f"a live stream as the source of camera {camera}: frames of several cameras are merged "
                    "by their times, and of a live one nobody knows which frame comes next",
                    "recordings of all cameras",
                    "record the streams first, or give detections as they come to DetectionsTracker",
                )
        self._first = next(iter(self.sources))

    @classmethod
    def opened(
        cls, openers: Mapping[str, Callable[[], Any]], start: int | None = None, end: int | None = None
    ) -> Self:
        """The sources that these open; where one cannot be opened, those before it are closed."""
        sources: dict[str, _CameraSource] = {}
        with ExitStack() as stack:
            for camera, open_camera in openers.items():
                sources[camera] = open_camera()
                stack.callback(sources[camera].close)
            merged = cls(sources, start, end)
            stack.pop_all()
        return merged

    @property
    def origin(self) -> Origin | None:
        """Origins of all sources; None where one is an object of one's own."""
        origins = {camera: getattr(source, "origin", None) for camera, source in self.sources.items()}
        cameras = {camera: origin for camera, origin in origins.items() if origin is not None}
        if len(cameras) < len(origins):
            return None
        return Origin("several", "", self.description, self.start, self.end, cameras=cameras)

    @property
    def description(self) -> str:
        """All sources, each with its camera."""
        return ", ".join(f"{camera}={source.description}" for camera, source in self.sources.items())

    @property
    def width(self) -> int:
        """Columns of the first camera's image."""
        return self.sources[self._first].width

    @property
    def height(self) -> int:
        """Rows of the first camera's image."""
        return self.sources[self._first].height

    @property
    def expected_frames(self) -> int | None:
        """Not known before all times are: cameras have their own rates."""
        return None

    @property
    def frame_interval_s(self) -> float:
        """The shortest nominal interval of a camera, s."""
        return min(source.frame_interval_s for source in self.sources.values())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of files and devices; safe to call twice."""
        self._closing.close()

    def __iter__(self) -> Iterator[SourceItem]:
        heads = {camera: _Head(camera, iter(source)) for camera, source in self.sources.items()}
        tolerance, start = TOGETHER * self.frame_interval_s, math.nan
        first = self.sources[self._first]
        image: Array = np.zeros((first.height, first.width, 3), np.uint8)
        image.flags.writeable = False
        last_frames: dict[str, Frame] = {}
        for step in count() if self.end is None else range(self.end):
            notices: list[SourceItem] = []
            for head in heads.values():
                notices += head.advance()
            yield from (_at_step(item, step) for item in notices if step >= (self.start or 0))
            waiting = {camera: head.frame for camera, head in heads.items() if head.frame is not None}
            if not waiting:
                break
            time_s = min(frame.time_s for frame in waiting.values())
            start = time_s if math.isnan(start) else start
            together = {c: frame for c, frame in waiting.items() if frame.time_s <= time_s + tolerance}
            for camera in together:
                heads[camera].frame = None
            step_image = LastImage(together.get(self._first), image, first.has_color)
            if step >= (self.start or 0):
                moment, cameras = (step, (time_s - start) / self.frame_interval_s, time_s), together
                yield DecodedFrame.from_decoded(step_image, *moment, cameras=cameras, last_frames=last_frames)
                last_frames = last_frames | together
                self.frames += 1
            image = step_image.pixels(step_image.size)
        reasons = [source.end_reason for source in self.sources.values()]
        self.end_reason = next((reason for reason in reasons if reason != "end_of_source"), "end_of_source")


@dataclass
class _Head:
    """The next frame of a camera; None before it was asked for, and at the end."""

    camera: str
    items: Iterator[SourceItem]
    frame: Frame | None = None

    def advance(self) -> list[SourceItem]:
        """Events of the source before its next frame, which is then there."""
        notices: list[SourceItem] = []
        while self.frame is None:
            item = next(self.items, None)
            if item is None:
                break
            if not isinstance(item, Frame):
                if isinstance(item, SourceDamaged):
                    notices.append(replace(item, reason=f"{self.camera}: {item.reason}"))
                elif isinstance(item, FramesMissing):  # the others go on: it says nothing for as long
                    notice(f"{self.camera}: frame {item.frame}: {item.describe().partition(';')[0]}")
                else:
                    notices.append(item)
                continue
            if math.isnan(item.time_s):
                raise SourceError(
                    self.camera,
                    "frames without times in seconds",
                    "frames with times, by which those of several cameras are merged",
                    "a video, or images with a known rate",
                )
            self.frame = item
        return notices


def _at_step(item: Any, step: int) -> SourceItem:
    """An event of one source, at the number of a step."""
    event: SourceItem = replace(item, frame=step) if hasattr(item, "frame") else item
    return event


OpenCamera = Callable[[str, Origin], Any]
"""Opens the source of one of several cameras, by its name and how it was opened before."""


def reopen(origin: Origin, open_camera: OpenCamera | None = None) -> Source | SceneSource | SeveralSources:
    """The source from its first frame on; its paths where they were, or else as given.

    Each of several cameras is opened by `open_camera`, if it is given.

    Raises:
        SourceError: it can only be read once, or no longer.
        CalibrationError: the calibration file cannot be used.
    """
    if origin.only_once is not None:
        raise SourceError(
            origin.description, origin.only_once, "files and built-in scenes", "start a new run"
        )
    if origin.kind == "scene":
        return SceneSource.named(origin.text, origin.seed, origin.end)
    if origin.cameras:
        return SeveralSources.opened(
            {
                camera: partial(reopen, part) if open_camera is None else partial(open_camera, camera, part)
                for camera, part in origin.cameras.items()
            },
            origin.start,
            origin.end,
        )
    places = origin.places()
    # What is read again are files, however they are named: a run directory is data and allows nothing.
    window = (origin.start, origin.end, False, origin.on_resize)
    if origin.kind == "plain":
        source = open_source(
            places[origin.text],
            *window,
            origin.stride,
            value_range=origin.value_range,
            size=origin.size,
            lazy=origin.lazy,
        )
    else:
        source = open_stereo_source(
            places[origin.text],
            *window,
            right=None if origin.right is None else places[origin.right],
            depth=None if origin.depth is None else places[origin.depth],
            side_by_side=origin.kind == "side_by_side",
            calibration=None if origin.calibration is None else places[origin.calibration],
            stride=origin.stride,
            value_range=origin.value_range,
        )
    source.description, source.origin = origin.description, origin
    return source
