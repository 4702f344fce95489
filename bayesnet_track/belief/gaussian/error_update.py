"""Update of a Gaussian belief by measurements whose errors are not Gaussian, or depend on the state.

A quantity z = h(x) + e has one dimension: with s = h(x) linearised at the mean, s ~ N(h(m), S) before it, and
the density of s given z is N(s) p(z - s) up to a constant. Its mean and variance are integrals over a line,
taken by Gauss-Legendre rules on panels that are short where either factor is narrow. What is known of s moves
the rest of the state as in a Kalman filter (assumed density filtering):

    m' = m + G (E[s] - h(m)),  P' = P - G (S - Var[s]) G',  G = P H' / S

This is exact in mean and covariance for one quantity with a linear h; the next one begins with the Gaussian
of these moments. Where the distribution depends on the state, it is that at E[x | s].
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from bayesnet_track.belief.motion.formulas import derivative
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import Updated, symmetric
from bayesnet_track.observation.cue import Measurement

PRIOR_SDS = np.arange(-9.0, 10.0)
"""Ends of panels around the prediction, in its sds."""

ERROR_SCALES = np.concatenate([-(2.0 ** np.arange(6, -4, -1)), [0.0], 2.0 ** np.arange(-3, 7)])
"""Ends of panels around what was measured, in the error's sds."""

NODES = 12


@lru_cache(maxsize=1)
def _rule() -> tuple[Floats, Floats]:
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    return np.asarray(nodes, dtype=np.float64), np.asarray(weights, dtype=np.float64)


def update_by_errors(
    mean: Floats, covariance: Floats, fields: tuple[str, ...], measured: Measurement
) -> Updated | None:
    """The Gaussian after a measurement with `errors`; None where a quantity has no value near the mean.

    The log-likelihood is that of the measurement, in units of its `log_peak`.
    """
    assert measured.seen is not None and measured.errors is not None
    total = 0.0
    for number in range(len(measured.fields)):
        after = _update_by_one(mean, covariance, fields, (measured, number))
        if after is None:
            return None
        mean, covariance = after.mean, after.covariance
        total += after.log_likelihood
    return Updated(mean, covariance, 0.0, total - (measured.log_peak or 0.0))


def _update_by_one(
    mean: Floats, covariance: Floats, fields: tuple[str, ...], one: tuple[Measurement, int]
) -> Updated | None:
    measured, number = one
    seen, errors = measured.seen, measured.errors
    assert seen is not None and errors is not None

    def of(states: Floats) -> Floats:
        values = seen.function(dict(zip(fields, states.T, strict=True)))
        return np.asarray(values)

    centre = of(mean[None])[0]
    if not np.isfinite(centre).all():
        return None
    slope = derivative(lambda states: np.asarray(centre + seen.less(of(states), centre)), mean)[number]
    if not np.isfinite(slope).all():
        return None
    away = float(seen.less(measured.mean, centre)[number])
    variance = float(slope @ covariance @ slope)

    def log_density(shift: Floats) -> Floats:
        """(M,) of what was measured, where s is moved by `shift` (M,) from its prediction."""
        gain = covariance @ slope / variance if variance > 0 else np.zeros(len(mean))
        states = mean + shift[:, None] * gain
        left = np.zeros((len(shift), len(measured.fields)))
        left[:, number] = away - shift
        return errors.log_density(dict(zip(fields, states.T, strict=True)), left)[:, number]

    if not variance > 0.0:
        log = float(log_density(np.zeros(1))[0])
        return Updated(mean, covariance, 0.0, max(log, -1e300))
    spread, scale = variance**0.5, float(measured.covariance[number, number]) ** 0.5
    ends = np.unique(np.concatenate([spread * PRIOR_SDS, away + scale * ERROR_SCALES]))
    half = np.diff(ends)[:, None] / 2.0
    nodes, weights = _rule()
    shift = (ends[:-1, None] + half * (1.0 + nodes)).ravel()
    log_prior = -0.5 * (shift / spread) ** 2 - np.log(spread) - 0.5 * np.log(2.0 * np.pi)
    log = log_prior + log_density(shift) + np.log((half * weights).ravel())
    top = float(log.max())
    if not np.isfinite(top):
        return None
    shares = np.exp(log - top)
    mass = float(shares.sum())
    moved = float(shares @ shift) / mass
    left = float(shares @ (shift - moved) ** 2) / mass
    gain = covariance @ slope / variance
    return Updated(
        mean + gain * moved,
        symmetric(covariance - np.outer(gain, gain) * (variance - left)),
        0.0,
        top + float(np.log(mass)),
    )
