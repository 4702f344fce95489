"""Pairs of a true and a tracked box, frame by frame: held of a short sequence, made anew of a long one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.boxes import centre_from_corner, overlap

MOST_HELD = 2_000_000
"""Pairs of boxes that are held in memory, 16 bytes each."""


@dataclass(frozen=True, eq=False)
class FramePairs:
    """All pairs of a true and a tracked box in one frame.

    Attributes:
        index: number of the frame, from 0.
        true: (G,) numbers of the true targets, from 0 without gaps over the sequence.
        tracked: (K,) the same of the tracks.
        iou: (G, K) intersection over union.
        distance: (G, K) Euclidean distance of the box centres in px.
    """

    index: int
    true: Ints
    tracked: Ints
    iou: Floats
    distance: Floats


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
        true, centres = self._true.of_frame(frame)
        tracked, tracked_centres = self._tracked.of_frame(frame)
        a, b = centres[:, None], tracked_centres[None, :]
        distance = np.hypot(a[..., 0] - b[..., 0], a[..., 1] - b[..., 1])
        return FramePairs(frame, true, tracked, overlap(a, b), distance)


def frame_pairs(true: ByFrame, tracked: ByFrame) -> Sequence[FramePairs]:
    """The pairs of each frame with a box, in order."""
    frames = _LazyFrames(true, tracked)
    return tuple(frames) if frames.pairs <= MOST_HELD else frames


def _number(ids: Ints) -> tuple[Ints, Ints]:
    _, numbers, counts = np.unique(ids, return_inverse=True, return_counts=True)
    return numbers.astype(np.int32), counts.astype(np.int64)
