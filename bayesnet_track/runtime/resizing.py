"""Track in smaller frames than the source has: the one place where pixels of one become those of the other.

The engine sees the smaller frames. Whoever uses it (a run, a `Tracker`) gives and gets boxes in the pixels of
the source. What is compared with a length or an area of the graph, such as UD, stays in the pixels of the
smaller frame, as do beliefs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesnet_track.engine.lines import Lines
from bayesnet_track.engine.outcome import Outcome
from bayesnet_track.engine.queries import Forecast
from bayesnet_track.engine.starts import Start, StartError
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.journal.events.beliefs import Reappeared
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import (
    CandidateConfirmed,
    Continued,
    Reacquired,
    Recognition,
    Returned,
    TargetStarted,
)
from bayesnet_track.journal.events.runs import RunStarted
from bayesnet_track.journal.events.statuses import DistractorSeen, FoundAgain
from bayesnet_track.journal.metrics import FrameMetrics, PartMetrics
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.detector import Detections
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.detection_files import FileDetector
from bayesnet_track.sources.frames import DecodedFrame
from bayesnet_track.sources.scan_files import ScanFile
from bayesnet_track.sources.timing import Size

LEAST_MAX_SIDE = 16
"""The smallest `max_side`, px."""

ROUNDING = 1e-9
"""By how much a side of 1 px may come out smaller, px."""

ACROSS, DOWN = ("x", "w", "vx", "ax"), ("y", "h", "vy", "ay")
"""Fields of a state in pixels along either axis."""

Estimate = TypeVar("Estimate", FrameMetrics, Forecast)


@dataclass(frozen=True)
class Resizing:
    """Conversion of the source's frames to those that are tracked in, and of results back to the source's.

    Attributes:
        source: width and height of the source's frames.
        tracked: those of the frames that the engine sees.
    """

    source: Size
    tracked: Size

    @classmethod
    def to(cls, width: int, height: int, max_side: int | None) -> Self:
        """Frames whose longer side is at most `max_side`; never larger ones, and the same with None.

        Raises:
            ValueError: `max_side` is less than `LEAST_MAX_SIDE`.
        """
        if max_side is not None and max_side < LEAST_MAX_SIDE:
            raise ValueError(
                f"max_side {max_side}: at least {LEAST_MAX_SIDE} px is needed; give more, or None for the "
                "frames as they are"
            )
        share = 1.0 if max_side is None else min(1.0, max_side / max(width, height))
        return cls((width, height), (max(1, round(share * width)), max(1, round(share * height))))

    @classmethod
    def of(cls, header: RunStarted) -> Self:
        """The resizing of an earlier run."""
        size = (header.width, header.height)
        return cls(size, (header.tracked[0], header.tracked[1]) if header.tracked else size)

    @cached_property
    def is_none(self) -> bool:
        """True if frames stay as they are."""
        return self.source == self.tracked

    def frame(self, frame: Frame) -> Frame:
        """The frame that the engine sees: pixels are means over areas, of a video in its own colour space."""
        if self.is_none:
            return frame
        decoded = frame.smaller(self.tracked) if isinstance(frame, DecodedFrame) else None
        image = _smaller(frame.image, self.tracked) if decoded is None else decoded
        return Frame(frame.index, frame.time, image, frame.has_color, frame.time_s, frame.depth, frame.stride)

    def start(self, start: Start) -> Start:
        """The start box where the engine sees it.

        Raises:
            StartError: it is less than 1 px wide or high there.
        """
        if self.is_none:
            return start
        x, y, w, h = (np.asarray(start.box, dtype=np.float64) * self._in).tolist()
        if min(w, h) < 1 - ROUNDING:
            box_text, (width, height) = ",".join(f"{float(value):g}" for value in start.box), self.tracked
            raise StartError(
                f"start box {box_text}: only {w:.3g}x{h:.3g} px where frames are tracked at {width}x{height} "
                "px; width and height must be at least 1 px there; give a larger max_side, or none"
            )
        return replace(start, box=(x, y, w, h))

    def detector(self, detector: FileDetector | ScanFile) -> FileDetector | ScanFile:
        """Given detections where the engine sees them.

        Raises:
            ValueError: frames are made smaller, and detections are quantities, whose functions are in px.
        """
        if self.is_none:
            return detector
        if isinstance(detector, ScanFile):
            raise ValueError(
                "max_side: the measures of sensors are of frames in their own size; leave it out"
            )
        resized = {
            frame: Detections(_moved(detections.boxes, self._in), detections.scores, detections.labels)
            for frame, detections in detector.found.items()
        }
        return FileDetector(resized)

    def found(self, detections: Detections) -> Detections:
        """Detections in a smaller frame, in the source's pixels."""
        if self.is_none:
            return detections
        return replace(detections, boxes=_moved(detections.boxes, self._out))

    def graph(self, graph: CheckedGraph) -> CheckedGraph:
        """The graph with its masks, which have the source's size, in the size that is tracked in."""
        if self.is_none or not graph.masks:
            return graph
        masks = {
            name: replace(mask, gray=_smaller(mask.gray, self.tracked)) for name, mask in graph.masks.items()
        }
        return replace(graph, masks=masks)

    def outcome(self, outcome: Outcome) -> Outcome:
        """The engine's outcome in the source's pixels; its state, and covariances, are as they were."""
        if self.is_none:
            return outcome
        metrics, events = map(self.metrics, outcome.metrics), map(self.event, outcome.events)
        return replace(outcome, metrics=Lines(born=tuple(metrics)), events=tuple(events))

    def metrics(self, line: FrameMetrics) -> FrameMetrics:
        """Measurements of a target, in the source's pixels."""
        if self.is_none:
            return line
        return replace(
            self.estimate(line),
            map=self._box(line.map),
            cloud=tuple((*map(round, self._box(box[:4])), *box[4:]) for box in line.cloud),
            parts={name: self._part(part) for name, part in line.parts.items()},
        )

    def estimate(self, estimate: Estimate) -> Estimate:
        """Box, standard deviations and regions in the source's pixels."""
        if self.is_none:
            return estimate
        return replace(
            estimate,
            centre_box=self._box(estimate.centre_box),
            sd=self._lengths(estimate.sd),
            region50=self._region(estimate.region50),
            region90=self._region(estimate.region90),
        )

    def field(self, name: str, values: Floats) -> Floats:
        """Values of a field of the state in the source's pixels; those of other units are as they were."""
        if self.is_none or name not in (*ACROSS, *DOWN):
            return values
        factor = self._out[1 if name in DOWN else 0]
        return np.asarray((values + 0.5) * factor - 0.5 if name in ("x", "y") else values * factor)

    def event(self, event: Event) -> Event:
        """An event with its places and distances in the source's pixels."""
        if self.is_none:
            return event
        match event:
            case TargetStarted() | Continued():
                return replace(event, box=self._box(event.box))
            case Returned() | Reacquired():
                return replace(event, box=self._box(event.box), recognition=self._known(event.recognition))
            case CandidateConfirmed(nearest=Recognition() as near):
                return replace(event, nearest=self._known(near))
            case DistractorSeen():
                return replace(event, x=self._x(event.x), y=self._y(event.y))
            case Reappeared():
                x, y, shift = self._x(event.x), self._y(event.y), self._distance(event.moved_px)
                radius = None if event.within_px is None else self._distance(event.within_px)
                return replace(event, x=x, y=y, moved_px=shift, within_px=radius)
            case FoundAgain():
                return replace(event, moved_px=self._distance(event.moved_px))
            case _:
                return event

    @property
    def _out(self) -> Floats:
        """The source's pixels to one tracked in, along x, y, x, y."""
        scale_x, scale_y = (a / b for a, b in zip(self.source, self.tracked, strict=True))
        return np.array([scale_x, scale_y, scale_x, scale_y])

    @property
    def _in(self) -> Floats:
        return 1.0 / self._out

    def _box(self, box: Sequence[float]) -> tuple[float, float, float, float]:
        x, y, w, h = _moved(box, self._out).tolist()
        return x, y, w, h

    def _lengths(self, lengths: Sequence[float]) -> tuple[float, ...]:
        return tuple((np.asarray(lengths) * self._out).tolist())

    def _region(self, region: Sequence[float]) -> tuple[float, ...]:
        left, right, top, bottom = region
        return (self._x(left), self._x(right), self._y(top), self._y(bottom))

    def _x(self, x: float) -> float:
        return float((x + 0.5) * self._out[0] - 0.5)

    def _y(self, y: float) -> float:
        return float((y + 0.5) * self._out[1] - 0.5)

    def _distance(self, distance: float) -> float:
        return float(distance * np.sqrt(self._out[0] * self._out[1]))

    def _part(self, part: PartMetrics) -> PartMetrics:
        return replace(part, centre_box=self._box(part.centre_box), sd=self._lengths(part.sd))

    def _known(self, recognition: Recognition) -> Recognition:
        return replace(recognition, distance_px=self._distance(recognition.distance_px))


def _smaller(image: NDArray[np.uint8], size: Size) -> NDArray[np.uint8]:
    import cv2

    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _moved(boxes: ArrayLike, factors: Floats) -> Floats:
    """Centre boxes (..., 4) in other pixels; the centre of pixel 0 is half a pixel from the border."""
    corners = np.asarray(boxes, dtype=np.float64)
    shift = np.array([0.5, 0.5, 0.0, 0.0])
    return np.asarray((corners + shift) * factors - shift)
