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

    centre, slopes = linearise_seen(mean[None], fields, seen)[0]
    slope = slopes[number]
    if not (np.isfinite(centre).all() and np.isfinite(slope).all()):
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


FAR = 1e100
"""Where a quantity has no value, it is so far from what was measured."""


def log_message(one: Measurement, hypotheses: Hypotheses, fields: tuple[str, ...]) -> Floats:
    """(N,) -d^2 / 2 of hypotheses under a measurement."""
    if one.choices:
        each = (weight * np.exp(log_message(own, hypotheses, fields)) for weight, own in one.choices)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(one.missed + sum(each)))
    states = np.column_stack([hypotheses.boxes, *(hypotheses.fields[name] for name in fields[4:])])
    if one.errors is not None:
        return replace(one, floor=0.0).log_by_errors(dict(zip(fields, states.T, strict=True)))
    if one.seen is None:
        away = states @ observe_fields(one, fields).T - one.mean
    else:
        values = one.seen.function(dict(zip(fields, states.T, strict=True)))
        away = np.nan_to_num(one.seen.less(values, one.mean), nan=FAR, posinf=FAR, neginf=-FAR)
    return np.asarray(-0.5 * np.einsum("nk,nk->n", away, np.linalg.solve(one.covariance, away.T).T))


def observe_fields(one: Measurement, fields: tuple[str, ...]) -> Floats:
    """(K, D) H: the rows of the identity for the fields measured."""
    return np.eye(len(fields))[list(columns_of(one.fields, fields))]


@lru_cache(maxsize=256)
def columns_of(measured: tuple[str, ...], fields: tuple[str, ...]) -> tuple[int, ...]:
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


def is_flat(log_likelihood: Floats) -> bool:
    """True when no hypothesis is likelier than another, up to rounding."""
    low, high = float(log_likelihood.min()), float(log_likelihood.max())
    return math.isfinite(high) and high - low <= FLAT * max(1.0, abs(high))


def match_moments(
    mean: Floats, covariance: Floats, asked: SigmaPoints, log_likelihood: Floats
) -> tuple[Floats, Floats, float]:
    """Mean, covariance and log-evidence after a likelihood (N,): the moments of the weighted hypotheses.

    Where n of N hypotheses are effective, the share (1/n - 1/N) / (1 - 1/N) of the prior covariance is added
    to theirs. The moments of few hypotheses are narrower than the likelihood lets them be, and one alone
    has no spread at all: it moves the mean, and the covariance stays as it was. The share vanishes for a flat
    likelihood and as 1 / N for any other, faster than the error of the moments, 1 / sqrt(N).

    Raises:
        DegenerateWeights: no hypothesis has a positive, finite weight.
    """
    if is_flat(log_likelihood):
        return mean, covariance, float(asked.beta.weights @ log_likelihood)
    with np.errstate(invalid="ignore"):  # -inf + inf is NaN, which `times` refuses
        weights, log_evidence = asked.beta.times(log_likelihood)
    w = weights.weights
    shift = w @ asked.unit
    away = asked.unit - shift
    spread = (away * w[:, None]).T @ away
    all_of_them = asked.beta.ess
    share = (1.0 / weights.ess - 1.0 / all_of_them) / (1.0 - 1.0 / all_of_them)
    spread += max(share, 0.0) * np.eye(len(spread))
    return mean + asked.lower @ shift, symmetric(asked.lower @ spread @ asked.lower.T), log_evidence


def fit_moments(
    mean: Floats, covariance: Floats, asked: SigmaPoints, log_likelihood: Floats
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
        asked.beta.times(log_likelihood)
    log = np.maximum(log_likelihood, log_likelihood.max() + np.log(WORST))
    width = asked.unit.shape[1]
    if width == 0:
        return mean, covariance, float(log[0])
    reach = float(asked.unit[1, 0])
    ahead, behind = log[1 : width + 1], log[width + 1 :]
    slope = (ahead - behind) / (2.0 * reach)
    precision = 1.0 + np.maximum(2.0 * log[0] - ahead - behind, 0.0) / reach**2
    shift = np.clip(slope / precision, -reach, reach)
    log_evidence = float(log[0] + 0.5 * np.sum(slope * shift - np.log(precision)))
    spread = (asked.lower / precision) @ asked.lower.T
    return mean + asked.lower @ shift, symmetric(spread), log_evidence


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


def take(
    mean: Floats,
    covariance: Floats,
    fields: tuple[str, ...],
    measured: Mapping[str, Measurement],
    gate: float,
    is_unscented: bool = False,
) -> MeasurementUpdate:
    """Kalman updates by what agents measured, one after the other, as exact as all at once.

    A measurement is left out when d^2 = v' S^-1 v exceeds the chi-square quantile of `gate` (tracking chapter
    3.9 b: no object near the prediction, so that only the prediction stands). Every d^2 is taken against the
    belief before any of them, so that their order decides nothing. One with choices gives the mean and the
    covariance of the mixture of its updates; it is never left out, because its choices were gated when they
    were made, nor is one whose errors are not Gaussian (`update_by_errors`). Quantities that are functions of
    the state are taken by their derivative at the mean, or at sigma points where `is_unscented`; without a
    value there they are not used.
    """
    used: dict[str, Measurement] = {}
    gated: list[Gated] = []
    for agent, one in measured.items():
        if one.choices or (one.errors is not None and not one.errors.is_normal):
            used[agent] = one
            continue
        if one.seen is not None:
            seen = update_seen(mean, covariance, fields, one, is_unscented)
            if seen is None:
                continue
            d2 = seen.d2
        elif gate >= 1.0:  # nothing is too far
            used[agent] = one
            continue
        else:
            d2 = update_by(mean, covariance, fields, one).d2
        degrees = len(one.fields)
        limit = chi_square_quantile(gate, degrees)
        if d2 > limit:
            gated.append(gated_of(agent, d2, gate, degrees))
        else:
            used[agent] = one
    log_evidence = 0.0
    for one in used.values():
        if one.choices:
            mean, covariance, log_own = mix_choices(mean, covariance, fields, one, is_unscented)
            log_evidence += log_own
            continue
        if one.seen is None:
            after = update_by(mean, covariance, fields, one)
        else:
            by_function = (
                update_seen(mean, covariance, fields, one, is_unscented)
                if one.errors is None
                else update_by_errors(mean, covariance, fields, one)
            )
            if by_function is None:
                continue
            after = by_function
        mean, covariance = after.mean, after.covariance
        log_evidence += after.log_likelihood
    return MeasurementUpdate(mean, covariance, log_evidence, used, tuple(gated))


def update_by(mean: Floats, covariance: Floats, fields: tuple[str, ...], one: Measurement) -> Updated:
    """The update by a measurement of fields of the state."""
    if one.variances is not None:
        columns = columns_of(one.fields, fields)
        return update_by_fields(mean, covariance, columns, one.mean, one.variances)
    observe = observe_fields(one, fields)
    return linear_update(mean, covariance, one.mean - observe @ mean, observe, one.covariance)


def update_seen(
    mean: Floats,
    covariance: Floats,
    fields: tuple[str, ...],
    one: Measurement,
    is_unscented: bool,
    linear: tuple[Floats, Floats] | None = None,
) -> Updated | None:
    """The update by quantities z = h(x) + N(0, R); None where h has no value near the mean.

    By h's derivative at the mean, or at sigma points +-sqrt(max(K, 3)) sds away, K the covariance's rank.
    Angles are taken as the shorter way from that of the mean. `linear` is what `linearise_seen` gives of the
    mean, if that was found before.
    """
    assert one.seen is not None
    seen = one.seen

    centre, slopes = linearise_seen(mean[None], fields, seen)[0] if linear is None else linear
    if not (np.isfinite(centre).all() and np.isfinite(slopes).all()):
        return None
    measured = centre + seen.less(one.mean, centre)
    if seen.beyond is not None:
        shift, spread = seen.beyond(mean, covariance)
        one = evolve(one, covariance=one.covariance + spread)
        measured = measured if is_unscented else measured - shift  # sigma points see it by themselves

    def unwrapped(states: Floats) -> Floats:
        values = seen.function(dict(zip(fields, states.T, strict=True)))
        return np.asarray(centre + seen.less(values, centre))

    try:
        if is_unscented:
            kappa = max(3.0 - root(covariance).shape[1], 0.0)
            after = unscented_update(mean, covariance, measured, one.covariance, unwrapped, kappa)
        else:
            functions = (lambda _: centre[None]), (lambda _: slopes)
            after = extended_update(mean, covariance, measured, one.covariance, *functions)
    except np.linalg.LinAlgError:
        return None
    if not (np.isfinite(after.mean).all() and np.isfinite(after.covariance).all()):
        return None
    if seen.shared:
        columns = columns_of(seen.shared, fields)
        held = allow_for(columns, (mean, covariance), (after.mean, after.covariance))
        after = evolve(after, mean=held[0], covariance=held[1])
    return after


def allow_for(
    columns: Sequence[int], before: tuple[Floats, Floats], after: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Mean and covariance `after` an update in which some columns were to be allowed for, not estimated.

    Schmidt's update: the gain of these columns is 0. That leaves their means and their covariance as they
    were `before`; all other entries, those between them and the rest included, are as of the full update.
    """
    mean, covariance = after[0].copy(), after[1].copy()
    at = np.ix_(columns, columns)
    mean[list(columns)], covariance[at] = before[0][list(columns)], before[1][at]
    return mean, covariance


def mix_choices(
    mean: Floats,
    covariance: Floats,
    fields: tuple[str, ...],
    measured: Measurement,
    is_unscented: bool,
    linear: tuple[Floats, Floats] | None = None,
) -> tuple[Floats, Floats, float]:
    """Mean, covariance and log-evidence of the mixture of the updates by each choice, and by none.

    Where functions of the state have no value at the mean nothing is used. `linear` is that of `update_seen`,
    the same of all choices.
    """
    weights, means, covariances, evidence = [measured.missed], [mean], [covariance], measured.missed
    for weight, one in measured.choices:
        if one.seen is None:
            after = update_by(mean, covariance, fields, one)
        else:
            if linear is None:
                linear = linearise_seen(mean[None], fields, one.seen)[0]
            by_function = update_seen(mean, covariance, fields, one, is_unscented, linear)
            if by_function is None:
                return mean, covariance, 0.0
            after = by_function
        weights.append(weight)
        means.append(after.mean)
        covariances.append(after.covariance)
        evidence += weight * float(np.exp(after.log_likelihood))
    shares = np.array(weights)
    centre = shares @ np.array(means)
    away = np.array(means) - centre
    spread = np.einsum("k,kij->ij", shares, np.array(covariances)) + (away * shares[:, None]).T @ away
    return centre, symmetric(spread), float(np.log(max(evidence, 1e-300)))
