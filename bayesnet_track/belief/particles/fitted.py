"""Densities to draw hypotheses from: mixtures of kernels, and Gaussians fitted to likelihoods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.belief.contract import Ancestors
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.density import mixture_log_density
from bayesnet_track.numerics.gaussian import weighted_moments
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
        chosen = systematic(self.weights.weights, size, rng).astype(np.intp, copy=False)
        steps = rng.standard_normal((size, len(self.root))) @ self.root.T
        return chosen, self.centres[chosen] + steps

    def log_density(self, points: Floats, without_own: int = 0) -> Floats:
        """(N,) log-density of points (N, K); the first `without_own` leave out the component of their index.

        A point that helped to place the kernels would otherwise pay for its own kernel.
        """
        back = np.linalg.inv(self.root).T
        at, centres = points @ back, self.centres @ back
        log_peak = -np.log(np.diagonal(self.root)).sum() - 0.5 * points.shape[1] * np.log(2 * np.pi)
        found = log_mixture(at, self.weights.log, centres)
        own, count = found[:without_own], without_own
        at_own = self.weights.log[:count] - 0.5 * np.sum((at[:count] - centres[:count]) ** 2, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            rest = np.log(-np.expm1(np.minimum(at_own - own, 0.0)))
            found[:count] = np.where(np.isfinite(own), own + rest, own)
        return np.asarray(found + log_peak)


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
        best = terms.max(axis=1)
        terms -= best[:, None]
        np.exp(terms, out=terms)
        result[start : start + rows] = best + np.log(terms.sum(axis=1)) - 0.5 * np.sum(some**2, axis=1)
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

STRETCH = 2.0
"""How far the fit to a flattened likelihood L^t is sharpened again, at most; the rest of 1 / t is caution."""


@dataclass(frozen=True, eq=False)
class Message:
    """A Gaussian likelihood exp(information' x - x' precision x / 2) of K coordinates.

    Attributes:
        precision: (K, K), positive semi-definite.
        information: (K,).
    """

    precision: Floats
    information: Floats


def fit_message(
    points: Floats, beta: LogWeights, log_likelihood: Floats, effective: float = EFFECTIVE[0]
) -> Message:
    """The Gaussian that turns the mean and covariance of a prior sample into those of its posterior.

    Directions in which the posterior is not narrower get no precision. In a surprise few hypotheses hold all
    weight, and their covariance says nothing: then L^t is fitted, t < 1 as large as leaves `effective`
    hypotheses (at most a quarter of all), and the Gaussian is raised to min(1 / t, STRETCH).

    Args:
        points: (N, K) coordinates of the sample.
        beta: their prior weights.
        log_likelihood: (N,) finite or -inf, not all -inf.
        effective: hypotheses that are to count.

    Raises:
        DegenerateWeights: no hypothesis has a positive, finite weight.
    """
    power, posterior = flatten(beta, log_likelihood, min(effective, len(points) / 4))
    centre, spread = weighted_moments(points, beta.weights)
    mean, covariance = weighted_moments(points, posterior.weights)
    # In coordinates in which the prior has covariance 1.
    # Where all of it lies on the image's border a coordinate has no variance of its own.
    root = np.linalg.cholesky(spread + np.diag(1e-9 * np.diagonal(spread) + 1e-12))
    whiten = np.linalg.inv(root)
    variances, axes = np.linalg.eigh(whiten @ covariance @ whiten.T)
    precisions = 1.0 / np.maximum(variances, 1e-6)
    shift = axes.T @ (whiten @ (mean - centre))
    gained = np.maximum(precisions - 1.0, 0.0)
    gained_shift = np.where(gained > 0, precisions * shift, 0.0)
    stretch = min(1.0 / power, STRETCH)
    back = whiten.T @ axes
    precision = (back * (stretch * gained)) @ back.T
    return Message(precision, back @ (stretch * gained_shift) + precision @ centre)


def flatten(beta: LogWeights, log_likelihood: Floats, least: float) -> tuple[float, LogWeights]:
    """t in (0, 1] and beta L^t, normalised, with an effective size of at least `least` where it can be had.

    Raises:
        DegenerateWeights: no hypothesis has a positive, finite weight.
    """
    power, weights = 1.0, beta.times(log_likelihood)[0]
    while weights.ess < least and power > 1e-6:
        power *= 0.8
        weights = beta.times(power * log_likelihood)[0]
    return power, weights


@dataclass(frozen=True, eq=False)
class Fitted:
    """A proposal q(k, x) over pairs of a parent and a state: C components for each of K' parents.

    Attributes:
        transition: p(x | k).
        log_shares: (C, K') log-probability of a component and a parent.
        means: (C, K', K) of the coordinates.
        roots: (C, K', K, K) lower roots of their covariances.
    """

    transition: Transition
    log_shares: Floats
    means: Floats
    roots: Floats

    def draw(self, size: int, rng: np.random.Generator) -> tuple[Ancestors, Floats]:
        """(size,) parents and (size, K) coordinates."""
        flat = systematic(np.exp(self.log_shares).ravel(), size, rng)
        component, parent = np.unravel_index(flat, self.log_shares.shape)
        noise = rng.standard_normal((size, self.means.shape[2]))
        steps = np.einsum("nij,nj->ni", self.roots[component, parent], noise)
        return parent.astype(np.intp, copy=False), self.means[component, parent] + steps

    def log_density(self, points: Floats, parents: Ancestors) -> Floats:
        """(M,) log q(k_m, x_m) of coordinates (M, K) and their parents, per unit of the coordinates."""
        parts = []
        for shares, means, roots in zip(self.log_shares, self.means, self.roots, strict=True):
            root = roots[parents]
            away = np.linalg.solve(root, (points - means[parents])[:, :, None])[:, :, 0]
            log_det = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
            parts.append(shares[parents] - 0.5 * np.sum(away**2 + np.log(2 * np.pi), axis=1) - log_det)
        return np.asarray(np.logaddexp.reduce(parts, axis=0))


def fit_proposal(transition: Transition, weights: LogWeights, message: Message) -> Fitted:
    """beta_k p(x | k) times a Gaussian likelihood, normalised: exact for what both Gaussians say.

    Args:
        transition: p(x | k) of all parents.
        weights: beta, theirs.
        message: the likelihood.
    """
    means, sds = transition.means, transition.sds
    own = sds**-2.0
    # (C, K', K, K): the precisions of motion and message add up.
    precision = own[..., None] * np.eye(means.shape[1]) + message.precision
    covariance = np.linalg.inv(precision)
    information = own * means + message.information
    centres = np.einsum("ckij,ckj->cki", covariance, information)
    # The integral of motion times message over x, without what is the same for all.
    overlap = 0.5 * (
        np.einsum("cki,cki->ck", information, centres)
        - np.sum(own * means**2, axis=2)
        + np.linalg.slogdet(covariance)[1]
        - 2.0 * np.log(sds).sum(axis=2)
    )
    log_shares = transition.log_shares[:, None] + weights.log + overlap
    shares = LogWeights.normalise(log_shares.ravel())[0].log.reshape(log_shares.shape)
    return Fitted(transition, shares, centres, np.linalg.cholesky(covariance))


def paired_log_density(transition: Transition, points: Floats, parents: Ancestors) -> Floats:
    """(M,) log p(x_m | k_m) of coordinates (M, K) and their parents, per unit of the coordinates."""
    means = transition.means[parents]
    parts = []
    for share, sds in zip(transition.log_shares, transition.sds, strict=True):
        away = (points - means) / sds[parents]
        parts.append(share - np.sum(0.5 * (away**2 + np.log(2 * np.pi)) + np.log(sds[parents]), axis=1))
    return np.asarray(np.logaddexp.reduce(parts, axis=0))
