"""A Gaussian for each mode: their mixture, and how the modes are mixed before they move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import NormalDist

import numpy as np

from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import symmetric


@dataclass(frozen=True, eq=False)
class ModalPosterior:
    """A mixture of K Gaussians, one for each mode.

    Attributes:
        parts: the Gaussian of the state in each mode.
        mode_probabilities: (K,) of the modes.
    """

    parts: tuple[GaussianPosterior, ...]
    mode_probabilities: Floats

    def __len__(self) -> int:
        return sum(len(part) for part in self.parts)

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the D columns, without the mode."""
        return self.parts[0].fields

    @cached_property
    def mean(self) -> Floats:
        """(D,) of the mixture."""
        return np.asarray(self.mode_probabilities @ np.array([part.mean for part in self.parts]))

    @cached_property
    def covariance(self) -> Floats:
        """(D, D) of the mixture: within modes, and between them."""
        return mixture_moments(
            np.array([part.mean for part in self.parts]),
            np.array([part.covariance for part in self.parts]),
            self.mode_probabilities,
        )[1]

    def uncertainty(self, about: Floats, columns: Sequence[int]) -> float:
        """UD of the mixture."""
        uds = [part.uncertainty(about, columns) for part in self.parts]
        return float(self.mode_probabilities @ np.array(uds))

    def mass_within(self, centre: Floats, radius: float) -> tuple[float, float]:
        """Mass within `radius` px of `centre` (2,), exact."""
        shares = [part.mass_within(centre, radius)[0] for part in self.parts]
        return float(self.mode_probabilities @ np.array(shares)), float("inf")

    def regions(self, shares: Sequence[float]) -> Floats:
        """(S, 4) x_low, x_high, y_low, y_high, px: the central share of the centre's weight on each axis."""
        tails = [((1.0 - share) / 2.0, (1.0 + share) / 2.0) for share in shares]
        bounds = [[self._quantiles(axis, both) for axis in (0, 1)] for both in tails]
        return np.array(bounds).reshape(-1, 4)

    def draw(self, size: int, rng: np.random.Generator) -> Floats:
        """(size, 4) boxes."""
        counts = rng.multinomial(size, self.mode_probabilities / self.mode_probabilities.sum())
        drawn = [part.draw(int(count), rng) for part, count in zip(self.parts, counts, strict=True)]
        return np.concatenate(drawn)

    def _quantiles(self, axis: int, tails: tuple[float, float]) -> tuple[float, float]:
        """By bisection of the mixture's distribution function."""
        means = [float(part.mean[axis]) for part in self.parts]
        sds = [max(float(np.sqrt(max(part.covariance[axis, axis], 0.0))), 1e-9) for part in self.parts]
        normals = [NormalDist(mean, sd) for mean, sd in zip(means, sds, strict=True)]
        weights = self.mode_probabilities.tolist()
        found = []
        for tail in tails:
            low = min(one.inv_cdf(tail) for one in normals)
            high = max(one.inv_cdf(tail) for one in normals)
            for _ in range(60):
                middle = 0.5 * (low + high)
                below = sum(w * one.cdf(middle) for w, one in zip(weights, normals, strict=True))
                low, high = (middle, high) if below < tail else (low, middle)
            found.append(0.5 * (low + high))
        return found[0], found[1]


def mix(prior: ModalPosterior, chain: Floats) -> ModalPosterior:
    """The Gaussian of each mode before it moves: those of all modes that can lead to it, moments matched.

    Mode j is entered from i with probability P_ij mu_i / c_j, where c_j = sum_i P_ij mu_i. Where modes that
    share what follows would be mixed alike, so is everything: no sequence is kept apart.
    """
    joint = chain * prior.mode_probabilities[:, None]
    entered = joint.sum(axis=0)
    means = np.array([part.mean for part in prior.parts])
    covariances = np.array([part.covariance for part in prior.parts])
    parts = []
    for mode, total in enumerate(entered):
        if total <= 0.0:  # no mode leads here
            parts.append(prior.parts[mode])
            continue
        mean, covariance = mixture_moments(means, covariances, joint[:, mode] / total)
        parts.append(replace(prior.parts[mode], mean=mean, covariance=covariance))
    return ModalPosterior(tuple(parts), np.asarray(entered / entered.sum()))


def mixture_moments(means: Floats, covariances: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """(D,) and (D, D) of a mixture of Gaussians of means (K, D), covariances (K, D, D), weights (K,)."""
    mean = weights @ means
    away = means - mean
    within = np.tensordot(weights, covariances, 1)
    return np.asarray(mean), symmetric(within + (away * weights[:, None]).T @ away)
