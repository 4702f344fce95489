"""Distributions that an expression names: draws, medians, moments; periods of angles.

In a text such as ``normal(parent.x, 5)`` the value that is drawn is left out; in its term it is `DRAWN`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.graph.expressions.evaluate import Linear, linear_of, values_of
from bayesnet_track.graph.expressions.terms import DRAWN, Call, Term, Variable, names_in
from bayesnet_track.numerics.arrays import Floats

Names = Mapping[str, Floats | float]


def distribution_of(term: Term) -> str:
    """The distribution that is drawn from; empty of a value.

    >>> from bayesnet_track.graph.expressions.parse import parse
    >>> distribution_of(parse("normal(3, 1)", draws=True)), distribution_of(parse("x + 3"))
    ('normal', '')
    """
    is_drawn = isinstance(term, Call) and term.arguments[:1] == (Variable(DRAWN),)
    return term.function if is_drawn and isinstance(term, Call) else ""


def parameters_of(term: Term, names: Names, size: int) -> Floats:
    """(K, size) the parameters of a distribution, or (1, size) the value."""
    terms = term.arguments[1:] if isinstance(term, Call) and distribution_of(term) else (term,)
    return np.stack([np.broadcast_to(values_of(argument, names), (size,)) for argument in terms]).astype(
        np.float64
    )


def is_proper(function: str, parameters: Floats) -> NDArray[np.bool_]:
    """(N,) whether a distribution with these parameters (K, N), or the value, exists."""
    finite = np.isfinite(parameters).min(axis=0)
    if function == "":
        return np.asarray(finite)
    if function == "uniform":
        return np.asarray(finite & (parameters[1] > parameters[0]))
    if function == "truncated_normal":
        return np.asarray(finite & (parameters[1] > 0) & (parameters[3] > parameters[2]))
    first = 0 if function in ("gamma", "exponential") else 1
    return np.asarray(finite & (parameters[first:] > 0).min(axis=0))


def draw(function: str, parameters: Floats, rng: np.random.Generator) -> Floats:
    """(N,) one value for each column of parameters (K, N); NaN where there is no distribution."""
    if function == "":
        return np.asarray(parameters[0])
    proper = is_proper(function, parameters)
    values = _DRAWS[function](rng, *np.where(proper, parameters, _SOUND[function][:, None]))
    return np.where(proper, values, np.nan)


def median(function: str, parameters: Floats) -> Floats:
    """(N,) the medians for parameters (K, N)."""
    special = _MEDIANS.get(function)
    return parameters[0] if special is None else special(*parameters)


def moments(function: str, parameters: Floats) -> tuple[Floats, Floats]:
    """(N,) means and (N,) variances for parameters (K, N); NaN or infinite where there are none.

    >>> moments("uniform", np.array([[0.0], [6.0]]))
    (array([3.]), array([3.]))
    """
    if function == "":
        return parameters[0], np.zeros_like(parameters[0])
    with np.errstate(all="ignore"):
        mean, variance = _MOMENTS[function](*parameters)
    proper = is_proper(function, parameters)
    return np.where(proper, mean, np.nan), np.where(proper, variance, np.nan)


def _draw_truncated(rng: np.random.Generator, mean: Floats, sd: Floats, low: Floats, high: Floats) -> Floats:
    # Imported here: most graphs have no such distribution.
    from scipy.stats import truncnorm

    quantiles = truncnorm.ppf(rng.random(mean.shape), (low - mean) / sd, (high - mean) / sd)
    return np.asarray(np.clip(mean + sd * quantiles, low, high))


_DRAWS: Mapping[str, Callable[..., Floats]] = {
    "normal": lambda rng, mean, sd: mean + sd * rng.standard_normal(mean.shape),
    "laplace": lambda rng, mean, scale: mean + scale * rng.laplace(size=mean.shape),
    "student_t": lambda rng, mean, scale, degrees: mean + scale * rng.standard_t(degrees),
    "uniform": lambda rng, low, high: low + (high - low) * rng.random(low.shape),
    "logistic": lambda rng, mean, scale: mean + scale * rng.logistic(size=mean.shape),
    "lognormal": lambda rng, mean, sd: np.exp(mean + sd * rng.standard_normal(mean.shape)),
    "gamma": lambda rng, shape, scale: scale * rng.standard_gamma(shape),
    "exponential": lambda rng, scale: scale * rng.standard_exponential(scale.shape),
    "truncated_normal": _draw_truncated,
}


def _gamma_median(shape: Floats, scale: Floats) -> Floats:
    from scipy.special import gammaincinv

    return np.asarray(scale * gammaincinv(np.where(shape > 0, shape, np.nan), 0.5))


def _truncated_median(mean: Floats, sd: Floats, low: Floats, high: Floats) -> Floats:
    from scipy.stats import truncnorm

    return np.asarray(mean + sd * truncnorm.ppf(0.5, (low - mean) / sd, (high - mean) / sd))


_MEDIANS: Mapping[str, Callable[..., Floats]] = {
    "uniform": lambda low, high: (low + high) / 2.0,
    "lognormal": lambda mean, sd: np.exp(mean),
    "gamma": _gamma_median,
    "exponential": lambda scale: scale * np.log(2.0),
    "truncated_normal": _truncated_median,
}
"""Of the distributions whose median is not their first parameter."""


def _student_variance(scale: Floats, degrees: Floats) -> Floats:
    return np.where(degrees > 2.0, scale**2 * degrees / (degrees - 2.0), np.inf)


def _lognormal_moments(mean: Floats, sd: Floats) -> tuple[Floats, Floats]:
    middle = np.exp(mean + sd**2 / 2.0)
    return middle, np.expm1(sd**2) * middle**2


def _truncated_moments(mean: Floats, sd: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    from scipy.stats import truncnorm

    proper = (sd > 0) & (high > low)
    a, b = np.where(proper, (low - mean) / sd, 0.0), np.where(proper, (high - mean) / sd, 1.0)
    centre, variance = truncnorm.stats(a, b, moments="mv")
    return mean + sd * centre, sd**2 * variance


_MOMENTS: Mapping[str, Callable[..., tuple[Floats, Floats]]] = {
    "normal": lambda mean, sd: (mean, sd**2),
    "laplace": lambda mean, scale: (mean, 2.0 * scale**2),
    "student_t": lambda mean, scale, degrees: (mean, _student_variance(scale, degrees)),
    "uniform": lambda low, high: ((low + high) / 2.0, (high - low) ** 2 / 12.0),
    "logistic": lambda mean, scale: (mean, (np.pi * scale) ** 2 / 3.0),
    "lognormal": _lognormal_moments,
    "gamma": lambda shape, scale: (shape * scale, shape * scale**2),
    "exponential": lambda scale: (scale, scale**2),
    "truncated_normal": _truncated_moments,
}

_SOUND = {
    "normal": np.array([0.0, 1.0]),
    "laplace": np.array([0.0, 1.0]),
    "student_t": np.array([0.0, 1.0, 1.0]),
    "uniform": np.array([0.0, 1.0]),
    "logistic": np.array([0.0, 1.0]),
    "lognormal": np.array([0.0, 1.0]),
    "gamma": np.array([1.0, 1.0]),
    "exponential": np.array([1.0]),
    "truncated_normal": np.array([0.0, 1.0, 0.0, 1.0]),
}
"""Parameters that stand in where there are none, so that the others can be drawn."""


def period_of(term: Term, constants: Mapping[str, float]) -> float:
    """After how much the value of a term is the same again: infinite of one that is no angle.

    `atan2(...)` is an angle in radians, and so is it plus or minus anything; times a number it is one of
    another unit.

    >>> from bayesnet_track.graph.expressions.parse import parse
    >>> period_of(parse("90 - atan2(y, x) * 180 / pi"), {}), period_of(parse("hypot(x, y)"), {})
    (360.0, inf)
    """
    if not isinstance(term, Call):
        return math.inf
    if term.function == "atan2":
        return 2.0 * math.pi
    periods = [period_of(argument, constants) for argument in term.arguments]
    if term.function in ("neg", "+", "-"):
        return min(periods)
    if term.function in ("*", "/") and min(periods) < math.inf:
        factor = term.arguments[1 - periods.index(min(periods))]
        if term.function == "/" and factor is term.arguments[0]:
            return math.inf
        if any(name not in constants and name != "pi" for name in names_in(factor)):
            return math.inf
        value = abs(float(values_of(factor, constants)))
        return min(periods) * value if term.function == "*" else min(periods) / max(value, 1e-300)
    return math.inf


@dataclass(frozen=True)
class LinearNormal:
    """A normal density of a linear form of the state, of mean 0.

    Attributes:
        form: of which it is.
        sd: its sd, above 0.
    """

    form: Linear
    sd: float


def linear_normals_of(term: Term, fixed: Mapping[str, float]) -> tuple[LinearNormal, ...] | None:
    """The normal densities of linear forms whose product a term is; None of any other.

    >>> from bayesnet_track.graph.expressions.parse import parse
    >>> linear_normals_of(parse("normal(x, 2 * y + 3, 5)"), {})
    (LinearNormal(form=Linear(factors={'x': 1.0, 'y': -2.0}, constant=-3.0), sd=5.0),)
    >>> linear_normals_of(parse("normal(x, 40, y)"), {}) is None
    True
    """
    if not isinstance(term, Call) or term.function not in ("*", "normal"):
        return None
    if term.function == "*":
        parts = [linear_normals_of(argument, fixed) for argument in term.arguments]
        return None if any(part is None for part in parts) else sum((part or () for part in parts), ())
    value, mean, scale = term.arguments
    form, sd = linear_of(Call("-", (value, mean)), fixed), linear_of(scale, fixed)
    if form is None or sd is None or sd.factors or sd.constant <= 0.0:
        return None
    return (LinearNormal(form, sd.constant),)
