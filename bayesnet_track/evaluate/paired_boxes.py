"""Pairs of a true and a tracked box, in blocks of frames: held of a short sequence, made anew of a long one.

In a file of its own, since who scores boxes need not load the engine.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.boxes import centre_from_corner, overlap

MOST_HELD = 2_000_000
"""Pairs of boxes whose blocks are held in memory."""
_BLOCK_PAIRS = 200_000
"""Pairs that are looked at together: about what fits a processor's cache."""

EdgeList = tuple[Ints, Ints, Floats]
"""Pairs of a block: place of the true box, place of the tracked box, and a figure of both, all (E,)."""


class SuccessiveBoxes(Protocol):
    """Boxes of successive frames, in the order of the frames."""

    @property
    def true(self) -> Ints:
        """(A,) numbers of the true targets, from 0 without gaps over the sequence."""

    @property
    def tracked(self) -> Ints:
        """(B,) the same of the tracks."""

    @property
    def true_frames(self) -> Ints:
        """(A,) frame of each true box, not falling."""

    @property
    def tracked_frames(self) -> Ints:
        """(B,) the same of the tracked ones."""

    @property
    def overlapping(self) -> EdgeList:
        """Pairs in one frame, row by row, with their intersection over union, above 0."""

    def nearer(self, cutoff: float) -> EdgeList:
        """Pairs in one frame, row by row, with the distance of their centres, below the cut-off."""


@dataclass(frozen=True, eq=False)
class BoxBlock:
    """`SuccessiveBoxes` of centre boxes (A, 4) and (B, 4), compared when it is asked for."""

    true: Ints
    tracked: Ints
    true_frames: Ints
    tracked_frames: Ints
    true_boxes: Floats
    tracked_boxes: Floats
    _nearer: dict[float, EdgeList] = field(default_factory=dict)

    @cached_property
    def overlapping(self) -> EdgeList:
        """Pairs that overlap, with their intersection over union."""
        sizes = [boxes[:, 2:].max(axis=0, initial=0.0) for boxes in (self.true_boxes, self.tracked_boxes)]
        rows, columns = self._nearby((sizes[0] + sizes[1]) / 2)
        iou = overlap(self.true_boxes[rows], self.tracked_boxes[columns])
        return _select(iou > 0.0, rows, columns, iou)

    def nearer(self, cutoff: float) -> EdgeList:
        """Pairs whose centres are nearer than the cut-off, with their distance in px."""
        if cutoff not in self._nearer:
            rows, columns = self._nearby(np.full(2, cutoff))
            offsets = self.true_boxes[rows, :2] - self.tracked_boxes[columns, :2]
            distance = np.hypot(offsets[:, 0], offsets[:, 1])
            self._nearer[cutoff] = _select(distance < cutoff, rows, columns, distance)
        return self._nearer[cutoff]

    def _nearby(self, reach: Floats) -> tuple[Ints, Ints]:
        """Pairs in one frame that are nearer than `reach` in x and in y."""
        (true_places, true_centres), (tracked_places, tracked_centres) = self._tables
        is_near = np.ones((), dtype=np.bool_)
        for axis in (0, 1):
            offset = true_centres[axis][:, :, None] - tracked_centres[axis][:, None, :]
            np.abs(offset, out=offset)
            is_near = is_near & (offset <= reach[axis] * (1 + 1e-9))
        frame, i, j = np.nonzero(is_near)
        return true_places[frame, i], tracked_places[frame, j]

    @cached_property
    def _tables(self) -> list[tuple[Ints, Floats]]:
        """`_table` of both sides."""
        frames = np.union1d(self.true_frames, self.tracked_frames)
        sides = (self.true_frames, self.true_boxes), (self.tracked_frames, self.tracked_boxes)
        return [_table(np.searchsorted(frames, of_side), len(frames), boxes) for of_side, boxes in sides]


def _table(rows: Ints, count: int, boxes: Floats) -> tuple[Ints, Floats]:
    """Places of the boxes by frame (F, most), and their x and y (2, F, most), NaN beyond a frame's boxes."""
    sizes = np.bincount(rows, minlength=count)
    starts = np.cumsum(sizes) - sizes
    columns = np.arange(len(rows)) - starts[rows]
    places = np.zeros((count, int(sizes.max(initial=0))), dtype=np.int64)
    places[rows, columns] = np.arange(len(rows))
    centres = np.full((2, *places.shape), np.nan)
    centres[:, rows, columns] = boxes[:, :2].T
    return places, centres


def _select(is_pair: np.ndarray, rows: Ints, columns: Ints, figures: Floats) -> EdgeList:
    return rows[is_pair], columns[is_pair], figures[is_pair]


@dataclass(frozen=True, eq=False)
class BoxPairs:
    """All pairs of a sequence.

    Attributes:
        blocks: of its frames with a box, in order; of a long sequence they are made anew whenever they are
            gone through.
        true_boxes: how many boxes each true target has.
        tracked_boxes: the same of each track.
        length: number of frames up to the last that has a box, those without boxes included.
    """

    blocks: Iterable[SuccessiveBoxes]
    true_boxes: Ints
    tracked_boxes: Ints
    length: int


@dataclass(frozen=True, eq=False)
class _Side:
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
    def ordered(cls, frames: Ints, ids: Ints, boxes: Floats) -> _Side:
        """Boxes in any order; of identities only equality matters."""
        names = np.unique(ids)
        numbers: Any = np.searchsorted(names, ids).astype(np.int32)
        counts = np.bincount(numbers, minlength=len(names))
        if (frames[1:] < frames[:-1]).any():
            order = np.argsort(frames, kind="stable")
            frames, numbers, boxes = frames[order], numbers[order], boxes[order]
        return cls(frames, numbers, boxes, counts)

    def part(self, start: int, end: int) -> _Side:
        """The boxes from `start` up to `end`."""
        places = slice(start, end)
        return _Side(self.frames[places], self.numbers[places], self.boxes[places], self.counts)


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Blocks of a sequence, each made when it is asked for.

    Attributes:
        true: boxes of the ground truth.
        tracked: boxes of the tracks.
        ends: for each block, where it begins and ends among the true boxes and among the tracked ones.
    """

    true: _Side
    tracked: _Side
    ends: Sequence[tuple[int, int, int, int]]

    def __iter__(self) -> Iterator[SuccessiveBoxes]:
        for true_start, true_end, tracked_start, tracked_end in self.ends:
            true, tracked = (
                self.true.part(true_start, true_end),
                self.tracked.part(tracked_start, tracked_end),
            )
            yield BoxBlock(
                true.numbers,
                tracked.numbers,
                true.frames,
                tracked.frames,
                centre_from_corner(true.boxes.astype(np.float64)),
                centre_from_corner(tracked.boxes.astype(np.float64)),
            )


def pair_boxes(true: tuple[Ints, Ints, Floats], tracked: tuple[Ints, Ints, Floats]) -> BoxPairs:
    """Pairs of boxes in any order, by frames (N,), identities (N,) and corner boxes (N, 4) of both sides."""
    sides = _Side.ordered(*true), _Side.ordered(*tracked)
    frames = np.union1d(*(np.unique(side.frames) for side in sides))
    starts = [
        np.searchsorted(side.frames, np.append(frames, frames[-1:] + 1).astype(side.frames.dtype))
        for side in sides
    ]
    counts = [np.diff(start) for start in starts]
    ends, first, largest = [], 0, [0, 0]
    for place, sizes in enumerate(zip(*(count.tolist() for count in counts), strict=True)):
        larger = [max(a, b) for a, b in zip(largest, sizes, strict=True)]
        if (place - first + 1) * max(larger[0] * larger[1], *larger) > _BLOCK_PAIRS and place > first:
            ends.append((first, place))
            first, larger = place, list(sizes)
        largest = larger
    if len(frames):
        ends.append((first, len(frames)))
    (true_starts, tracked_starts) = (start.tolist() for start in starts)
    of_boxes = [(true_starts[a], true_starts[b], tracked_starts[a], tracked_starts[b]) for a, b in ends]
    blocks: Iterable[SuccessiveBoxes] = _Blocks(*sides, of_boxes)
    if int(counts[0] @ counts[1]) <= MOST_HELD:
        blocks = tuple(blocks)
    return BoxPairs(blocks, sides[0].counts, sides[1].counts, int(frames[-1]) + 1 if len(frames) else 0)


T = TypeVar("T")
Measure = Generator[None, SuccessiveBoxes | None, T]
"""A figure of a sequence: it is sent one block after the other, then None, and returns it."""


def measured_blocks(blocks: Iterable[SuccessiveBoxes], *measures: Measure[Any]) -> list[Any]:
    """The figures, of one pass over the blocks: those of a long sequence are made once for all."""
    for measure in measures:
        next(measure)
    for block in blocks:
        for measure in measures:
            measure.send(block)
    return [_result(measure) for measure in measures]


def single_figure(blocks: Iterable[SuccessiveBoxes], measure: Measure[T]) -> T:
    """One figure, of a pass of its own."""
    result: T = measured_blocks(blocks, measure)[0]
    return result


def _result(measure: Measure[T]) -> T:
    try:
        measure.send(None)
    except StopIteration as ended:
        result: T = ended.value
        return result
    raise ValueError("a measure that goes on after the last block")


_MOST_TOGETHER = 1000
"""Rows that are solved for in one call, whose time grows with their square."""


def assign_gains(rows: Ints, columns: Ints, gains: Floats) -> Ints:
    """Places among the pairs (E,) of the one-to-one assignment with the largest sum of gains, all above 0.

    A pair that gains more than the best others of its row and its column together is in every such
    assignment, so that only what such pairs leave is solved for: sparse, by Jonker and Volgenant's method.
    """
    assigned, remaining = [], np.arange(len(gains))
    if not len(gains):
        return remaining
    is_taken_row, is_taken_column = (np.zeros(int(ends.max()) + 1, np.bool_) for ends in (rows, columns))
    while len(remaining):
        i, j, gain = rows[remaining], columns[remaining], gains[remaining]
        is_certain = gain > _rival_gains(i, gain) + _rival_gains(j, gain)
        if not is_certain.any():
            break
        assigned.append(remaining[is_certain])
        is_taken_row[i[is_certain]] = is_taken_column[j[is_certain]] = True
        remaining = remaining[~(is_taken_row[i] | is_taken_column[j])]
    if len(remaining):
        order = np.argsort(rows[remaining], kind="stable")
        assigned.extend(_solved(rows, columns, gains, remaining[order]))
    return np.sort(np.concatenate(assigned))


def _rival_gains(ends: Ints, gains: Floats) -> Floats:
    """(E,) the largest gain of the other pairs with the same end, 0 without any."""
    order = np.lexsort((-gains, ends))
    ordered_ends, ordered = ends[order], gains[order]
    is_first = np.append(True, ordered_ends[1:] != ordered_ends[:-1])
    first = np.flatnonzero(is_first)
    follows = np.append(ordered[1:], 0.0)
    second = np.where(np.append(is_first[1:], True), 0.0, follows)[first]  # 0 where the first is alone
    group = np.cumsum(is_first) - 1
    rivals = np.empty(len(gains))
    rivals[order] = np.where(is_first, second[group], ordered[first][group])
    return rivals


def _solved(rows: Ints, columns: Ints, gains: Floats, places: Ints) -> Iterator[Ints]:
    """Places of the best assignment of the pairs at `places`, connected parts of them at a time."""
    from scipy.sparse import csr_array  # here, because it takes long to import
    from scipy.sparse.csgraph import connected_components, min_weight_full_bipartite_matching

    _, i = np.unique(rows[places], return_inverse=True)
    _, j = np.unique(columns[places], return_inverse=True)
    size = int(i.max()) + 1
    graph = csr_array((np.ones(len(i)), (i, size + j)), (size + int(j.max()) + 1,) * 2)
    _, part = connected_components(graph, directed=False)
    of_rows = part[:size]
    order = np.argsort(of_rows, kind="stable")
    batch_of_part = np.zeros(int(part.max()) + 1, dtype=np.int64)
    batch_of_part[of_rows[order]] = np.arange(size) // _MOST_TOGETHER  # the last row of a part says which
    batch = batch_of_part[of_rows][i]
    for number in np.unique(batch):
        members = np.flatnonzero(batch == number)
        _, row = np.unique(i[members], return_inverse=True)
        _, column = np.unique(j[members], return_inverse=True)
        count, width = int(row.max()) + 1, int(column.max()) + 1
        spare = np.arange(count)  # a column of its own for each row, so that every row has one
        gain = gains[places[members]]
        table = csr_array(
            (np.append(gain + gain.max(), np.full(count, gain.max())),
             (np.append(row, spare).astype(np.int32), np.append(column, width + spare).astype(np.int32))),
            (count, width + count),
        )  # fmt: skip
        solved_rows, solved_columns = min_weight_full_bipartite_matching(table, maximize=True)
        is_pair = solved_columns < width
        keys = row * width + column
        key_order = np.argsort(keys)
        keys_assigned = solved_rows[is_pair] * width + solved_columns[is_pair]
        yield places[members[key_order[np.searchsorted(keys[key_order], keys_assigned)]]]


UNASSIGNED = -1


def continued_matches(block: SuccessiveBoxes, edges: EdgeList, earlier: Ints) -> Ints:
    """(A,) the tracked box that each true box of a block is matched with, or `UNASSIGNED`.

    A pair that is its own row's and column's only one is a match. Only the frames with others are gone
    through one by one. `earlier` (targets,) is the track of each target in the last frame with boxes of both,
    and is brought up to that of this block: a frame without either parts nobody.
    """
    rows, columns, iou = edges
    match = np.full(len(block.true), UNASSIGNED, dtype=np.int64)
    is_shared = (np.bincount(rows)[rows] > 1) | (np.bincount(columns)[columns] > 1) if len(rows) else rows > 0
    match[rows[~is_shared]] = columns[~is_shared]
    frames = np.intersect1d(block.true_frames, block.tracked_frames)
    starts, ends = (np.searchsorted(block.true_frames, frames, side) for side in ("left", "right"))
    shared = np.flatnonzero(is_shared)
    ranks = np.searchsorted(frames, block.true_frames[rows])
    for places in np.split(shared, np.flatnonzero(np.diff(ranks[shared])) + 1) if len(shared) else ():
        if rank := ranks[places[0]]:
            _set_tracks(block, match, slice(starts[rank - 1], ends[rank - 1]), earlier)
        _match_frame(block, (rows[places], columns[places], iou[places]), earlier, match)
    if len(frames):
        _set_tracks(block, match, slice(starts[-1], ends[-1]), earlier)
    return match


def _match_frame(block: SuccessiveBoxes, edges: EdgeList, earlier: Ints, match: Ints) -> None:
    """Match the pairs of one frame, those of `earlier` first."""
    rows, columns, iou = edges
    is_continued = earlier[block.true[rows]] == block.tracked[columns]
    match[rows[is_continued]] = columns[is_continued]
    taken_rows, taken_columns = set(rows[is_continued].tolist()), set(columns[is_continued].tolist())
    remaining = [
        place
        for place, (row, column) in enumerate(zip(rows.tolist(), columns.tolist(), strict=True))
        if row not in taken_rows and column not in taken_columns
    ]
    if remaining:
        i, j = rows[remaining], columns[remaining]
        places = assign_gains(i, j, iou[remaining])
        match[i[places]] = j[places]


def _set_tracks(block: SuccessiveBoxes, match: Ints, boxes: slice, tracks: Ints) -> None:
    """Set the tracks (targets,) to those of some true boxes of a block."""
    tracks.fill(UNASSIGNED)
    matched = match[boxes] != UNASSIGNED
    tracks[block.true[boxes][matched]] = block.tracked[match[boxes][matched]]
