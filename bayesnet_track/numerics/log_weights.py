"""Normalised log-weights: the one place where weights are normalised."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from bayesnet_track.numerics.arrays import Floats


class DegenerateWeights(ValueError):
    """No hypothesis has a positive, finite weight, so the weights say nothing."""


@dataclass(frozen=True, eq=False)
class LogWeights:
    """Log-weights of N hypotheses whose weights sum to 1.

    Attributes:
        log: (N,) float64, read-only, ``logsumexp(log) == 0``; ``-inf`` is a weight of zero.

    Make one with :meth:`uniform` or :meth:`normalise`.

    >>> weights, total = LogWeights.normalise(np.log([1.0, 3.0]))
    >>> weights.weights.round(2).tolist(), round(float(np.exp(total)), 6)
    ([0.25, 0.75], 4.0)
    """

    log: Floats

    @classmethod
    def uniform(cls, size: int) -> LogWeights:
        """Equal weights for `size` hypotheses (at least one): the same object for the same size."""
        if size < 1:
            raise ValueError(f"a belief needs at least one hypothesis, not {size}")
        return _uniform(size)

    @classmethod
    def normalise(cls, unnormalised: Floats) -> tuple[LogWeights, float]:
        """The normalised weights and the log of the sum that was divided out.

        Args:
            unnormalised: (N,) log-weights; ``-inf`` is allowed, NaN and ``+inf`` are not.

        Raises:
            DegenerateWeights: all weights are zero, or one is NaN or ``+inf``.
        """
        log = np.asarray(unnormalised, dtype=np.float64)
        top = float(log.max()) if log.size else -np.inf
        if not math.isfinite(top):  # the maximum of an array with a NaN is NaN
            raise DegenerateWeights(f"the largest of {log.size} log-weights is {top}")
        shares = log - top
        np.exp(shares, out=shares)
        total = top + float(np.log(shares.sum()))
        np.subtract(log, total, out=shares)
        return cls(_frozen(shares)), total

    def __len__(self) -> int:
        return int(self.log.shape[0])

    @cached_property
    def weights(self) -> Floats:
        """(N,) weights that sum to 1, read-only."""
        return _frozen(np.exp(self.log))

    @cached_property
    def ess(self) -> float:
        """Effective sample size 1 / sum(w^2): N for equal weights, 1 when one holds all."""
        return float(np.exp(-_log_sum_exp(2.0 * self.log)))

    def times(self, log_likelihood: Floats) -> tuple[LogWeights, float]:
        """These weights times a likelihood, normalised, and the log of sum(w L) (the evidence).

        Raises:
            DegenerateWeights: nothing positive and finite is left.
        """
        return LogWeights.normalise(self.log + log_likelihood)


def effective(log: Floats) -> Floats:
    """(T,) effective sample sizes of normalised log-weights (T, N)."""
    twice = 2.0 * log
    top = twice.max(axis=1)
    return np.asarray(np.exp(-(top + np.log(np.exp(twice - top[:, None]).sum(axis=1)))))


@lru_cache(maxsize=16)
def _uniform(size: int) -> LogWeights:
    return LogWeights(_frozen(np.full(size, -np.log(size))))


def _log_sum_exp(log: Floats) -> float:
    top = float(np.max(log))
    return top + float(np.log(np.sum(np.exp(log - top))))


def _frozen(array: Floats) -> Floats:
    array.setflags(write=False)
    return array
