"""Densities to draw hypotheses from: mixtures of kernels, and Gaussians fitted to likelihoods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.belief.contract import Ancestors
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.density import mixture_log_density
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.numerics.resampling import systematic

_BLOCK = 2**20
"""Pairs of a point and a component summed in one go: bounds the memory."""


@dataclass(frozen=True, eq=False)
class Kernels:
    """A mixture of Gaussians of one covariance.

    Attributes:
        weights: of the M components.
        centres: (M, K).
        root: (K, K) lower root of the covariance.
    """

    weights: LogWeights
    centres: Floats
    root: Floats

    def draw(self, size: int, rng: np.random.Generator) -> tuple[Ancestors, Floats]:
        """(size,) components and (size, K) points."""
        components = systematic(self.weights.weights, size, rng).astype(np.intp, copy=False)
        steps = rng.standard_normal((size, len(self.root))) @ self.root.T
        return components, self.centres[components] + steps

    def log_density(self, points: Floats, without_own: int = 0) -> Floats:
        """(N,) log-density of points (N, K); the first `without_own` leave out the component of their index.

        A point that helped to place the kernels would otherwise pay for its own kernel.
        """
        back = np.linalg.inv(self.root).T
        whitened, centres = points @ back, self.centres @ back
        log_peak = -np.log(np.diagonal(self.root)).sum() - 0.5 * points.shape[1] * np.log(2 * np.pi)
        log_densities = log_mixture(whitened, self.weights.log, centres)
        with_own, count = log_densities[:without_own], without_own
        at_own = self.weights.log[:count] - 0.5 * np.sum((whitened[:count] - centres[:count]) ** 2, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            log_others = np.log(-np.expm1(np.minimum(at_own - with_own, 0.0)))
            log_densities[:count] = np.where(np.isfinite(with_own), with_own + log_others, with_own)
        return np.asarray(log_densities + log_peak)


def log_mixture(points: Floats, log_weights: Floats, centres: Floats) -> Floats:
    """(N,) log sum_m w_m exp(-|point_n - centre_m|^2 / 2); O(N M)."""
    middle = centres.mean(axis=0)  # squares are expanded: subtract first what would cancel
    points, centres = points - middle, centres - middle
    fixed = log_weights - 0.5 * np.sum(centres**2, axis=1)
    result = np.empty(len(points))
    rows = max(1, _BLOCK // len(centres))
    for start in range(0, len(points), rows):
        some = points[start : start + rows]
        terms = some @ centres.T + fixed
        peaks = terms.max(axis=1)
        terms -= peaks[:, None]
        np.exp(terms, out=terms)
        result[start : start + rows] = peaks + np.log(terms.sum(axis=1)) - 0.5 * np.sum(some**2, axis=1)
    return result


def log_prior(transition: Transition, weights: LogWeights, points: Floats) -> Floats:
    """(N,) log sum_k beta_k p(x_n | k) of coordinates (N, K), per unit of the coordinates; O(N K')."""
    parts = []
    for share, sds in zip(transition.log_shares, transition.sds, strict=True):
        if (sds == sds[0]).all():
            sd = sds[0]
            peak = share - np.log(sd).sum() - 0.5 * len(sd) * np.log(2 * np.pi)
            parts.append(peak + log_mixture(points / sd, weights.log, transition.means / sd))
        else:
            rows = max(1, _BLOCK // len(sds))
            starts = range(0, len(points), rows)
            blocks = [
                mixture_log_density(points[start : start + rows], weights.log, transition.means, sds)
                for start in starts
            ]
            parts.append(share + np.concatenate(blocks))
    return np.asarray(np.logaddexp.reduce(parts, axis=0))


EFFECTIVE = (40, 4)
"""Effective hypotheses that Gaussians are fitted to; sharper likelihoods are flattened until there are.

Many make a fit that is right for one mode. Few stay within the mode that the frame favours where the prior
has several: the flatter a likelihood, the more it is of all of them."""


def flatten_to_ess(beta: LogWeights, log_likelihood: Floats, least_ess: float) -> tuple[float, LogWeights]:
    """t in (0, 1] and beta L^t, normalised, with an effective size from `least_ess` on where it can be had.

    Raises:
        DegenerateWeights: no hypothesis has a positive, finite weight.
    """
    power, weights = 1.0, beta.times(log_likelihood)[0]
    while weights.ess < least_ess and power > 1e-6:
        power *= 0.8
        weights = beta.times(power * log_likelihood)[0]
    return power, weights
