"""Pairs of a true and a tracked box, frame by frame: held of a short sequence, made anew of a long one.

In a file of its own, since who scores boxes need not load the engine.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeVar, overload

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.boxes import centre_from_corner, overlap

MOST_HELD = 2_000_000
"""Pairs of boxes that are held in memory, 16 bytes each."""


class FramePairs(Protocol):
    """All pairs of a true and a tracked box in one frame."""

    @property
    def index(self) -> int:
        """Number of the frame, from 0."""

    @property
    def true(self) -> Ints:
        """(G,) numbers of the true targets, from 0 without gaps over the sequence."""

    @property
    def tracked(self) -> Ints:
        """(K,) the same of the tracks."""

    @property
    def iou(self) -> Floats:
        """(G, K) intersection over union, or another similarity from 0 to 1."""

    @property
    def distance(self) -> Floats:
        """(G, K) Euclidean distance of the box centres in px."""


@dataclass(frozen=True, eq=False)
class BoxPairs:
    """`FramePairs` of centre boxes (G, 4) and (K, 4), compared when it is asked for."""

    index: int
    true: Ints
    tracked: Ints
    true_boxes: Floats
    tracked_boxes: Floats

    @cached_property
    def iou(self) -> Floats:
        """(G, K) intersection over union."""
        return overlap(self.true_boxes[:, None], self.tracked_boxes[None, :])

    @cached_property
    def distance(self) -> Floats:
        """(G, K) Euclidean distance of the box centres in px."""
        offsets = [self.true_boxes[:, None, i] - self.tracked_boxes[None, :, i] for i in (0, 1)]
        return np.hypot(*offsets)


@dataclass(frozen=True, eq=False)
class ByFrame:
    """The boxes of one side, ordered by frame.

    Attributes:
        frames: (N,) frame of each box, not falling.
        numbers: (N,) number of its target, from 0 without gaps.
        boxes: (N, 4) corner boxes.
        counts: how many boxes each target has.
    """

    frames: Ints
    numbers: Ints
    boxes: Floats
    counts: Ints

    @classmethod
    def of(cls, frames: Ints, ids: Ints, boxes: Floats) -> ByFrame:
        """Boxes in any order; of identities only equality matters."""
        numbers, counts = _number(ids)
        if (frames[1:] < frames[:-1]).any():
            order = np.argsort(frames, kind="stable")
            frames, numbers, boxes = frames[order], numbers[order], boxes[order]
        return cls(frames, numbers, boxes, counts)

    def of_frame(self, frame: int) -> tuple[Ints, Floats]:
        """Numbers and centre boxes of the targets in a frame."""
        ends = np.array((frame, frame + 1), dtype=self.frames.dtype)  # of another type all would be copied
        start, end = np.searchsorted(self.frames, ends).tolist()
        return self.numbers[start:end], centre_from_corner(self.boxes[start:end].astype(np.float64))


class _LazyFrames(Sequence[FramePairs]):
    """All frames with a box, each made when it is asked for."""

    def __init__(self, true: ByFrame, tracked: ByFrame) -> None:
        self._true, self._tracked = true, tracked
        held, counts = (np.unique(one.frames, return_counts=True) for one in (true, tracked))
        self._indices = np.union1d(held[0], counts[0])
        at_both = np.intersect1d(held[0], counts[0], return_indices=True)
        self.pairs = int(held[1][at_both[1]] @ counts[1][at_both[2]])
        """How many pairs there are in all frames."""

    def __len__(self) -> int:
        return len(self._indices)

    @overload
    def __getitem__(self, place: int) -> FramePairs: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[FramePairs]: ...
    def __getitem__(self, place: int | slice) -> FramePairs | Sequence[FramePairs]:
        if isinstance(place, slice):
            return [self[one] for one in range(*place.indices(len(self)))]
        frame = int(self._indices[place])
        true, true_boxes = self._true.of_frame(frame)
        tracked, tracked_boxes = self._tracked.of_frame(frame)
        return BoxPairs(frame, true, tracked, true_boxes, tracked_boxes)


T = TypeVar("T")
Measure = Generator[None, FramePairs | None, T]
"""A figure of a sequence: it is sent one frame after the other, then None, and returns it."""


def measured(frames: Iterable[FramePairs], *measures: Measure[Any]) -> list[Any]:
    """The figures, of one pass over the frames: those of a long sequence are made once for all."""
    for measure in measures:
        next(measure)
    for frame in frames:
        for measure in measures:
            measure.send(frame)
    return [_result(measure) for measure in measures]


def single_figure(frames: Iterable[FramePairs], measure: Measure[T]) -> T:
    """One figure, of a pass of its own."""
    result: T = measured(frames, measure)[0]
    return result


def _result(measure: Measure[T]) -> T:
    try:
        measure.send(None)
    except StopIteration as ended:
        result: T = ended.value
        return result
    raise ValueError("a measure that goes on after the last frame")


def frame_pairs(true: ByFrame, tracked: ByFrame) -> Sequence[FramePairs]:
    """The pairs of each frame with a box, in order."""
    frames = _LazyFrames(true, tracked)
    return tuple(frames) if frames.pairs <= MOST_HELD else frames


def _number(ids: Ints) -> tuple[Ints, Ints]:
    _, numbers, counts = np.unique(ids, return_inverse=True, return_counts=True)
    return numbers.astype(np.int32), counts.astype(np.int64)
