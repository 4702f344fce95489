"""True and tracked boxes of several targets, frame by frame, with their overlaps and distances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.boxes import centre_from_corner, overlap

EPSILON = float(np.finfo(np.float64).eps)
"""What an overlap may lack of a threshold: equal ones count as reaching it."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """Boxes of several targets, in any order; no identity twice in a frame.

    Attributes:
        frames: (N,) indices of frames, from 0.
        ids: (N,) whole numbers; which target each box is of.
        boxes: (N, 4) corner boxes left, top, width, height in px.
        classes: (N,) names of classes, empty where there is none; None if no box has one.
    """

    frames: Ints
    ids: Ints
    boxes: Floats
    classes: NDArray[np.str_] | None = None

    def __len__(self) -> int:
        return len(self.frames)

    def only(self, keep: NDArray[np.bool_]) -> Tracks:
        """The boxes with `keep` (N,)."""
        classes = None if self.classes is None else self.classes[keep]
        return Tracks(self.frames[keep], self.ids[keep], self.boxes[keep], classes)


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
class Pairs:
    """All pairs of a sequence.

    Attributes:
        frames: of each frame with a box, in order.
        true_boxes: how many boxes each true target has.
        tracked_boxes: the same of each track.
    """

    frames: tuple[FramePairs, ...]
    true_boxes: Ints
    tracked_boxes: Ints

    @property
    def length(self) -> int:
        """Number of frames up to the last that has a box, those without boxes included."""
        return 1 + self.frames[-1].index if self.frames else 0


def pair(truth: Tracks, tracks: Tracks) -> Pairs:
    """Every true box beside every tracked box of its frame; of identities only equality matters."""
    (true, true_boxes), (tracked, tracked_boxes) = _number(truth.ids), _number(tracks.ids)
    centres, tracked_centres = centre_from_corner(truth.boxes), centre_from_corner(tracks.boxes)
    rows, tracked_rows = _rows_of_frames(truth.frames), _rows_of_frames(tracks.frames)
    nothing = np.empty(0, dtype=np.int64)
    frames = []
    for frame in sorted(rows.keys() | tracked_rows.keys()):
        i, j = rows.get(frame, nothing), tracked_rows.get(frame, nothing)
        a, b = centres[i][:, None], tracked_centres[j][None, :]
        distance = np.hypot(a[..., 0] - b[..., 0], a[..., 1] - b[..., 1])
        frames.append(FramePairs(frame, true[i], tracked[j], overlap(a, b), distance))
    return Pairs(tuple(frames), true_boxes, tracked_boxes)


def assign(gains: Floats) -> tuple[Ints, Ints]:
    """Rows and columns of the one-to-one assignment with the largest sum of gains (G, K)."""
    from scipy.optimize import linear_sum_assignment  # here, because it takes long to import

    rows, columns = linear_sum_assignment(gains, maximize=True)
    return np.asarray(rows, dtype=np.int64), np.asarray(columns, dtype=np.int64)


def _number(ids: Ints) -> tuple[Ints, Ints]:
    _, numbers, counts = np.unique(ids, return_inverse=True, return_counts=True)
    return numbers.astype(np.int64), counts.astype(np.int64)


def _rows_of_frames(frames: Ints) -> dict[int, Ints]:
    order = np.argsort(frames, kind="stable")
    present, starts = np.unique(frames[order], return_index=True)
    return dict(zip(present.tolist(), np.split(order, starts[1:]), strict=True)) if len(frames) else {}
