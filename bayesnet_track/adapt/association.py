"""Association of detections with targets: optimal assignment, passes, and the memory of observed boxes.

A row of T targets with beliefs of D fields has these parts, those that a rule needs:

- the last detection, the frame intervals since then, how many detections there were after the first;
- for the direction (Cao et al. 2023): the detections of the last frames, NaN where there was none, and the
  unit vector from an earlier one to the last;
- for the re-update (same paper): mean and covariance of the belief when the last one had been used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.boxes import overlap
from bayesnet_track.numerics.gaussian import chi_square_quantile
from bayesnet_track.observation.cue import OBSERVED, AssociationRule, Reference

Owners = NDArray[np.intp]

COVERED = 0.5
"""Share of the smaller box from which on two boxes are taken for one object, unless said otherwise."""

UNASSIGNED = -1


def distances(a: Floats, b: Floats) -> Floats:
    """(N, K) distances of the centres of boxes (N, 4) and (K, 4), in the mean of both sqrt(w h).

    >>> distances(np.array([[0.0, 0, 4, 4]]), np.array([[3.0, 4, 6, 6]])).tolist()
    [[1.0]]
    """
    separation = np.hypot(*(a[:, None, k] - b[None, :, k] for k in (0, 1)))
    side = (_sides(a)[:, None] + _sides(b)[None]) / 2
    return np.asarray(separation / side, dtype=np.float64)


def alike(a: Floats, b: Floats, max_distance: float, covered: float | None = COVERED) -> NDArray[np.bool_]:
    """(N, K) whether boxes (N, 4) and (K, 4) are one object: no farther apart, or so much covered."""
    if covered is None:
        return np.asarray(distances(a, b) <= max_distance)
    half_a, half_b = a[:, 2:] / 2, b[:, 2:] / 2
    low = np.maximum((a[:, :2] - half_a)[:, None], b[:, :2] - half_b)
    high = np.minimum((a[:, :2] + half_a)[:, None], b[:, :2] + half_b)
    sides = np.maximum(high - low, 0.0)
    shared = sides[..., 0] * sides[..., 1]
    smaller = np.minimum((a[:, 2] * a[:, 3])[:, None], b[:, 2] * b[:, 3])
    return np.asarray((distances(a, b) <= max_distance) | (shared >= covered * smaller))


def pair_up(cost: Floats, limit: Floats) -> Owners:
    """(N,) column of each row of the costs (N, K) that it is paired with, one to one, or `UNASSIGNED`.

    The cheapest pair of all comes first, then the cheapest of what is left; pairs above `limit`, which
    broadcasts to (N, K), are none. Of equal costs the lower row comes first, then the lower column.
    """
    owner = np.full(len(cost), UNASSIGNED, dtype=np.intp)
    rows, columns = np.nonzero(cost <= limit)
    free = np.ones(cost.shape[1], dtype=bool)
    for k in np.argsort(cost[rows, columns], kind="stable"):
        row, column = rows[k], columns[k]
        if owner[row] == UNASSIGNED and free[column]:
            owner[row], free[column] = column, False
    return owner


def associate(
    detections: Floats, live: Floats, sd_px: Floats, max_distance: float, covered: float | None = COVERED
) -> tuple[Owners, NDArray[np.bool_]]:
    """Assignment of detections to targets, and the free ones.

    Args:
        detections: (N, 4) centre boxes.
        live: (K, 4) estimates of the targets that are not lost.
        sd_px: (K,) root mean square sd of x and y of their beliefs.
        apart: within how many box sides a detection is taken for a target's.
        covered: how much of the smaller box another holds that is taken for the same object; None: no share.

    Returns:
        (N,) the live target that it is given to, one to one, or `UNASSIGNED`; and (N,) True where it is no
        target's second detection either.
    """
    if len(live) == 0 or len(detections) == 0:
        return np.full(len(detections), UNASSIGNED, dtype=np.intp), np.ones(len(detections), dtype=bool)
    reach = max_distance + 2.0 * sd_px / _sides(live)
    owner = pair_up(distances(detections, live), np.broadcast_to(reach, (len(detections), len(live))))
    return owner, (owner == UNASSIGNED) & ~alike(detections, live, max_distance, covered).any(axis=1)


def _sides(boxes: Floats) -> Floats:
    return np.asarray(np.sqrt(boxes[:, 2] * boxes[:, 3]))


def gated_gains(
    mean: Floats,
    covariance: Floats,
    boxes: Floats,
    rule: AssociationRule,
    log_looks: Callable[[Floats], Floats],
) -> Floats:
    """(N,) log of what speaks for detections z (N, 4) to be a target's: N(z; m, P + R) L(z)^appearance.

    m (4,) and P (4, 4) are the prediction of its centre box, R the detection's own error, log L(z) what
    `log_looks` gives for boxes (M, 4), at most 0, asked only of those near enough. Constants are left
    out. Unlike the distance alone, the density makes it expensive for an unsure target to take what a
    sure one expects. It is -inf beyond the gates: d^2 - 2 appearance log L above the chi-square quantile of
    `gate`, or too small an overlap.
    """
    residual = boxes - mean
    spread = covariance + rule.variances(boxes)[:, :, None] * np.eye(4)
    d2 = np.einsum("ni,ni->n", residual, np.linalg.solve(spread, residual[:, :, None])[:, :, 0])
    limit = chi_square_quantile(rule.gate, 4)
    is_near = (d2 <= limit) & (overlap(boxes, mean) >= rule.min_overlap)
    if rule.appearance > 0 and is_near.any():
        d2[is_near] -= 2.0 * rule.appearance * log_looks(boxes[is_near])
    return np.where(is_near & (d2 <= limit), -0.5 * (d2 + np.linalg.slogdet(spread)[1]), -np.inf)


def assign(gain: Floats) -> Owners:
    """(N,) column of each row of gains (N, K), one to one, or `UNASSIGNED`.

    As many pairs as can be, and of those the largest sum of gains; -inf forbids a pair. O(N^2 K).

    >>> assign(np.array([[0.0, -1.0], [-0.5, -9.0]])).tolist()
    [1, 0]
    """
    owner = np.full(len(gain), UNASSIGNED, dtype=np.intp)
    is_pair = gain > -np.inf
    rows, columns = np.flatnonzero(is_pair.any(axis=1)), np.flatnonzero(is_pair.any(axis=0))
    if not len(rows):
        return owner
    from scipy.optimize import linear_sum_assignment  # here, because it takes long to import

    costs, possible = -gain[np.ix_(rows, columns)], is_pair[np.ix_(rows, columns)]
    low, high = float(costs[possible].min()), float(costs[possible].max())
    # More expensive than any pairs that could be had instead.
    forbidden = (high - low + 1.0) * (min(costs.shape) + 1)
    costs = np.where(possible, costs - low, forbidden)
    for row, column in zip(*linear_sum_assignment(costs), strict=True):
        if possible[row, column]:
            owner[rows[row]] = columns[column]
    return owner


def assign_total(gain: Floats, is_pair: NDArray[np.bool_]) -> Owners:
    """(N,) column of each row of gains (N, K), one to one, or `UNASSIGNED`: the largest sum of all gains.

    What is not a pair is rejected after the assignment, in which all gains count, as SORT has it (Bewley et
    al. 2016): a row may stay alone though another could have been its own.

    >>> assign_total(np.array([[0.9, 0.5], [0.8, 0.0]]), np.array([[True, True], [True, False]])).tolist()
    [1, 0]
    """
    from scipy.optimize import linear_sum_assignment  # here, because it takes long to import

    owner = np.full(len(gain), UNASSIGNED, dtype=np.intp)
    rows, columns = linear_sum_assignment(gain, maximize=True)
    accepted = is_pair[rows, columns]
    owner[rows[accepted]] = columns[accepted]
    return owner


def assign_total_pairs(
    rows: Owners, columns: Owners, gains: Floats, count: int, column_count: int, min_gain: float
) -> Owners:
    """Assign as `assign_total`, by pairs (P,) of gains above 0; those below `min_gain` are rejected."""

    def by_total(gain: Floats) -> Owners:
        return assign_total(np.maximum(gain, 0.0), gain >= min_gain)

    owner = assign_pairs(rows, columns, gains, count, column_count, by_total)
    accepted = np.zeros(count, dtype=np.bool_)
    accepted[rows[(owner[rows] == columns) & (gains >= min_gain)]] = True
    return np.where(accepted, owner, UNASSIGNED)


def assign_pairs(
    rows: Owners,
    columns: Owners,
    gains: Floats,
    count: int,
    column_count: int,
    assign_group: Callable[[Floats], Owners] = assign,
) -> Owners:
    """Assign as `assign`, by the pairs (P,) not forbidden of `count` rows and `column_count` columns.

    Rows and columns that no pairs connect do not concern each other: each connected group is assigned alone,
    and those in which nobody wants what another wants are plain.
    """
    # Imported here: a graph is validated without compiling anything. What solves the groups, which takes long
    # to import, is not left to the first frame that has one.
    import scipy.optimize  # noqa: F401

    from bayesnet_track.numerics.kernels.pair_kernels import open_groups, settle_pairs

    rows, columns = np.ascontiguousarray(rows), np.ascontiguousarray(columns)  # one compiled version only
    owner, group = settle_pairs(rows, columns, gains, count, column_count)
    matrices, all_rows, all_columns, starts = open_groups(rows, columns, gains, group, count, column_count)
    for (a, r, c), (b, s, d) in pairwise(starts.tolist()):
        own_rows, own_columns = all_rows[r:s], all_columns[c:d]
        assigned = assign_group(matrices[a:b].reshape(s - r, d - c))
        is_given = assigned != UNASSIGNED
        owner[own_rows[is_given]] = own_columns[assigned[is_given]]
    return np.asarray(owner)


LAST, GAP, COUNT = slice(0, 4), 4, 5
FIXED = 6


@dataclass(frozen=True)
class PartColumns:
    """Columns of the parts of a row.

    Attributes:
        frames: L, over how many frames directions are measured; 0 without.
        size: D, of the beliefs that are remembered; 0 without.
    """

    frames: int
    size: int

    @classmethod
    def of(cls, rule: AssociationRule, size: int) -> PartColumns:
        """The layout of a rule, for beliefs of D = `size` fields."""
        return cls(rule.direction_frames if rule.direction > 0 else 0, size if rule.re_update else 0)

    @property
    def recent(self) -> slice:
        """Detections of the last L frames, 4 L."""
        return slice(FIXED, FIXED + 4 * self.frames)

    @property
    def heading(self) -> slice:
        """Unit vector of x, y; NaN while unknown."""
        start = FIXED + 4 * self.frames
        return slice(start, start + (2 if self.frames else 0))

    @property
    def mean(self) -> slice:
        """Mean when the last detection had been used."""
        return slice(self.heading.stop, self.heading.stop + self.size)

    @property
    def covariance(self) -> slice:
        """Its covariance, D * D."""
        return slice(self.mean.stop, self.mean.stop + self.size**2)

    @property
    def width(self) -> int:
        """Length of a row."""
        return int(self.covariance.stop)


def first_observed(rule: AssociationRule, boxes: Floats, size: int) -> Floats:
    """(T, H) of targets that start in the centre boxes (T, 4); (T, 0) where nothing is remembered."""
    if not rule.remembers:
        return np.empty((len(boxes), 0))
    layout = PartColumns.of(rule, size)
    rows = np.full((len(boxes), layout.width), np.nan)
    rows[:, LAST], rows[:, GAP], rows[:, COUNT] = boxes, 0.0, 0.0
    return rows


def remembered(rule: AssociationRule, reference: Reference, mean: Floats) -> Floats:
    """(H,) what a reference holds of this; of a target without detections, the box of its mean (D,)."""
    if OBSERVED in reference:
        return reference[OBSERVED]
    return np.asarray(first_observed(rule, mean[None, :4], len(mean))[0])


def observe_hypotheses(
    rule: AssociationRule,
    observed: Floats,
    previous: tuple[Floats, Floats],
    detections: Floats,
    is_given: Bools,
    elapsed: float,
) -> Floats:
    """(T, H) after a frame in which targets were given `detections` (T, 4), where `is_given`.

    `previous` are means (T, D) and covariances (T, D, D) of the beliefs of the frame before, `elapsed` frame
    intervals earlier.
    """
    if not observed.shape[1]:
        return observed
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.kernels.judging_kernels import append_detections, units_of

    heading = np.empty((len(observed), 2))
    layout, updated = PartColumns.of(rule, previous[0].shape[1]), observed.copy()
    if layout.size:
        parting = ~is_given & (observed[:, GAP] == 0.0)
        updated[parting, layout.mean] = previous[0][parting]
        updated[parting, layout.covariance] = previous[1][parting].reshape(-1, layout.size**2)
    if layout.frames:
        ways = np.where(is_given[:, None], detections[:, :2] - earlier(layout, observed)[:, :2], np.nan)
        heading = units_of(ways)
    append_detections(updated, plain(detections), is_given, FIXED, layout.frames, heading, float(elapsed))
    return updated


def earlier(layout: PartColumns, observed: Floats) -> Floats:
    """(T, 4) the earliest detection within the last L frames, else the last; NaN with the first one only."""
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.kernels.judging_kernels import earlier_rows

    return np.asarray(earlier_rows(plain(observed), COUNT, FIXED, layout.frames))


def direction_consistency(rule: AssociationRule, observed: Floats, boxes: Floats, scores: Floats) -> Floats:
    """(T, N) weight * score * (1/2 - angle / pi): how well the way to a detection goes on from a target's.

    The angle is that between the target's direction and the way from the same earlier detection to each of
    the boxes (N, 4). 0 while a target's direction is not known.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.kernels.judging_kernels import cosines_of, weigh_angles

    layout = PartColumns(rule.direction_frames, 0)
    heading, origin = observed[:, layout.heading], earlier(layout, observed)
    angles = np.arccos(cosines_of(plain(heading), origin, plain(boxes)))
    return np.asarray(weigh_angles(angles, rule.direction * scores))


Pass = Literal["first", "second", "last"]
Ask = Callable[[Pass, Owners, Owners], Owners]
"""One pass: the targets (T,) and detections (N,) that take part -> (T,) which of these each is given."""


def share_in_passes(rule: AssociationRule, scores: Floats, count: int, ask: Ask) -> Owners:
    """(T,) the detection of each of `count` targets, or `UNASSIGNED`; `scores` (N,) are the detections'.

    First those of at least `first_score`, for all targets; then the others, for the targets left; with
    `recover` at last what is left of the first, by the targets' last detections.
    """
    owner = np.full(count, UNASSIGNED, dtype=np.intp)
    is_first = scores >= rule.first_score
    is_free = np.ones(len(scores), dtype=np.bool_)

    def give(stage: Pass, takes_part: Bools) -> None:
        rows, free = (owner == UNASSIGNED).nonzero()[0], (takes_part & is_free).nonzero()[0]
        if len(rows) and len(free):
            assigned = ask(stage, rows, free)
            got = assigned != UNASSIGNED
            columns = free[assigned[got]]
            owner[rows[got]] = columns
            is_free[columns] = False

    give("first", is_first)
    if not is_first.all():
        give("second", ~is_first)
    if rule.recover:
        give("last", is_first)
    return owner


def share_by_overlap(
    rule: AssociationRule, expected: Floats, observed: Floats, boxes: Floats, scores: Floats
) -> Owners:
    """(T,) the detection of each target, or `UNASSIGNED`, by overlap with the boxes (T, 4) that are expected.

    `observed` (T, H) is what is remembered of the targets' detections. All overlaps count
    in the assignment; pairs that overlap by less than `min_overlap` are rejected after it.
    """

    def ask(stage: Pass, rows: Owners, columns: Owners) -> Owners:
        reference = observed[rows, LAST] if stage == "last" else expected[rows]
        if stage == "first" and rule.direction > 0:
            # Imported here: a graph is validated without compiling anything.
            from bayesnet_track.numerics.compiled import plain
            from bayesnet_track.numerics.kernels.judging_kernels import overlaps_of

            consistency = direction_consistency(rule, observed[rows], boxes[columns], scores[columns])
            common = overlaps_of(plain(reference), plain(boxes[columns]))
            return assign_total(common + consistency, common >= rule.min_overlap)
        return _by_overlap_alone(rule, reference, boxes[columns])

    return share_in_passes(rule, scores, len(expected), ask)


def overlapping_pairs(reference: Floats, boxes: Floats) -> tuple[Ints, Ints, Floats]:
    """Rows, columns and intersections over union (P,) of centre boxes (T, 4) and (N, 4) that overlap at all.

    >>> known, found = np.array([[5.0, 5, 4, 4]]), np.array([[90.0, 5, 4, 4], [7.0, 5, 4, 4]])
    >>> [one.tolist() for one in overlapping_pairs(known, found)]
    [[0], [1], [0.3333333333333333]]
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.pair_kernels import overlap_rows

    candidates = near_along_x(
        reference[:, 0], boxes, lambda: (reference[:, 2] + boxes[:, 2].max(initial=0.0)) / 2
    )
    return overlap_rows(np.ascontiguousarray(reference), np.ascontiguousarray(boxes), *candidates)


FEW_PAIRS = 1024
"""So many pairs are looked at in less time than it takes to find those that are near."""


def near_along_x(places: Floats, boxes: Floats, find_reach: Callable[[], Floats]) -> tuple[Ints, Ints, Ints]:
    """The order of centre boxes (N, 4) along x; the first and one past the last near each of `places` (T,).

    Near is what is within the reach (T,), which is not asked for where all pairs are few.
    """
    order, count = np.argsort(boxes[:, 0], kind="stable"), len(places)
    if count * len(boxes) <= FEW_PAIRS:
        return order, np.zeros(count, np.int64), np.full(count, len(boxes), np.int64)
    along, reach = boxes[order, 0], find_reach()
    starts = np.searchsorted(along, places - reach)
    return order, starts, np.searchsorted(along, places + reach, side="right")


def _by_overlap_alone(rule: AssociationRule, reference: Floats, boxes: Floats) -> Owners:
    pairs = overlapping_pairs(reference, boxes)
    return assign_total_pairs(*pairs, len(reference), len(boxes), rule.min_overlap)
