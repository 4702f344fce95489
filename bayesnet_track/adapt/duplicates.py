"""Which live targets have beliefs that hold the same object: pure functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bayesnet_track.adapt.association import Owners
from bayesnet_track.graph.settings.lifecycle import MergeDuplicates
from bayesnet_track.numerics.arrays import Floats

SAME_PLACE = 0.1
"""Places this share of a box apart are one object: beliefs are widened by so much to be compared."""


def belief_overlap(mean_a: Floats, cov_a: Floats, mean_b: Floats, cov_b: Floats) -> Floats:
    """Bhattacharyya coefficient, 0..1, of two Gaussians of x, y, w, h, both widened by `SAME_PLACE` of a box.

    exp(-D), D = d' S^-1 d / 8 + ln(det S / sqrt(det S_a det S_b)) / 2, S = (S_a + S_b) / 2. Means: (..., 4)
    and covariances (..., 4, 4).

    >>> box, sure = np.array([50.0, 40, 20, 20]), np.zeros((4, 4))
    >>> round(float(belief_overlap(box, sure, box + [4, 0, 0, 0], sure)), 6)  # exp(-(4 / 2)^2 / 8)
    0.606531
    """
    box = (mean_a + mean_b) / 2
    widening = ((SAME_PLACE * box[..., [2, 3, 2, 3]]) ** 2)[..., None] * np.eye(4)
    first, second = cov_a + widening, cov_b + widening
    both = (first + second) / 2
    d = (mean_a - mean_b)[..., None]
    shape = np.linalg.slogdet(both)[1] - (np.linalg.slogdet(first)[1] + np.linalg.slogdet(second)[1]) / 2
    apart = (np.swapaxes(d, -1, -2) @ np.linalg.solve(both, d))[..., 0, 0]
    return np.asarray(np.exp(-apart / 8 - np.maximum(shape, 0.0) / 2))


def overlapping(
    names: Sequence[str],
    means: Floats,
    covariances: Floats,
    since: Sequence[int],
    before: Mapping[tuple[str, str], tuple[float, ...]],
    rule: MergeDuplicates,
) -> dict[tuple[str, str], tuple[float, ...]]:
    """(younger, older) -> overlaps of their beliefs in the last frames; means (T, 4), covariances (T, 4, 4).

    No more than `rule.frames` of them; only pairs that overlap by `rule.overlap` in this frame. Of those born
    in one frame the later named is the younger. Targets whose centres lie a box apart are not compared.
    """
    first, second = near_pairs(means, covariances, rule.overlap)
    if not len(first):
        return {}
    values = belief_overlap(means[first], covariances[first], means[second], covariances[second])
    streaks = {}
    for pair in np.flatnonzero(values >= rule.overlap).tolist():
        i, j, value = int(first[pair]), int(second[pair]), float(values[pair])
        older, younger = (names[k] for k in sorted((i, j), key=lambda k: (since[k], k)))
        streak = (*before.get((younger, older), ()), value)
        streaks[younger, older] = streak[-rule.frames :]
    return streaks


def near_pairs(boxes: Floats, covariances: Floats, least: float = 0.0) -> tuple[Owners, Owners]:
    """Rows i < j (P,) of centre boxes (T, 4) whose centres lie less than a box apart, in order.

    Left out are those whose fields, each alone, rule out an overlap of `least`: cheap, and leaves few.

    >>> near_pairs(np.array([[0.0, 0, 4, 4], [9, 0, 4, 4], [3, 0, 4, 4]]), np.zeros((3, 4, 4)))
    (array([0]), array([2]))
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.kernels.box_kernels import pairs_alike

    order, sides = np.argsort(boxes[:, 0], kind="stable"), np.sqrt(boxes[:, 2] * boxes[:, 3])
    variances = plain(np.diagonal(covariances, axis1=1, axis2=2))
    limit = -8.0 * np.log(least) * (1.0 + 1e-9) if least > 0.0 else np.inf
    ends = pairs_alike(plain(boxes), sides, variances, order, limit, SAME_PLACE)
    if not len(ends[0]):
        return ends
    low, high = np.minimum(*ends), np.maximum(*ends)
    away = np.hypot(boxes[low, 0] - boxes[high, 0], boxes[low, 1] - boxes[high, 1])
    near = away / ((sides[low] + sides[high]) / 2) < 1.0
    low, high = low[near], high[near]
    by_rows = np.lexsort((high, low))
    return low[by_rows], high[by_rows]
