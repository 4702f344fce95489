"""How many hypotheses a weighted sample asks for, and why: the methods of thesis 5.4 on states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.graph.settings.particles import AdaptiveSize, BinnedSize, NormalSize
from bayesnet_track.numerics import sample_size

Floats = NDArray[np.float64]

LEAST_EFFECTIVE = 10.0
"""A sample of fewer effective hypotheses cannot measure its own variance, and is no reason to save any."""


@dataclass(frozen=True)
class Need:
    """What a sample asks for.

    Attributes:
        particles: how many hypotheses, not rounded and not kept in bounds; 0 for as few as may be.
        ess: effective hypotheses of the sample that asks, 0 when its weights are degenerate.
        field: the field that asks for the most, or empty when the method looks at none.
        bins: occupied bins of that field, for the methods that count them.
        worth: hypotheses of the sample that are worth one drawn from the posterior.
        sd_px: sd of that field in the posterior, for the method that bounds the error of the mean.
    """

    particles: float
    ess: float
    field: str = ""
    bins: int | None = None
    worth: float | None = None
    sd_px: float | None = None

    def asks(self, before: int) -> float:
        """The number asked for when there were `before`: no fewer when the sample is too poor to tell."""
        return self.particles if self.ess >= LEAST_EFFECTIVE else max(self.particles, float(before))


@dataclass(frozen=True)
class Sized:
    """What an adaptive size remembers of a frame.

    Attributes:
        drawn: hypotheses of the first pass.
        told: the number that was last written down.
        need: what all of them asked for.
    """

    drawn: int
    told: int
    need: Need


def need_of(
    size: AdaptiveSize, states: Floats, fields: tuple[str, ...], prior_log: Floats, log_likelihood: Floats
) -> Need:
    """The need of hypotheses (N, D) with prior log-weights and log-likelihoods (N,); the largest over fields.

    Degenerate weights (none positive, or one not a finite number) ask for nothing and have no effective
    hypotheses, so that `Need.asks` keeps the number that there was.
    """
    with np.errstate(invalid="ignore"):  # -inf + inf is NaN, a degenerate weight
        log = prior_log + log_likelihood
    top = float(np.max(log))
    if not np.isfinite(top):
        return Need(0.0, 0.0)
    weights = np.exp(log - top)
    ess = len(weights) / sample_size.simple_inflation(weights)
    if size.likelihood_sum is not None:
        share = prior_log - np.logaddexp.reduce(prior_log)
        weighted = len(log) * np.exp(share + log_likelihood)
        return Need(sample_size.likelihood_sum(weighted, size.likelihood_sum.threshold), ess)
    asked = [
        _field_need(size, name, states[:, fields.index(name)], weights, ess) for name in size.settings.fields
    ]
    return max(asked, key=lambda one: one.particles)


def _field_need(size: AdaptiveSize, field: str, values: Floats, weights: Floats, ess: float) -> Need:
    if isinstance(size.settings, NormalSize):
        return _normal_need(size, size.settings, field, values, weights, ess)
    wanted: BinnedSize = size.settings
    bins = sample_size.occupied_bins(values, weights, wanted.bin_px)
    worth = _WORTH[size.kind](values, weights)
    particles = sample_size.kld_revised(bins, wanted.error, wanted.confidence, worth)
    return Need(particles, ess, field, bins, worth)


def _normal_need(
    size: AdaptiveSize, wanted: NormalSize, field: str, values: Floats, weights: Floats, ess: float
) -> Need:
    _, error = size.tolerance
    sd, worth = np.sqrt(sample_size.variance(values, weights)), sample_size.inflation(values, weights)
    # Relative to the posterior's sd the variance is divided by Var_p, which leaves the worth alone.
    spread = worth if wanted.error_px is None else sample_size.importance_variance(values, weights)
    particles = sample_size.asymptotic_normal(spread, error, wanted.confidence)
    return Need(particles, ess, field, None, worth, float(sd))


_WORTH: dict[str, Callable[[Floats, Floats], float]] = {
    "kld": lambda values, weights: 1.0,
    "kld_revised": sample_size.inflation,
    "kld_revised_simplified": lambda values, weights: sample_size.simple_inflation(weights),
}
