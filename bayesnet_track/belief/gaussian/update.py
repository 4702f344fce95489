"""Update of a Gaussian belief by moments of a likelihood, and by measurements with any errors.

A quantity z = h(x) + e has one dimension: with s = h(x) linearised at the mean, s ~ N(h(m), S) before it, and
the density of s given z is N(s) p(z - s) up to a constant. Its mean and variance are integrals over a line,
taken by Gauss-Legendre rules on panels that are short where either factor is narrow. What is known of s moves
the rest of the state as in a Kalman filter (assumed density filtering):

    m' = m + G (E[s] - h(m)),  P' = P - G (S - Var[s]) G',  G = P H' / S

This is exact in mean and covariance for one quantity with a linear h; the next one begins with the Gaussian
of these moments. Where the distribution depends on the state, it is that at E[x | s].
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from bayesnet_track.belief.motion.formulas import extended_update, linearise_seen, unscented_update
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import (
    ALONE,
    Updated,
    chi_square_cdf,
    chi_square_quantile,
    linear_update,
    root,
    symmetric,
    update_by_fields,
)
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import Hypotheses, Measurement

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
        update = _update_by_one(mean, covariance, fields, (measured, number))
        if update is None:
            return None
        mean, covariance = update.mean, update.covariance
        total += update.log_likelihood
    return Updated(mean, covariance, 0.0, total - (measured.log_peak or 0.0))


def _update_by_one(
    mean: Floats, covariance: Floats, fields: tuple[str, ...], component: tuple[Measurement, int]
) -> Updated | None:
    measured, number = component
    quantities, errors = measured.seen, measured.errors
    assert quantities is not None and errors is not None

    centre, slopes = (array[0] for array in linearise_seen(mean[None], fields, quantities))
    slope = slopes[number]
    if not (np.isfinite(centre).all() and np.isfinite(slope).all()):
        return None
    innovation = float(quantities.less(measured.mean, centre)[number])
    variance = float(slope @ covariance @ slope)

    def log_density(shift: Floats) -> Floats:
        """(M,) of what was measured, where s is moved by `shift` (M,) from its prediction."""
        gain = covariance @ slope / variance if variance > 0 else np.zeros(len(mean))
        states = mean + shift[:, None] * gain
        residuals = np.zeros((len(shift), len(measured.fields)))
        residuals[:, number] = innovation - shift
        return errors.log_density(dict(zip(fields, states.T, strict=True)), residuals)[:, number]

    if not variance > 0.0:
        log = float(log_density(np.zeros(1))[0])
        return Updated(mean, covariance, 0.0, max(log, -1e300))
    spread, scale = variance**0.5, float(measured.covariance[number, number]) ** 0.5
    ends = np.unique(np.concatenate([spread * PRIOR_SDS, innovation + scale * ERROR_SCALES]))
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
    mean_shift = float(shares @ shift) / mass
    remaining = float(shares @ (shift - mean_shift) ** 2) / mass
    gain = covariance @ slope / variance
    return Updated(
        mean + gain * mean_shift,
        symmetric(covariance - np.outer(gain, gain) * (variance - remaining)),
        0.0,
        top + float(np.log(mass)),
    )


FAR = 1e100
"""Where a quantity has no value, it is so far from what was measured."""


def log_message(measured: Measurement, hypotheses: Hypotheses, fields: tuple[str, ...]) -> Floats:
    """(N,) -d^2 / 2 of hypotheses under a measurement."""
    if measured.choices:
        each = (w * np.exp(log_message(choice, hypotheses, fields)) for w, choice in measured.choices)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(measured.missed + sum(each)))
    states = np.column_stack([hypotheses.boxes, *(hypotheses.fields[name] for name in fields[4:])])
    if measured.errors is not None:
        return replace(measured, floor=0.0).log_by_errors(dict(zip(fields, states.T, strict=True)))
    if measured.seen is None:
        errors = states @ observe_fields(measured, fields).T - measured.mean
    else:
        values = measured.seen.function(dict(zip(fields, states.T, strict=True)))
        errors = np.nan_to_num(measured.seen.less(values, measured.mean), nan=FAR, posinf=FAR, neginf=-FAR)
    return np.asarray(-0.5 * np.einsum("nk,nk->n", errors, np.linalg.solve(measured.covariance, errors.T).T))


def observe_fields(measurement: Measurement, fields: tuple[str, ...]) -> Floats:
    """(K, D) H: the rows of the identity for the fields measured."""
    return np.eye(len(fields))[list(measured_columns(measurement.fields, fields))]


@lru_cache(maxsize=256)
def measured_columns(measured: tuple[str, ...], fields: tuple[str, ...]) -> tuple[int, ...]:
    """(K,) the columns of what was measured among the fields of a state."""
    return tuple(fields.index(name) for name in measured)


WORST = 1e-100
"""The least likelihood of a sigma point, as a share of the best: a parabola has no place for zero."""

LEAST = math.sqrt(ALONE)
"""A field whose sd is less than this share of it when the fields before are known follows from them."""

FLAT = 1e-9
"""Log-likelihoods that differ by less than this, relative to the largest, say nothing: rounding."""


@dataclass(frozen=True, eq=False)
class SigmaPoints:
    """Hypotheses that stand for a Gaussian: their weighted mean and covariance are its own exactly.

    Attributes:
        unit: (N, K) the hypotheses in units of the Gaussian's sds, K the rank of its covariance.
        lower: (D, K) root of the covariance.
        states: (N, D) the hypotheses, sizes at least 1 px, confined to the image where the motion is.
        beta: their weights.
    """

    unit: Floats
    lower: Floats
    states: Floats
    beta: LogWeights


def is_uninformative(log_likelihood: Floats) -> bool:
    """True when no hypothesis is likelier than another, up to rounding."""
    low, high = float(log_likelihood.min()), float(log_likelihood.max())
    return math.isfinite(high) and high - low <= FLAT * max(1.0, abs(high))


def match_moments(
    mean: Floats, covariance: Floats, points: SigmaPoints, log_likelihood: Floats
) -> tuple[Floats, Floats, float]:
    """Mean, covariance and log-evidence after a likelihood (N,): the moments of the weighted hypotheses.

    Where n of N hypotheses are effective, the share (1/n - 1/N) / (1 - 1/N) of the prior covariance is added
    to theirs. The moments of few hypotheses are narrower than the likelihood lets them be, and one alone
    has no spread at all: it moves the mean, and the covariance stays as it was. The share vanishes for a flat
    likelihood and as 1 / N for any other, faster than the error of the moments, 1 / sqrt(N).

    Raises:
        DegenerateWeights: no hypothesis has a positive, finite weight.
    """
    if is_uninformative(log_likelihood):
        return mean, covariance, float(points.beta.weights @ log_likelihood)
    with np.errstate(invalid="ignore"):  # -inf + inf is NaN, which `times` refuses
        weights, log_evidence = points.beta.times(log_likelihood)
    w = weights.weights
    shift = w @ points.unit
    deviations = points.unit - shift
    spread = (deviations * w[:, None]).T @ deviations
    all_of_them = points.beta.ess
    share = (1.0 / weights.ess - 1.0 / all_of_them) / (1.0 - 1.0 / all_of_them)
    spread += max(share, 0.0) * np.eye(len(spread))
    return mean + points.lower @ shift, symmetric(points.lower @ spread @ points.lower.T), log_evidence


def fit_moments(
    mean: Floats, covariance: Floats, points: SigmaPoints, log_likelihood: Floats
) -> tuple[Floats, Floats, float]:
    """The same from sigma points: log L is taken as a parabola along each axis, through its three points.

    Exact for a Gaussian likelihood whose errors are independent along the axes: x, y, w, h, then what they
    do not predict of the other fields. A parabola that opens upwards (two modes) is taken as a slope; the
    mean moves no farther than the points lie. A likelihood narrower than the prediction has reached its floor
    at the points, so that it counts as broader than it is: the belief is then too wide rather than too
    narrow. The weighted moments of so few points would err the other way, by more than tenfold.

    Raises:
        DegenerateWeights: no point has a positive, finite weight.
    """
    with np.errstate(invalid="ignore"):
        points.beta.times(log_likelihood)
    log = np.maximum(log_likelihood, log_likelihood.max() + np.log(WORST))
    width = points.unit.shape[1]
    if width == 0:
        return mean, covariance, float(log[0])
    reach = float(points.unit[1, 0])
    log_plus, log_minus = log[1 : width + 1], log[width + 1 :]
    slope = (log_plus - log_minus) / (2.0 * reach)
    precision = 1.0 + np.maximum(2.0 * log[0] - log_plus - log_minus, 0.0) / reach**2
    shift = np.clip(slope / precision, -reach, reach)
    log_evidence = float(log[0] + 0.5 * np.sum(slope * shift - np.log(precision)))
    spread = (points.lower / precision) @ points.lower.T
    return mean + points.lower @ shift, symmetric(spread), log_evidence


@dataclass(frozen=True, eq=False)
class Gated:
    """A measurement that was not used.

    Attributes:
        agent: whose.
        d2: squared Mahalanobis distance of its innovation.
        limit: quantile of chi-square at the gate's probability.
        degrees: number of fields measured.
        turning: probability from which on the gate would have let it pass; 1 when none below would.
    """

    agent: str
    d2: float
    limit: float
    degrees: int
    turning: float


def gated_of(agent: str, d2: float, gate: float, degrees: int) -> Gated:
    """A measurement of so many fields that is farther from the prediction than the `gate` lets it be."""
    return Gated(agent, d2, chi_square_quantile(gate, degrees), degrees, chi_square_cdf(d2, degrees))


@dataclass(frozen=True, eq=False)
class MeasurementUpdate:
    """A Gaussian after measurements.

    Attributes:
        mean: (D,).
        covariance: (D, D).
        log_evidence: of the measurements used, each of peak 1.
        used: agent -> measurement.
        gated: those not used.
    """

    mean: Floats
    covariance: Floats
    log_evidence: float
    used: Mapping[str, Measurement]
    gated: tuple[Gated, ...]


def update_by(
    mean: Floats,
    covariance: Floats,
    fields: tuple[str, ...],
    measurement: Measurement,
    is_unscented: bool = False,
) -> Updated | None:
    """The update by a measurement of fields of the state, or of functions (`update_seen`)."""
    if measurement.seen is not None:
        return update_seen(mean, covariance, fields, measurement, is_unscented)
    if measurement.variances is not None:
        columns = measured_columns(measurement.fields, fields)
        return update_by_fields(mean, covariance, columns, measurement.mean, measurement.variances)
    observe = observe_fields(measurement, fields)
    return linear_update(mean, covariance, measurement.mean - observe @ mean, observe, measurement.covariance)


def update_seen(
    mean: Floats,
    covariance: Floats,
    fields: tuple[str, ...],
    measurement: Measurement,
    is_unscented: bool,
) -> Updated | None:
    """The update by quantities z = h(x) + N(0, R), or by their `errors`; None where h has no value near m.

    By h's derivative at the mean, or at sigma points +-sqrt(max(K, 3)) sds away, K the covariance's rank.
    Angles are taken as the shorter way from that of the mean.
    """
    assert measurement.seen is not None
    if measurement.errors is not None:
        return update_by_errors(mean, covariance, fields, measurement)
    quantities = measurement.seen
    centre, slopes = (array[0] for array in linearise_seen(mean[None], fields, quantities))
    if not (np.isfinite(centre).all() and np.isfinite(slopes).all()):
        return None
    measured = centre + quantities.less(measurement.mean, centre)
    if quantities.covariance is not None:
        noise = quantities.covariance(centre[None])[0]
        if quantities.extra_covariance is not None:
            noise = noise + quantities.extra_covariance
        measurement = evolve(measurement, covariance=noise)
    if quantities.beyond is not None:
        shift, spread = quantities.beyond(mean, covariance)
        measurement = evolve(measurement, covariance=measurement.covariance + spread)
        measured = measured if is_unscented else measured - shift  # sigma points see it by themselves

    def unwrapped(states: Floats) -> Floats:
        values = quantities.function(dict(zip(fields, states.T, strict=True)))
        return np.asarray(centre + quantities.less(values, centre))

    try:
        if is_unscented:
            kappa = max(3.0 - root(covariance).shape[1], 0.0)
            update = unscented_update(mean, covariance, measured, measurement.covariance, unwrapped, kappa)
        else:
            functions = (lambda _: centre[None]), (lambda _: slopes)
            update = extended_update(mean, covariance, measured, measurement.covariance, *functions)
    except np.linalg.LinAlgError:
        return None
    if not (np.isfinite(update.mean).all() and np.isfinite(update.covariance).all()):
        return None
    if quantities.shared:
        columns = measured_columns(quantities.shared, fields)
        moments = allow_for(columns, (mean, covariance), (update.mean, update.covariance))
        update = evolve(update, mean=moments[0], covariance=moments[1])
    return update


def allow_for(
    columns: Sequence[int], prior: tuple[Floats, Floats], posterior: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Mean and covariance of a `posterior` in which some columns are to be allowed for, not estimated.

    Schmidt's update: the gain of these columns is 0. Their means and their covariance are those of the
    `prior`; all other entries, those between them and the rest included, are as of the full update.
    """
    mean, covariance = posterior[0].copy(), posterior[1].copy()
    block = np.ix_(columns, columns)
    mean[list(columns)], covariance[block] = prior[0][list(columns)], prior[1][block]
    return mean, covariance
