"""Compiled kernel: how well the boxes that a network proposes explain hypotheses."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled


@compiled
def explained(boxes: Floats, proposals: Floats, logs: Floats, sd_place: float, sd_size: float) -> Floats:
    """(N,) largest logs[m] - d^2 / 2 over the proposals (M, 4) for each centre box (N, 4).

    d^2 adds the differences of the centres, in `sd_place` sides of the proposal, and of the logs of the
    sides, in `sd_size`; -inf without proposals.
    """
    own = np.log(proposals[:, 2:])
    found = np.full(len(boxes), -np.inf)
    for n in range(len(boxes)):
        x, y = boxes[n, 0], boxes[n, 1]
        w, h = np.log(boxes[n, 2]), np.log(boxes[n, 3])
        for m in range(len(proposals)):
            if logs[m] <= found[n]:
                continue
            across = (x - proposals[m, 0]) / (sd_place * proposals[m, 2])
            down = (y - proposals[m, 1]) / (sd_place * proposals[m, 3])
            wider, higher = (w - own[m, 0]) / sd_size, (h - own[m, 1]) / sd_size
            value = logs[m] - 0.5 * (across * across + down * down + wider * wider + higher * higher)
            if value > found[n]:
                found[n] = value
    return found
