"""The maximum a posteriori hypothesis, prior density included."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.numerics.density import mixture_argmax
from bayesnet_track.numerics.log_weights import LogWeights

Floats = NDArray[np.float64]


def map_index(
    log_likelihood: Floats,
    states: Floats,
    parents: Floats,
    weights: LogWeights,
    motion: MotionModel,
    dt: float,
) -> int:
    """argmax_i L(x_i) sum_k beta_k p(x_i | x_k): the hypothesis of the largest posterior density.

    The hypothesis of the largest weight is the maximum *likelihood* one when hypotheses come from the prior
    with equal weights (thesis 2.5, corrected).

    Args:
        log_likelihood: (N,) log L, finite or -inf.
        states: (N, D) hypotheses, after the motion.
        parents: (K, D) the belief before the motion.
        weights: beta, its K weights.
        motion: what leads from parents to states.
        dt: the time between, in frame intervals.
    """
    transition = motion.transition(parents, dt)
    points, log_jacobian = transition.coordinates(states)
    components, width = transition.sds.shape[0], points.shape[1]
    log_weights = (transition.log_shares[:, None] + weights.log).ravel()
    means = transition.means if components == 1 else np.tile(transition.means, (components, 1))
    sds = transition.sds.reshape(len(means), width)
    return mixture_argmax(log_likelihood + log_jacobian, points, log_weights, means, sds)
