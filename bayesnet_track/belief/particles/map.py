"""The maximum a posteriori hypothesis, prior density included."""

from __future__ import annotations

import numpy as np

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.motion.jumps import modal_of
from bayesnet_track.belief.motion.modal import Modal
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.density import mixture_argmax
from bayesnet_track.numerics.log_weights import LogWeights

Before = tuple[Floats, LogWeights]
"""The belief before the motion: (K, D) states and their weights, normalised or not."""


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
    modal = modal_of(motion)
    if modal is not None:
        return _index_of_modes(log_likelihood, states, (parents, weights), modal, dt)
    return _index(log_likelihood, states, (parents, weights), motion, dt)


def _index_of_modes(log_likelihood: Floats, states: Floats, before: Before, modal: Modal, dt: float) -> int:
    """The best of the hypotheses of each mode, then the best of these."""
    parents, weights = before
    modes, own = states[:, -1].astype(np.intp), np.ascontiguousarray(parents[:, :-1])
    with np.errstate(divide="ignore"):
        log_chain = np.log(modal.chain.over(dt))[parents[:, -1].astype(np.intp)]
    found, values = [], []
    for mode, motion in enumerate(modal.motions):
        chosen = np.flatnonzero(modes == mode)
        if not len(chosen):
            continue
        here, log_before = np.ascontiguousarray(states[chosen, :-1]), weights.log + log_chain[:, mode]
        best = _index(log_likelihood[chosen], here, (own, LogWeights(log_before)), motion, dt)
        density = motion.log_density(here[best : best + 1], own, dt)[0] + log_before
        found.append(int(chosen[best]))
        values.append(float(log_likelihood[chosen[best]] + np.logaddexp.reduce(density)))
    return found[int(np.argmax(values))]


def _index(log_likelihood: Floats, states: Floats, before: Before, motion: MotionModel, dt: float) -> int:
    parents, weights = before
    transition = motion.transition(parents, dt)
    points, log_jacobian = transition.coordinates(states)
    components, width = transition.sds.shape[0], points.shape[1]
    log_weights = (transition.log_shares[:, None] + weights.log).ravel()
    means = transition.means if components == 1 else np.concatenate([transition.means] * components)
    sds = transition.sds.reshape(len(means), width)
    return mixture_argmax(log_likelihood + log_jacobian, points, log_weights, means, sds)
