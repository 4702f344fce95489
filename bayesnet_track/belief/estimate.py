"""One state that stands for a belief in tracks and pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Posterior, Step
from bayesnet_track.graph import spec

Floats = NDArray[np.float64]


def estimate(chosen: spec.Estimate | None, step: Step[Posterior]) -> Floats:
    """(D,) the state that stands for the belief after a step; the MAP when nothing is chosen.

    - `map`: largest posterior density, prior density included.
    - `best`: hypothesis of the largest weight.
    - `mean`: mean of the belief, which lies between the modes of a bimodal one.
    - `robust_mean`: weighted mean of the hypotheses whose centres lie within `box` sqrt(w h) of the best,
      in x and in y (tracking chapter, estimators).
    """
    kind = "map" if chosen is None else chosen.kind
    if kind == "map":
        return step.map_state
    if kind == "mean":
        return step.posterior.mean
    states, weights = step.support.states, step.support.weights.weights
    best = np.asarray(states[int(np.argmax(weights))])
    if kind == "best" or chosen is None or chosen.robust_mean is None:
        return best
    reach = chosen.robust_mean.box * float(np.sqrt(best[2] * best[3]))
    near = np.all(np.abs(states[:, :2] - best[:2]) <= reach, axis=1)
    return np.asarray(weights[near] @ states[near] / weights[near].sum())
