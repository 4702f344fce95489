"""Divergences between beliefs on the same hypotheses, and the uncertainty deviation UD.

f is a belief, beta its prior weights, L a likelihood; all live on one set of N hypotheses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights

Floats = NDArray[np.float64]


def kl(log_f: Floats, log_g: Floats) -> float:
    """KL(f || g) = sum f ln(f / g) in nats, of normalised log-weights (N,) on the same hypotheses.

    At least 0; inf where g is 0 and f is not; hypotheses with f = 0 count nothing.

    >>> round(kl(np.log([0.5, 0.5]), np.log([0.25, 0.75])), 4)
    0.1438
    """
    f, g = log_f, log_g
    if f.min() == -np.inf:  # seldom: picking the others costs as much as all the rest
        alive = log_f > -np.inf
        f, g = log_f[alive], log_g[alive]
    if g.min() == -np.inf:
        return float("inf")
    return max(0.0, float(np.dot(np.exp(f), f - g)))


def kl_to_agent(posterior: LogWeights, prior: LogWeights, log_likelihood: Floats) -> float:
    """KL(f || beta L normalised) in nats: how far an agent with likelihood L alone is from the belief f.

    Thesis 2.5, with the prior weights beta. inf when the agent rules out every hypothesis.
    """
    try:
        alone, _ = prior.times(log_likelihood)
    except DegenerateWeights:
        return float("inf")
    return kl(posterior.log, alone.log)


def leave_one_out(prior: LogWeights, log_likelihood: Floats, contribution: Floats) -> float:
    """KL(belief || belief without one child) in nats: what the child contributes.

    Args:
        prior: beta, the prior weights of the N hypotheses.
        log_likelihood: (N,) of the whole net.
        contribution: (N,) what the child adds to it: the whole minus the net without the child, so that
            a pool's weights may change when the child leaves.

    Where the contribution is -inf nothing is known of what the others say: these hypotheses are left out
    of the belief without the child too, and the result is a lower bound. nan when no belief is left.
    """
    known = contribution > -np.inf
    without = np.full(log_likelihood.shape, -np.inf)
    np.subtract(log_likelihood, contribution, out=without, where=known)
    try:
        belief, _ = prior.times(log_likelihood)
        rest, _ = prior.times(without)
    except DegenerateWeights:
        return float("nan")
    return kl(belief.log, rest.log)


def message_strength(prior: LogWeights, log_likelihood: Floats) -> float:
    """KL(beta L normalised || beta) in nats: how much a message says; 0 when it is flat.

    inf when the message rules out every hypothesis. At most log N for equal prior weights.
    """
    try:
        updated, _ = prior.times(log_likelihood)
    except DegenerateWeights:
        return float("inf")
    return kl(updated.log, prior.log)


def uncertainty_deviation(states: Floats, weights: Floats, centre: Floats) -> float:
    """UD = sum w d(h, centre)^2 = tr Cov + |mean - centre|^2 (thesis eqs. 2.11-2.13, corrected).

    Args:
        states: (N, k) the fields that count, in px.
        weights: (N,) weights that sum to 1 (not their logarithms).
        centre: (k,) the MAP hypothesis; for an agent its maximum-likelihood hypothesis.

    Returns:
        UD in px^2.

    >>> states = np.array([[-30.0], [30.0]])
    >>> uncertainty_deviation(states, np.array([0.5, 0.5]), np.array([30.0]))
    1800.0
    """
    away = states - centre
    return float(np.dot(weights, np.einsum("nk,nk->n", away, away)))
