"""Backward simulation: trajectories drawn from a filtered sequence of weighted hypotheses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import LogWeights

NEGLIGIBLE = 1e-3
"""Weight that the lightest hypotheses of a frame may hold together before they are left out."""


@dataclass(frozen=True, eq=False)
class Move:
    """How states moved between two frames.

    Attributes:
        motion: the model.
        dt: frame intervals.
    """

    motion: MotionModel
    dt: float


def smooth_particles(
    filtered: Sequence[ParticleSet], moves: Sequence[Move], draws: int, rng: np.random.Generator
) -> list[ParticleSet]:
    """The hypotheses of every frame, weighted by the whole sequence.

    `draws` trajectories are drawn backward (Godsill, Doucet and West 2004): x_T by its filtered weight, then
    x_t with probability proportional to w_t p(x_{t+1} | x_t). The weight of a hypothesis is the mean of that
    probability over the trajectories, which has less variance than counting how often it is drawn.

    Args:
        filtered: T beliefs, in order.
        moves: T - 1, from each to the next.
        draws: number of trajectories.
        rng: of the draws.

    A frame from which the motion reaches no drawn state, as after a reset, keeps its filtered weights, and
    trajectories begin anew there.

    Raises:
        ValueError: `moves` are not one fewer than `filtered`.
    """
    if len(moves) != len(filtered) - 1:
        raise ValueError(f"{len(filtered)} beliefs need {len(filtered) - 1} moves, not {len(moves)}")
    last = heaviest(filtered[-1])
    smoothed, drawn = [last], last.states[_draw(last.weights.weights, draws, rng)]
    for belief, move in zip(reversed(filtered[:-1]), reversed(moves), strict=True):
        kept = heaviest(belief)
        with np.errstate(over="ignore"):  # of states that are out of reach
            log = kept.weights.log + move.motion.log_density(drawn, kept.states, move.dt)
        top = log.max(axis=1)
        reached = np.isfinite(top)
        if not reached.any():
            smoothed.append(kept)
            drawn = kept.states[_draw(kept.weights.weights, draws, rng)]
            continue
        shares = np.exp(log[reached] - top[reached, None])
        shares /= shares.sum(axis=1, keepdims=True)
        weights = LogWeights.normalise(np.log(np.maximum(shares.mean(axis=0), 1e-300)))[0]
        smoothed.append(replace(kept, weights=weights))
        rows = np.arange(draws) % len(shares)
        chosen = (shares.cumsum(axis=1)[rows] < rng.random((draws, 1))).sum(axis=1)
        drawn = kept.states[np.minimum(chosen, len(kept) - 1)]
    return smoothed[::-1]


def heaviest(belief: ParticleSet) -> ParticleSet:
    """The belief without its lightest hypotheses."""
    weights = belief.weights.weights
    order = np.argsort(weights)
    keep = np.sort(order[np.searchsorted(weights[order].cumsum(), NEGLIGIBLE) :])
    if len(keep) == len(weights):
        return belief
    return replace(
        belief, states=belief.states[keep], weights=LogWeights.normalise(belief.weights.log[keep])[0]
    )


def _draw(weights: Floats, size: int, rng: np.random.Generator) -> NDArray[np.intp]:
    chosen = np.searchsorted(weights.cumsum(), rng.random(size) * weights.sum())
    return np.asarray(np.minimum(chosen, len(weights) - 1))
