"""Whose is which detection, in passes: by score (Zhang et al. 2022), by the last one (Cao et al. 2023)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from bayesnet_track.adapt.assign import assign_total, assign_total_pairs
from bayesnet_track.adapt.association import NOBODY, Owners
from bayesnet_track.adapt.observed import LAST, direction_consistency
from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.observation.cue import AssociationRule

Pass = Literal["first", "second", "last"]
Ask = Callable[[Pass, Owners, Owners], Owners]
"""One pass: the targets (T,) and detections (N,) that take part -> (T,) which of these each is given."""


def share_in_passes(rule: AssociationRule, scores: Floats, count: int, ask: Ask) -> Owners:
    """(T,) the detection of each of `count` targets, or `NOBODY`; `scores` (N,) are the detections'.

    First those of at least `first_score`, for all targets; then the others, for the targets left; with
    `recover` at last what is left of the first, by the targets' last detections.
    """
    owner = np.full(count, NOBODY, dtype=np.intp)
    is_first = scores >= rule.first_score
    is_free = np.ones(len(scores), dtype=np.bool_)

    def give(by: Pass, takes_part: Bools) -> None:
        rows, free = (owner == NOBODY).nonzero()[0], (takes_part & is_free).nonzero()[0]
        if len(rows) and len(free):
            chosen = ask(by, rows, free)
            got = chosen != NOBODY
            given = free[chosen[got]]
            owner[rows[got]] = given
            is_free[given] = False

    give("first", is_first)
    if not is_first.all():
        give("second", ~is_first)
    if rule.recover:
        give("last", is_first)
    return owner


def share_by_overlap(
    rule: AssociationRule, expected: Floats, observed: Floats, boxes: Floats, scores: Floats
) -> Owners:
    """(T,) the detection of each target, or `NOBODY`, by overlap with the boxes (T, 4) that are expected.

    `observed` (T, H) is what is remembered of the targets' detections (`adapt.observed`). All overlaps count
    in the assignment; pairs that overlap by less than `min_overlap` are rejected after it.
    """

    def ask(by: Pass, rows: Owners, columns: Owners) -> Owners:
        reference = observed[rows, LAST] if by == "last" else expected[rows]
        if by == "first" and rule.direction > 0:
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

    order = np.argsort(boxes[:, 0], kind="stable")
    places, reach = boxes[order, 0], (reference[:, 2] + boxes[:, 2].max(initial=0.0)) / 2
    starts = np.searchsorted(places, reference[:, 0] - reach)
    ends = np.searchsorted(places, reference[:, 0] + reach, side="right")
    return overlap_rows(np.ascontiguousarray(reference), np.ascontiguousarray(boxes), order, starts, ends)


def _by_overlap_alone(rule: AssociationRule, reference: Floats, boxes: Floats) -> Owners:
    pairs = overlapping_pairs(reference, boxes)
    return assign_total_pairs(*pairs, len(reference), len(boxes), rule.min_overlap)
