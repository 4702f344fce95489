"""Smoothing of a finished run: backward simulation, the most probable trajectory, Rauch-Tung-Striebel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.gaussian.belief import GaussianPosterior, cross_covariance, predict
from bayesnet_track.belief.motion.jumps import jumping_of
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.graph import spec
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import symmetric
from bayesnet_track.numerics.log_weights import LogWeights

NEGLIGIBLE = 1e-3
"""Weight that the lightest hypotheses of a frame may hold together before they are left out."""


@dataclass(frozen=True, eq=False)
class Move:
    """Motion of states between two frames.

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
    final = heaviest(filtered[-1])
    smoothed, drawn_states = [final], final.states[_draw(final.weights.weights, draws, rng)]
    for belief, move in zip(reversed(filtered[:-1]), reversed(moves), strict=True):
        particles = heaviest(belief)
        with np.errstate(over="ignore"):  # of states that are out of reach
            log = particles.weights.log + move.motion.log_density(drawn_states, particles.states, move.dt)
        top = log.max(axis=1)
        reached = np.isfinite(top)
        if not reached.any():
            smoothed.append(particles)
            drawn_states = particles.states[_draw(particles.weights.weights, draws, rng)]
            continue
        shares = np.exp(log[reached] - top[reached, None])
        shares /= shares.sum(axis=1, keepdims=True)
        weights = LogWeights.normalise(np.log(np.maximum(shares.mean(axis=0), 1e-300)))[0]
        smoothed.append(replace(particles, weights=weights))
        rows = np.arange(draws) % len(shares)
        indices = (shares.cumsum(axis=1)[rows] < rng.random((draws, 1))).sum(axis=1)
        drawn_states = particles.states[np.minimum(indices, len(particles) - 1)]
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
    indices = np.searchsorted(weights.cumsum(), rng.random(size) * weights.sum())
    return np.asarray(np.minimum(indices, len(weights) - 1))


def most_probable_trajectory(
    filtered: Sequence[ParticleSet], moves: Sequence[Move], on_grid: bool = False
) -> Floats:
    """(T, D) the hypotheses, one a frame, that maximise p(x_1) prod p(x_t | x_t-1) p(y_t | x_t).

    Viterbi's algorithm over the hypotheses (Godsill, Doucet and West 2001). Particles that were drawn from
    the prediction have weights in proportion to p(y_t | x_t); cells of a grid hold the prediction, too, which
    is divided out. Where the motion reaches no hypothesis, as after a reset, a new trajectory begins.

    Args:
        filtered: T beliefs, in order.
        moves: T - 1, from each to the next.
        on_grid: whether the weights hold the prediction.

    Raises:
        ValueError: `moves` are not one fewer than `filtered`.
    """
    if len(moves) != len(filtered) - 1:
        raise ValueError(f"{len(filtered)} beliefs need {len(filtered) - 1} moves, not {len(moves)}")
    particle_sets = [heaviest(belief) for belief in filtered]
    best_log, came = particle_sets[0].weights.log, [np.zeros(len(particle_sets[0]), dtype=np.intp)]
    for previous, current, move in zip(particle_sets[:-1], particle_sets[1:], moves, strict=True):
        with np.errstate(over="ignore"):  # of states that are out of reach
            density = move.motion.log_density(current.states, previous.states, move.dt)
        evidence = current.weights.log
        if on_grid:
            evidence = evidence - np.logaddexp.reduce(density + previous.weights.log, axis=1)
        paths = density + best_log
        parents = paths.argmax(axis=1)
        reached = paths[np.arange(len(paths)), parents]
        if not np.isfinite(reached).any():
            reached, parents = (
                np.full(len(paths), best_log.max()),
                np.full(len(paths), int(best_log.argmax())),
            )
        with np.errstate(invalid="ignore"):
            best_log = np.nan_to_num(evidence + reached, nan=-np.inf)
        came.append(parents)
    index, states = int(best_log.argmax()), []
    for belief, sources in zip(reversed(particle_sets), reversed(came), strict=True):
        states.append(belief.states[index])
        index = int(sources[index])
    return np.array(states[::-1])


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
        following = smoothed[-1]
        mean, covariance = predict(belief.mean, belief.covariance, move.motion, move.dt, settings)
        gain = cross_covariance(belief, move.motion, move.dt, settings) @ np.linalg.pinv(
            covariance, rcond=1e-12, hermitian=True
        )
        smoothed_mean = belief.mean + gain @ (following.mean - mean)
        smoothed_mean[2:4] = np.maximum(smoothed_mean[2:4], 1.0)
        spread = symmetric(belief.covariance + gain @ (following.covariance - covariance) @ gain.T)
        smoothed.append(replace(belief, mean=smoothed_mean, covariance=spread))
    return smoothed[::-1]
