"""GOSPA of frames and of trajectories, and OSPA(2) of whole trajectories.

The multi-dimensional assignment of trajectory GOSPA is relaxed to a linear program, which is a metric, too,
and never larger.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayesnet_track.evaluate.paired_boxes import (
    BoxPairs,
    Measure,
    SuccessiveBoxes,
    assign_gains,
    single_figure,
)
from bayesnet_track.evaluate.truth import assign_rows
from bayesnet_track.numerics.arrays import Floats, Ints

CUTOFF_PX = 50.0
"""Distance of box centres from which on a track is not on a target."""
ORDER = 2.0


@dataclass(frozen=True)
class Gospa:
    """GOSPA with alpha = 2 over a sequence, in parts that add up in its power p.

    Attributes:
        frames: number of frames K, those without boxes included.
        localisation: sum of d^p over the matched pairs of all frames.
        missed: true boxes without a track nearer than c.
        false: tracked boxes without a target nearer than c.
        cutoff_px: c.
        order: p.
    """

    frames: int
    localisation: float
    missed: int
    false: int
    cutoff_px: float
    order: float

    @property
    def total_px(self) -> float:
        """((1/K) sum over frames of GOSPA^p)^(1/p)."""
        return self._mean_px(self.localisation + self._unmatched * (self.missed + self.false))

    @property
    def localisation_px(self) -> float:
        """Its part from the positions of matched pairs."""
        return self._mean_px(self.localisation)

    @property
    def missed_px(self) -> float:
        """Its part from missed targets."""
        return self._mean_px(self._unmatched * self.missed)

    @property
    def false_px(self) -> float:
        """Its part from false tracks."""
        return self._mean_px(self._unmatched * self.false)

    @property
    def _unmatched(self) -> float:
        return unmatched_cost(self.cutoff_px, self.order)

    def _mean_px(self, total: float) -> float:
        return float((total / self.frames) ** (1 / self.order)) if self.frames else 0.0


def gospa(pairs: BoxPairs, cutoff_px: float = CUTOFF_PX, order: float = ORDER) -> Gospa:
    """GOSPA of a sequence.

    In each frame boxes are matched one to one so that the sum is least: d^p for each pair, where d is the
    distance of the box centres, and c^p / 2 for each box without a partner.

    Raises:
        ValueError: a cut-off of 0 or less, or an order below 1.
    """
    return single_figure(pairs.blocks, frames_gospa(pairs, cutoff_px, order))


def frames_gospa(pairs: BoxPairs, cutoff_px: float, order: float) -> Measure[Gospa]:
    """`gospa`, block by block."""
    check_metric(cutoff_px, order)
    localisation, matched = 0.0, 0
    while (block := (yield)) is not None:
        rows, columns, distance = block.nearer(cutoff_px)
        costs = distance**order
        places = assign_gains(rows, columns, cutoff_px**order - costs)
        localisation += float(costs[places].sum())
        matched += len(places)
    missed, false = int(pairs.true_boxes.sum()) - matched, int(pairs.tracked_boxes.sum()) - matched
    return Gospa(pairs.length, localisation, missed, false, cutoff_px, order)


def unmatched_cost(cutoff_px: float, order: float) -> float:
    """c^p / alpha, what a box without a partner costs, for alpha = 2."""
    return float(cutoff_px**order) / 2


def check_metric(cutoff_px: float, order: float) -> None:
    """Raise ValueError unless 0 < cutoff_px < inf and 1 <= order < inf: else these are no metrics."""
    if not 0 < cutoff_px < np.inf:
        raise ValueError(f"cut-off {cutoff_px:g}; expected a distance above 0 px")
    if not 1 <= order < np.inf:
        raise ValueError(f"order {order:g}; expected a number from 1 on")


def ospa2(pairs: BoxPairs, cutoff_px: float = CUTOFF_PX, order: float = ORDER) -> float:
    """OSPA of order p and cut-off c between the true targets and the tracks, in px, 0 to c.

    Its base distance is that of `track_distances`. Whole tracks are matched one to one; each that the larger
    side has more costs c. 0 when there is neither target nor track.

    Raises:
        ValueError: a cut-off of 0 or less, or an order below 1.
    """
    return ospa2_of(track_distances(pairs, cutoff_px), cutoff_px, order)


def ospa2_of(distances: Floats, cutoff_px: float, order: float) -> float:
    """`ospa2` by the `track_distances`."""
    check_metric(cutoff_px, order)
    costs = distances**order
    larger = max(costs.shape)
    if not larger:
        return 0.0
    matched = costs[assign_rows(cutoff_px**order - costs)]
    total = matched.sum() + cutoff_px**order * (larger - len(matched))
    return float((total / larger) ** (1 / order))


def track_distances(pairs: BoxPairs, cutoff_px: float) -> Floats:
    """(targets, tracks) time-averaged distances in px: over the frames in which at least one of the two has a
    box, the mean of min(d, c), and of c where only one has.
    """
    return single_figure(pairs.blocks, tracks_apart(pairs, cutoff_px))


def tracks_apart(pairs: BoxPairs, cutoff_px: float) -> Measure[Floats]:
    """`track_distances`, block by block."""
    sums = np.zeros((len(pairs.true_boxes), len(pairs.tracked_boxes)))
    common = np.zeros(sums.shape)
    while (block := (yield)) is not None:
        rows, columns, distance = block.nearer(cutoff_px)
        np.add.at(sums, (block.true[rows], block.tracked[columns]), cutoff_px - distance)
        _count_common(block, common)
    either = pairs.true_boxes[:, None] + pairs.tracked_boxes[None, :] - common
    return np.asarray(cutoff_px - sums / either, dtype=np.float64)


def _count_common(block: SuccessiveBoxes, common: Floats) -> None:
    """Add to (targets, tracks) the number of frames of a block in which both have a box."""
    frames = np.intersect1d(block.true_frames, block.tracked_frames)
    present, numbers = [], []
    for of_side, side_frames in (
        (block.true, block.true_frames),
        (block.tracked, block.tracked_frames),
    ):
        is_common = np.isin(side_frames, frames)
        present_numbers, column = np.unique(of_side[is_common], return_inverse=True)
        table = np.zeros((len(frames), len(present_numbers)), dtype=np.float32)
        table[np.searchsorted(frames, side_frames[is_common]), column] = 1.0
        present.append(table)
        numbers.append(present_numbers)
    common[np.ix_(*numbers)] += present[0].T @ present[1]


@dataclass(frozen=True)
class TrajectoryGospa:
    """Trajectory GOSPA of a sequence, in parts that add up in its power p.

    Attributes:
        frames: number of frames K, those without boxes included.
        localisation: sum of d^p over the matched pairs of all frames.
        missed: true boxes without a match.
        false: tracked boxes without a match.
        switches: changes of the track; from or to none, a half. Like the two above it can be a fraction, as
            relaxed assignments can.
        cutoff_px: c.
        order: p.
        switch_px: gamma.
    """

    frames: int
    localisation: float
    missed: float
    false: float
    switches: float
    cutoff_px: float
    order: float
    switch_px: float

    @property
    def total_px(self) -> float:
        """The metric, divided by K^(1/p): without switches, GOSPA of the sequence."""
        unmatched = unmatched_cost(self.cutoff_px, self.order) * (self.missed + self.false)
        return self._mean_px(self.localisation + unmatched + self.switch_px**self.order * self.switches)

    @property
    def switches_px(self) -> float:
        """Its part from changes of the track."""
        return self._mean_px(self.switch_px**self.order * self.switches)

    def _mean_px(self, total: float) -> float:
        return float((max(total, 0.0) / self.frames) ** (1 / self.order)) if self.frames else 0.0


def trajectory_gospa(
    pairs: BoxPairs,
    cutoff_px: float = CUTOFF_PX,
    order: float = ORDER,
    switch_px: float | None = None,
) -> TrajectoryGospa:
    """Trajectory GOSPA of a sequence.

    `switch_px` (gamma) is c / 2^(1/p) unless given: a switch then costs as much as a missed box.

    Raises:
        ValueError: a cut-off of 0 or less, an order below 1, or a switch cost below 0.
        RuntimeError: the linear program could not be solved.
    """
    check_metric(cutoff_px, order)
    gamma = unmatched_cost(cutoff_px, order) ** (1 / order) if switch_px is None else switch_px
    if not 0 <= gamma < np.inf:
        raise ValueError(f"switch cost {gamma:g}; expected a distance from 0 px on")
    gain = matched = switches = 0.0
    for part in _parts(pairs, cutoff_px, order):
        weights = _solve(part, gamma**order / 2)
        gain += float((part.gains * weights).sum())
        matched += float(weights[part.gains > 0].sum())
        switches += float(np.abs(np.diff(weights, axis=0)).sum()) / 2
    missed, false = float(pairs.true_boxes.sum()) - matched, float(pairs.tracked_boxes.sum()) - matched
    localisation = cutoff_px**order * matched - gain
    return TrajectoryGospa(pairs.length, localisation, missed, false, switches, cutoff_px, order, gamma)


@dataclass(frozen=True, eq=False)
class _Part:
    """Targets and tracks that have to do with each other, directly or through others, and nobody else.

    Attributes:
        gains: (F, P) c^p - d^p of each pair in each frame in which one of them is nearer than c; else 0.
        true: (P,) the target of each pair that is ever nearer than c.
        tracked: (P,) its track.
    """

    gains: Floats
    true: Ints
    tracked: Ints


def _parts(pairs: BoxPairs, cutoff_px: float, order: float) -> Iterator[_Part]:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    frames, true, tracked, gains = [], [], [], []
    for block in pairs.blocks:
        i, j, distance = block.nearer(cutoff_px)
        frames.append(block.true_frames[i])
        true.append(block.true[i])
        tracked.append(block.tracked[j])
        gains.append(cutoff_px**order - distance**order)
    if not frames:
        return
    row, i, j, gain = (np.concatenate(array) for array in (frames, true, tracked, gains))
    targets = len(pairs.true_boxes)
    size = targets + len(pairs.tracked_boxes)
    _, labels = connected_components(coo_array((np.ones(len(i)), (i, targets + j)), (size, size)), False)
    for label in np.unique(labels[i]):
        members = labels[i] == label
        _, time_index = np.unique(row[members], return_inverse=True)  # frames without gain change nothing
        pairs_present, pair = np.unique(np.stack([i[members], j[members]]), axis=1, return_inverse=True)
        table = np.zeros((time_index.max() + 1, pairs_present.shape[1]))
        table[time_index, pair.ravel()] = gain[members]
        yield _Part(table, pairs_present[0], pairs_present[1])


def _solve(part: _Part, half_switch: float) -> Floats:
    """(F, P) weights 0..1 that gain most, at most 1 in all for a target or a track in a frame.

    Where a pair gains nothing, its weight is constant until it gains again: the least weight of such a
    stretch changes no gain, leaves more room for others, and costs no more in changes.
    """
    from scipy.optimize import linprog
    from scipy.sparse import block_array, coo_array, eye_array

    frames, count = part.gains.shape
    if count == 1:
        return np.ones((frames, 1))  # alone, a pair has nothing to gain from parting
    gains = part.gains > 0
    starts = np.vstack([np.ones((1, count), dtype=bool), gains[1:] | gains[:-1]])
    weight = np.cumsum(starts.T).reshape(count, frames).T - 1  # number of each one that is free
    size = int(weight.max()) + 1
    groups = [side == label for side in (part.true, part.tracked) for label in np.unique(side)]
    shared = [np.unique(weight[:, members], axis=0) for members in groups if members.sum() > 1]
    limited = sum(len(sums) for sums in shared)
    rows = np.repeat(np.arange(limited), np.concatenate([[sums.shape[1]] * len(sums) for sums in shared]))
    columns = np.concatenate([sums.ravel() for sums in shared])
    capacity = coo_array((np.ones(len(rows)), (rows, columns)), (limited, size))
    later = weight[1:][starts[1:]]
    changes = len(later)
    each = np.arange(changes)
    change = coo_array(
        (np.repeat([1.0, -1.0], changes), (np.tile(each, 2), np.append(later, later - 1))), (changes, size)
    )
    localization_error = -eye_array(changes)
    answer = linprog(
        np.append(-np.bincount(weight.ravel(), part.gains.ravel(), size), np.full(changes, half_switch)),
        A_ub=block_array(
            [[capacity, None], [change, localization_error], [-change, localization_error]], format="csr"
        ),
        b_ub=np.append(np.ones(limited), np.zeros(2 * changes)),
        bounds=(0, 1),
        method="highs",
    )
    if answer.x is None:
        raise RuntimeError(f"trajectory GOSPA: {answer.message}")
    return np.asarray(answer.x[weight], dtype=np.float64)
