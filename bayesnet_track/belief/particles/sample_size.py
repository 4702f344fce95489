"""How many hypotheses a weighted sample asks for, and why: the methods of thesis 5.4 on states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayesnet_track.graph.settings.particles import AdaptiveSize, BinnedSize, NormalSize
from bayesnet_track.numerics import sample_size
from bayesnet_track.numerics.arrays import Floats

LEAST_EFFECTIVE = 10.0
"""A sample of fewer effective hypotheses cannot measure its own variance, and is no reason to save any."""


@dataclass(frozen=True)
class SampleSize:
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
class SizeMemory:
    """What an adaptive size remembers of a frame.

    Attributes:
        first_pass: hypotheses of the first pass.
        reported: the number that was last written down.
        wanted: what all of them asked for.
    """

    first_pass: int
    reported: int
    wanted: SampleSize


def find_sample_size(
    size: AdaptiveSize, states: Floats, fields: tuple[str, ...], prior_log: Floats, log_likelihood: Floats
) -> SampleSize:
    """What hypotheses (N, D) of prior log-weights and log-likelihoods (N,) ask for: the most over the fields.

    Degenerate weights (none positive, or one not a finite number) ask for nothing and have no effective
    hypotheses, so that `SampleSize.asks` keeps the number that there was.
    """
    with np.errstate(invalid="ignore"):  # -inf + inf is NaN, a degenerate weight
        log = prior_log + log_likelihood
    top = float(np.max(log))
    if not np.isfinite(top):
        return SampleSize(0.0, 0.0)
    weights = np.exp(log - top)
    ess = len(weights) / sample_size.simple_inflation(weights)
    if size.likelihood_sum is not None:
        share = prior_log - np.logaddexp.reduce(prior_log)
        weighted = len(log) * np.exp(share + log_likelihood)
        return SampleSize(sample_size.likelihood_sum(weighted, size.likelihood_sum.threshold), ess)
    asked = [
        _size_by_field(size, name, states[:, fields.index(name)], weights, ess)
        for name in size.settings.fields
    ]
    return max(asked, key=lambda one: one.particles)


def _size_by_field(size: AdaptiveSize, field: str, values: Floats, weights: Floats, ess: float) -> SampleSize:
    if isinstance(size.settings, NormalSize):
        return _normal_size(size, size.settings, field, values, weights, ess)
    wanted: BinnedSize = size.settings
    bins = sample_size.occupied_bins(values, weights, wanted.bin_px)
    worth = _WORTH[size.kind](values, weights)
    particles = sample_size.kld_revised(bins, wanted.error, wanted.confidence, worth)
    return SampleSize(particles, ess, field, bins, worth)


def _normal_size(
    size: AdaptiveSize, wanted: NormalSize, field: str, values: Floats, weights: Floats, ess: float
) -> SampleSize:
    _, error = size.tolerance
    sd, worth = np.sqrt(sample_size.variance(values, weights)), sample_size.inflation(values, weights)
    # Relative to the posterior's sd the variance is divided by Var_p, which leaves the worth alone.
    spread = worth if wanted.error_px is None else sample_size.importance_variance(values, weights)
    particles = sample_size.asymptotic_normal(spread, error, wanted.confidence)
    return SampleSize(particles, ess, field, None, worth, float(sd))


_WORTH: dict[str, Callable[[Floats, Floats], float]] = {
    "kld": lambda values, weights: 1.0,
    "kld_revised": sample_size.inflation,
    "kld_revised_simplified": lambda values, weights: sample_size.simple_inflation(weights),
}
