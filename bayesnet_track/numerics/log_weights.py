"""Normalised log-weights, divergences between them, and beliefs tilted or sharpened by likelihoods.

f is a belief, beta its prior weights, L a likelihood; all live on one set of N hypotheses.

One call on a matrix costs a fraction of many calls on its rows, which are short.

A cue that is uncertain of itself multiplies a width or an exponent by its step. The product of all steps
stands in its reference, so that it is bounded over all episodes of uncertainty, not only within one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from bayesnet_track.numerics.arrays import Array, Floats


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


def kl(log_f: Floats, log_g: Floats) -> float:
    """KL(f || g) = sum f ln(f / g) in nats, of normalised log-weights (N,) on the same hypotheses.

    At least 0; inf where g is 0 and f is not; hypotheses with f = 0 count nothing.

    >>> round(kl(np.log([0.5, 0.5]), np.log([0.25, 0.75])), 4)
    0.1438
    """
    f, g = log_f, log_g
    if f.min() == -np.inf:  # seldom: picking the others costs as much as all the rest
        alive = log_f > -np.inf
        f, g = log_f[alive], log_g[alive]
    if g.min() == -np.inf:
        return float("inf")
    return max(0.0, float(np.dot(np.exp(f), f - g)))


def column_index(columns: Sequence[int]) -> slice | list[int]:
    """Index of these columns: a slice, which copies nothing, where they stand side by side."""
    side_by_side = _slice_of(tuple(columns))
    return list(columns) if side_by_side is None else side_by_side


@lru_cache(maxsize=64)
def _slice_of(columns: tuple[int, ...]) -> slice | None:
    first, size = columns[0], len(columns)
    return slice(first, first + size) if columns == tuple(range(first, first + size)) else None


def uncertainty_deviation(states: Floats, weights: Floats, centre: Floats) -> float:
    """UD = sum w d(h, centre)^2 = tr Cov + |mean - centre|^2 (thesis eqs. 2.11-2.13, corrected).

    Args:
        states: (N, k) the fields that count, in px.
        weights: (N,) weights that sum to 1 (not their logarithms).
        centre: (k,) the MAP hypothesis; for an agent its maximum-likelihood hypothesis.

    Returns:
        UD in px^2.

    >>> states = np.array([[-30.0], [30.0]])
    >>> uncertainty_deviation(states, np.array([0.5, 0.5]), np.array([30.0]))
    1800.0
    """
    if len(centre) == 2:  # column by column, in half of the time
        x, y = states[:, 0] - centre[0], states[:, 1] - centre[1]
        return float(np.dot(weights, x * x + y * y))
    deviations = states - centre
    return float(np.dot(weights, np.einsum("nk,nk->n", deviations, deviations)))


def uncertainties(states: Floats, weights: Floats, centres: Floats) -> list[float]:
    """UD of each target (`uncertainty_deviation`): (T, N, K), (T, N) about (T, K)."""
    deviations = (states - centres[:, None]).reshape(-1, states.shape[2])
    squares = np.einsum("nk,nk->n", deviations, deviations).reshape(weights.shape)
    return [float(np.dot(*pair)) for pair in zip(weights, squares, strict=True)]


def tilt(prior_log: Floats, log_likelihoods: Floats) -> Floats:
    """(M, N) normalised log-weights: the prior (N,) times each likelihood (M, N).

    A likelihood that leaves nothing positive and finite says nothing: its row is the prior. Of T targets, the
    priors are (T, N) and the likelihoods (M, T, N).

    >>> np.exp(tilt(np.log([0.5, 0.5]), np.log([[1.0, 3.0]]))).round(2).tolist()
    [[0.25, 0.75]]
    """
    log = log_likelihoods + prior_log
    top = log.max(axis=-1, initial=-np.inf)
    lost = ~np.isfinite(top)  # also where there is a NaN: it is the maximum then
    if lost.any():
        log[lost] = np.broadcast_to(prior_log, log.shape)[lost]
        top[lost] = log[lost].max(axis=-1)
    log -= top[..., None]
    log -= np.log(np.exp(log).sum(axis=-1))[..., None]
    return np.asarray(log)


def divergences(f: Floats, g: Floats) -> Floats:
    """(M,) KL(f || g_m) in nats of normalised log-weights, as `kl`.

    Args:
        f: (N,) or (M, N).
        g: (M, N), or (N,) for all rows of f.

    Of T targets, (M, T, N) gives (M, T); f may be (T, N).
    """
    shared = np.exp(f)
    if shared.all():
        terms = shared * (f - g)
    else:
        with np.errstate(invalid="ignore"):  # 0 times the infinity of log 0, which counts nothing
            terms = shared * (f - g)
        terms[np.broadcast_to(shared == 0.0, terms.shape)] = 0.0
    return np.asarray(np.maximum(terms.sum(axis=-1), 0.0))


SHARPER = "sharper"
"""Name, in a reference, of the factor () on the cue's width or exponent; 1 as learnt."""

STEPS = 3
"""How many steps a cue goes, in one episode of uncertainty and in all."""

MOST_BACK = 0.05
"""Largest share of the way back to 1 that a cue goes in one frame: the default of `learn.rate_max`.

References learn only while the belief is certain, so it is learning that takes the factor back. Flow and
depth are learnt so fast that it would be gone within a frame.
"""


def factor_of(reference: Mapping[str, Array]) -> float:
    """The factor on the width or exponent; 1 in a reference that was stored before there was one."""
    return float(reference.get(SHARPER, 1.0))


def sharpen(reference: Mapping[str, Array], attempt: int, step: float) -> dict[str, Array] | None:
    """The reference one step sharper, at most `STEPS` steps from 1; None when nothing is left to try.

    `attempt` counts from 1 within an episode; `step` is below 1 for a width, above 1 for an exponent.

    >>> reference = {"sharper": np.array(1.0)}
    >>> for attempt in (1, 2, 3):
    ...     reference = sharpen(reference, attempt, 0.5)
    >>> factor_of(reference), sharpen(reference, 1, 0.5)
    (0.125, None)
    """
    factor, limit = factor_of(reference), step**STEPS
    if attempt > STEPS or np.isclose(factor, limit):
        return None
    bound = max if step < 1.0 else min
    return {**reference, SHARPER: np.array(bound(factor * step, limit))}


def relax(current: Mapping[str, Array], target: Mapping[str, Array], rate: float) -> dict[str, Array]:
    """`SHARPER` alone, moved from `current` toward `target` by `rate`, but by `MOST_BACK` at most.

    >>> old, new = {"sharper": np.array(0.5)}, {"sharper": np.array(1.0)}
    >>> [round(factor_of(relax(old, new, rate)), 4) for rate in (0.0, 0.02, 0.3)]
    [0.5, 0.51, 0.525]
    """
    return {
        SHARPER: relax_all(np.asarray(factor_of(current)), np.asarray(factor_of(target)), np.asarray(rate))
    }


def relax_all(current: Floats, target: Floats, rates: Floats) -> Floats:
    """Factors moved from `current` toward `target` in the same way, those of several targets at once."""
    shares = np.minimum(rates, MOST_BACK)
    return np.asarray((1.0 - shares) * current + shares * target)
