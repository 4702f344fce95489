"""Many beliefs on the same hypotheses at once: a prior tilted by each of several likelihoods.

One call on a matrix costs a fraction of many calls on its rows, which are short.
"""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats


def tilt(prior_log: Floats, log_likelihoods: Floats) -> Floats:
    """(M, N) normalised log-weights: the prior (N,) times each likelihood (M, N).

    A likelihood that leaves nothing positive and finite says nothing: its row is the prior. Of T targets, the
    priors are (T, N) and the likelihoods (M, T, N).

    >>> np.exp(tilt(np.log([0.5, 0.5]), np.log([[1.0, 3.0]]))).round(2).tolist()
    [[0.25, 0.75]]
    """
    log = log_likelihoods + prior_log
    top = log.max(axis=-1, initial=-np.inf)
    lost = ~np.isfinite(top)  # also where there is a NaN: it is the maximum then
    if lost.any():
        log[lost] = np.broadcast_to(prior_log, log.shape)[lost]
        top[lost] = log[lost].max(axis=-1)
    log -= top[..., None]
    log -= np.log(np.exp(log).sum(axis=-1))[..., None]
    return np.asarray(log)


def divergences(f: Floats, g: Floats) -> Floats:
    """(M,) KL(f || g_m) in nats of normalised log-weights, as `numerics.divergence.kl`.

    Args:
        f: (N,) or (M, N).
        g: (M, N), or (N,) for all rows of f.

    Of T targets, (M, T, N) gives (M, T).
    """
    shared = np.exp(f)
    if shared.all():
        terms = shared * (f - g)
    else:
        with np.errstate(invalid="ignore"):  # 0 times the infinity of log 0, which counts nothing
            terms = shared * (f - g)
        terms[np.broadcast_to(shared == 0.0, terms.shape)] = 0.0
    return np.asarray(np.maximum(terms.sum(axis=-1), 0.0))
