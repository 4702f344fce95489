"""OSPA(2) (Beard, Vo & Vo 2020): the distance of two sets of whole trajectories."""

from __future__ import annotations

import numpy as np

from bayesnet_track.evaluate.gospa import CUTOFF_PX, ORDER, check_metric
from bayesnet_track.evaluate.mot_pairs import Pairs, assign
from bayesnet_track.numerics.arrays import Floats


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
