"""Smoothing of a finished run: backward simulation, the most probable trajectory, Rauch-Tung-Striebel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.gaussian.belief import GaussianPosterior, cross_covariance, predict
from bayesnet_track.belief.gaussian.modal import ModalPosterior, mix, mixture_moments, modal_in, motions_of
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


Gaussians = GaussianPosterior | ModalPosterior


def smooth_gaussians(
    filtered: Sequence[Gaussians], moves: Sequence[Move], settings: spec.Gaussian
) -> list[Gaussians]:
    """The Gaussians of every frame given the whole sequence (Rauch, Tung and Striebel 1965).

    With the filtered m, P, the prediction m-, P- from them, and C = cov(x_t, x_{t+1}): G = C P-^-1,
    m_s = m + G (m_s' - m-), P_s = P + G (P_s' - P-) G'. Exact for `kalman`; for `extended` with the Jacobian
    at m, for `unscented` with C of the sigma points. Nothing is learnt across a jump: the belief began anew.

    In modes it is done for each pair of them. What later frames say of mode j and its state is the ratio
    of the smoothed to the predicted Gaussian of j. It weighs p(x_t+1 | i, j), the prediction of mode i's
    Gaussian by the motion of j, and a pair has the weight mu_i P_ij times the integral of that product. The
    pairs of each i are matched by moments: the only approximation, as in the filter, where the motion is
    linear. Over the last step, and for categories, which never follow each other, nothing is approximate.

    Args:
        filtered: T beliefs, in order.
        moves: T - 1, from each to the next.
        settings: of the filter.

    Raises:
        ValueError: `moves` are not one fewer than `filtered`, or some beliefs are in modes and some not.
    """
    if len(moves) != len(filtered) - 1:
        raise ValueError(f"{len(filtered)} beliefs need {len(filtered) - 1} moves, not {len(moves)}")
    smoothed: list[Gaussians] = [filtered[-1]]
    for belief, move in zip(reversed(filtered[:-1]), reversed(moves), strict=True):
        following = smoothed[-1]
        if jumping_of(move.motion) is not None:
            smoothed.append(belief)
        elif isinstance(belief, ModalPosterior) and isinstance(following, ModalPosterior):
            smoothed.append(_back_in_modes(belief, following, move, settings))
        elif isinstance(belief, GaussianPosterior) and isinstance(following, GaussianPosterior):
            smoothed.append(_back(belief, following, move, settings))
        else:
            raise ValueError("beliefs in modes and beliefs without")
    return smoothed[::-1]


def _back(
    belief: GaussianPosterior, following: GaussianPosterior, move: Move, settings: spec.Gaussian
) -> GaussianPosterior:
    """One step of `smooth_gaussians`."""
    mean, covariance = predict(belief.mean, belief.covariance, move.motion, move.dt, settings)
    gain = cross_covariance(belief, move.motion, move.dt, settings) @ np.linalg.pinv(
        covariance, rcond=1e-12, hermitian=True
    )
    smoothed_mean = belief.mean + gain @ (following.mean - mean)
    smoothed_mean[2:4] = np.maximum(smoothed_mean[2:4], 1.0)
    spread = symmetric(belief.covariance + gain @ (following.covariance - covariance) @ gain.T)
    return replace(belief, mean=smoothed_mean, covariance=spread)


def _back_in_modes(
    belief: ModalPosterior, following: ModalPosterior, move: Move, settings: spec.Gaussian
) -> ModalPosterior:
    """One step of `smooth_gaussians` in modes."""
    motions = motions_of(move.motion)
    chain = modal_in(move.motion).modes.chain.over(move.dt)
    joint = chain * belief.mode_probabilities[:, None]
    size, width = len(motions), len(belief.mean)
    log, means = np.full((size, size), -np.inf), np.zeros((size, size, width))
    covariances = np.zeros((size, size, width, width))
    mixed = mix(belief, chain)
    for successor, motion in enumerate(motions):
        if following.mode_probabilities[successor] <= 0.0 or mixed.mode_probabilities[successor] <= 0.0:
            continue
        prior = mixed.parts[successor]
        mean, covariance = predict(prior.mean, prior.covariance, motion, move.dt, settings)
        message = _future_of(mean, covariance, following.parts[successor])
        log_ratio = np.log(following.mode_probabilities[successor] / mixed.mode_probabilities[successor])
        for mode in np.flatnonzero(joint[:, successor] > 0.0).tolist():
            part = belief.parts[mode]
            predicted = predict(part.mean, part.covariance, motion, move.dt, settings)
            future_mean, future_covariance, log_mass = message.weigh(*predicted)
            target = replace(part, mean=future_mean, covariance=future_covariance)
            pair = _back(part, target, Move(motion, move.dt), settings)
            means[mode, successor], covariances[mode, successor] = pair.mean, pair.covariance
            log[mode, successor] = np.log(joint[mode, successor]) + log_ratio + log_mass
    top = log.max()
    if not np.isfinite(top):
        return belief
    weights = np.exp(log - top)
    shares = weights.sum(axis=1)
    parts = list(belief.parts)
    for mode in np.flatnonzero(shares > 0.0).tolist():
        share = weights[mode] / shares[mode]
        mean, covariance = mixture_moments(means[mode], covariances[mode], share)
        parts[mode] = replace(parts[mode], mean=mean, covariance=covariance)
    return ModalPosterior(tuple(parts), np.asarray(shares / shares.sum()))


@dataclass(frozen=True, eq=False)
class Future:
    """A ratio of Gaussians, smoothed to predicted, where the predicted one is standard normal.

    exp(-z' precision z / 2 + pull' z - log_norm), where x = origin + basis z.

    Attributes:
        origin: (D,) the predicted mean.
        basis: (D, R) its spread's root.
        precision: (R, R), none of whose eigenvalues is negative.
        pull: (R,).
        log_norm: so that the mean over the prediction is 1.
    """

    origin: Floats
    basis: Floats
    precision: Floats
    pull: Floats
    log_norm: float

    def weigh(self, mean: Floats, covariance: Floats) -> tuple[Floats, Floats, float]:
        """Mean and covariance of a Gaussian times the ratio, and the logarithm of their product's mass."""
        whitening = np.linalg.pinv(self.basis)
        place, spread = whitening @ (mean - self.origin), whitening @ covariance @ whitening.T
        shrinkage = np.linalg.inv(np.eye(len(spread)) + spread @ self.precision)
        product = symmetric(np.asarray(shrinkage @ spread))
        log_mass = 0.5 * float(
            np.linalg.slogdet(shrinkage)[1]
            - place @ shrinkage.T @ self.precision @ place
            + 2.0 * self.pull @ shrinkage @ place
            + self.pull @ product @ self.pull
        )
        product_mean = shrinkage @ (place + spread @ self.pull)
        remainder = mean - self.origin - self.basis @ place
        return (
            self.origin + self.basis @ product_mean + remainder,
            symmetric(covariance + self.basis @ (product - spread) @ self.basis.T),
            log_mass - self.log_norm,
        )


def _future_of(mean: Floats, covariance: Floats, smoothed: GaussianPosterior) -> Future:
    """The ratio of a smoothed Gaussian to the predicted one of this mean and covariance."""
    values, vectors = np.linalg.eigh(covariance)
    keep = values > 1e-12 * max(values[-1], 1e-300)
    basis = vectors[:, keep] * np.sqrt(values[keep])
    whitening = (vectors[:, keep] / np.sqrt(values[keep])).T
    spread, axes = np.linalg.eigh(symmetric(whitening @ smoothed.covariance @ whitening.T))
    inverse = 1.0 / np.maximum(spread, 1e-12)
    pull = axes @ (inverse * (axes.T @ (whitening @ (smoothed.mean - mean))))
    weight = np.maximum(inverse - 1.0, 0.0)
    projections = axes.T @ pull
    log_norm = 0.5 * float(np.sum(projections**2 / (1.0 + weight) - np.log1p(weight)))
    return Future(mean, basis, np.asarray((axes * weight) @ axes.T), pull, log_norm)
