"""GOSPA (Rahmathullah et al. 2017) of frames, and OSPA(2) (Beard, Vo & Vo 2020) of whole trajectories."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.evaluate.mot_pairs import FramePairs, Pairs, assign
from bayesnet_track.numerics.arrays import Floats

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


def gospa(pairs: Pairs, cutoff_px: float = CUTOFF_PX, order: float = ORDER) -> Gospa:
    """GOSPA of a sequence.

    In each frame boxes are matched one to one so that the sum is least: d^p for each pair, where d is the
    distance of the box centres, and c^p / 2 for each box without a partner.

    Raises:
        ValueError: a cut-off of 0 or less, or an order below 1.
    """
    check_metric(cutoff_px, order)
    localisation, matched = 0.0, 0
    for frame in pairs.frames:
        cost, count = _match(frame, cutoff_px, order)
        localisation += cost
        matched += count
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


def _match(frame: FramePairs, cutoff_px: float, order: float) -> tuple[float, int]:
    """Sum of d^p over the matched pairs, and their number."""
    costs = np.minimum(frame.distance, cutoff_px) ** order
    rows, columns = assign(cutoff_px**order - costs)  # a pair at c costs as much as both boxes alone
    near = frame.distance[rows, columns] < cutoff_px
    return float(costs[rows, columns][near].sum()), int(near.sum())


def ospa2(pairs: Pairs, cutoff_px: float = CUTOFF_PX, order: float = ORDER) -> float:
    """OSPA of order p and cut-off c between the true targets and the tracks, in px, 0 to c.

    Its base distance is that of `track_distances`. Whole tracks are matched one to one; each that the larger
    side has more costs c. 0 when there is neither target nor track.

    Raises:
        ValueError: a cut-off of 0 or less, or an order below 1.
    """
    check_metric(cutoff_px, order)
    costs = track_distances(pairs, cutoff_px) ** order
    fewer, more = sorted(costs.shape)
    if not more:
        return 0.0
    total = costs[assign(-costs)].sum() + cutoff_px**order * (more - fewer)
    return float((total / more) ** (1 / order))


def track_distances(pairs: Pairs, cutoff_px: float) -> Floats:
    """(targets, tracks) time-averaged distances in px: over the frames in which at least one of the two has a
    box, the mean of min(d, c), and of c where only one has.
    """
    below = np.zeros((len(pairs.true_boxes), len(pairs.tracked_boxes)))
    both = np.zeros(below.shape, dtype=np.int64)
    for frame in pairs.frames:
        at = np.ix_(frame.true, frame.tracked)
        below[at] += cutoff_px - np.minimum(frame.distance, cutoff_px)
        both[at] += 1
    either = pairs.true_boxes[:, None] + pairs.tracked_boxes[None, :] - both
    return np.asarray(cutoff_px - below / either, dtype=np.float64)
