"""One state that stands for a belief in tracks and pictures."""

from __future__ import annotations

import numpy as np

from bayesnet_track.belief.contract import Posterior, Step
from bayesnet_track.graph import spec
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.distributions import nearest_probable


def estimate(chosen: spec.Estimate | None, step: Step[Posterior]) -> Floats:
    """(D,) the state that stands for the belief after a step; the MAP when nothing is chosen.

    - `map`: largest posterior density, prior density included.
    - `max_weight`: hypothesis of the largest weight.
    - `mean`: mean of the belief, which lies between the modes of a bimodal one.
    - `robust_mean`: weighted mean of the hypotheses whose centres lie within `box` sqrt(w h) of the best,
      in x and in y (tracking chapter, estimators).
    - `nearest`: of the hypotheses with at least `epsilon` of the largest weight, the one whose centre lies
      nearest to the mean prediction (General Distribution Filter 1.3, corrected). The weights of a grid are
      densities; those of particles that were drawn from the prediction are likelihoods.
    """
    kind = "map" if chosen is None else chosen.kind
    if kind == "map":
        return step.map_state
    if kind == "mean":
        return step.posterior.mean
    states, weights = step.support.states, step.support.weights.weights
    if chosen is not None and chosen.nearest is not None:
        predicted = step.prior.weights @ states[:, :2]
        return np.asarray(states[nearest_probable(states[:, :2], weights, predicted, chosen.nearest.epsilon)])
    best = np.asarray(states[int(np.argmax(weights))])
    if kind == "max_weight" or chosen is None or chosen.robust_mean is None:
        return best
    reach = chosen.robust_mean.box * float(np.sqrt(best[2] * best[3]))
    x, y = (np.abs(states[:, axis] - best[axis]) <= reach for axis in (0, 1))
    near = np.flatnonzero(x & y)
    shares = weights[near]
    return np.asarray(shares @ states[near] / shares.sum())
