"""The Rauch-Tung-Striebel smoother: a filtered sequence of Gaussians, backward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.gaussian.predict import predict, unscented_cross
from bayesnet_track.belief.motion.bounds import Confined
from bayesnet_track.belief.motion.jumps import jumping_of
from bayesnet_track.belief.smoothing.backward import Move
from bayesnet_track.graph import spec
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import symmetric


def smooth_gaussians(
    filtered: Sequence[GaussianPosterior], moves: Sequence[Move], settings: spec.Gaussian
) -> list[GaussianPosterior]:
    """The Gaussians of every frame given the whole sequence (Rauch, Tung and Striebel 1965).

    With the filtered m, P, the prediction m-, P- from them, and C = cov(x_t, x_{t+1}): G = C P-^-1,
    m_s = m + G (m_s' - m-), P_s = P + G (P_s' - P-) G'. Exact for `kalman`; for `extended` with the Jacobian
    at m, for `unscented` with C of the sigma points. Nothing is learnt across a jump: the belief began anew.

    Args:
        filtered: T beliefs, in order.
        moves: T - 1, from each to the next.
        settings: of the filter.

    Raises:
        ValueError: `moves` are not one fewer than `filtered`.
    """
    if len(moves) != len(filtered) - 1:
        raise ValueError(f"{len(filtered)} beliefs need {len(filtered) - 1} moves, not {len(moves)}")
    smoothed = [filtered[-1]]
    for belief, move in zip(reversed(filtered[:-1]), reversed(moves), strict=True):
        if jumping_of(move.motion) is not None:
            smoothed.append(belief)
            continue
        after = smoothed[-1]
        mean, covariance = predict(belief.mean, belief.covariance, move.motion, move.dt, settings)
        gain = _cross(belief, move, settings) @ np.linalg.pinv(covariance, rcond=1e-12, hermitian=True)
        held = belief.mean + gain @ (after.mean - mean)
        held[2:4] = np.maximum(held[2:4], 1.0)
        spread = symmetric(belief.covariance + gain @ (after.covariance - covariance) @ gain.T)
        smoothed.append(replace(belief, mean=held, covariance=spread))
    return smoothed[::-1]


def _cross(belief: GaussianPosterior, move: Move, settings: spec.Gaussian) -> Floats:
    """(D, D) covariance of the state with the one that it moves to."""
    free: MotionModel = move.motion.motion if isinstance(move.motion, Confined) else move.motion
    if settings.filter == "unscented":
        return unscented_cross(belief.mean, belief.covariance, free, move.dt, settings.sigma)
    return np.asarray(belief.covariance @ free.linearise(belief.mean, move.dt)[0].T)
