"""The value of an expression at N hypotheses, the logarithm of a density, and linear forms of the state.

No value raises: a division by zero is infinite, an overflow too, and what has no value (0 / 0, the root or
logarithm of a negative number, a density of sd 0) is NaN.

The logarithm is found through the tree: that of a product of densities is the sum of theirs, that of a sum
their log-sum-exp, so that nothing underflows. Values carry a sign beside the logarithm of their size.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.graph.expressions.terms import (
    DENSITIES,
    MASK,
    NEGATIVE,
    Call,
    Number,
    Term,
    Variable,
    names_in,
)

Floats = NDArray[np.float64]
Value = Any
"""(N,) float64, or one number for all hypotheses."""

LARGEST_LOG = math.log(np.finfo(float).max)
"""Where a density is infinite its logarithm counts as that of the largest number."""

_LOG_ROOT = 0.5 * math.log(2.0 * math.pi)


def values_of(term: Term, names: Mapping[str, Value]) -> Value:
    """The values of a term: (N,), or one number where it reads nothing that differs.

    >>> from bayesnet_track.graph.expressions.parse import parse
    >>> values_of(parse("max(x, 2) / 4"), {"x": np.array([1.0, 3.0])}).tolist()
    [0.5, 0.75]
    """
    with np.errstate(all="ignore"):
        return _value(term, names)


def log_values(term: Term, names: Mapping[str, Value]) -> Value:
    """The logarithms of a term's values: finite, -inf where one is 0 or less, or NaN where it has none.

    >>> from bayesnet_track.graph.expressions.parse import parse
    >>> x = np.array([0.0, 100.0])
    >>> log_values(parse("2 * normal(x, 0, 1) * normal(x, 0, 1)"), {"x": x}).round(2).tolist()
    [-1.14, -10001.14]
    """
    with np.errstate(all="ignore"):
        sign, log = _signed_log(term, names)
        return np.where(sign > 0, np.minimum(log, LARGEST_LOG), np.where(np.isnan(log * sign), log, -np.inf))


def _value(term: Term, names: Mapping[str, Value]) -> Value:
    if isinstance(term, Number):
        return np.float64(term.value)
    if isinstance(term, Call):
        if term.function in _LOG_DENSITIES:
            return np.exp(_log_density(term, names))
        if term.function == MASK:
            return names[MASK](*[_value(argument, names) for argument in term.arguments])
        return _OPERATIONS[term.function](*[_value(argument, names) for argument in term.arguments])
    return np.float64(math.pi) if term.name == "pi" else np.asarray(names[term.name], dtype=np.float64)


# ------------------------------------------------------------------------------------ in logarithms

Signed = tuple[Value, Value]
"""Sign (-1, 0, 1) and logarithm of the size."""


def _signed_log(term: Term, names: Mapping[str, Value]) -> Signed:
    if isinstance(term, Call):
        if term.function in _LOG_DENSITIES:
            return np.float64(1.0), _log_density(term, names)
        if term.function == "exp":
            return np.float64(1.0), _value(term.arguments[0], names)
        if term.function in _IN_LOGARITHMS and _has_density(term):
            return _IN_LOGARITHMS[term.function](term, names)
    value = _value(term, names)
    return np.sign(value), np.log(np.abs(value))


def _has_density(term: Term) -> bool:
    if not isinstance(term, Call):
        return False
    return term.function in DENSITIES or term.function == "exp" or any(map(_has_density, term.arguments))


def _product(term: Call, names: Mapping[str, Value]) -> Signed:
    (sign, log), (other_sign, other_log) = (_signed_log(argument, names) for argument in term.arguments)
    return sign * other_sign, log + other_log


def _quotient(term: Call, names: Mapping[str, Value]) -> Signed:
    (sign, log), (other_sign, other_log) = (_signed_log(argument, names) for argument in term.arguments)
    return sign * np.where(other_sign == 0, 1.0, other_sign), log - other_log


def _power(term: Call, names: Mapping[str, Value]) -> Signed:
    (sign, log), power = _signed_log(term.arguments[0], names), _value(term.arguments[1], names)
    odd = np.where(sign < 0, np.float_power(-1.0, power), 1.0)  # NaN where it is no whole number
    return odd, np.where(power == 0, 0.0, power * log) + 0.0 * odd


def _sum(term: Call, names: Mapping[str, Value]) -> Signed:
    (sign, log), (other_sign, other_log) = (_signed_log(argument, names) for argument in term.arguments)
    if term.function == "-":
        other_sign = -other_sign
    top = np.maximum(log, other_log)
    base = np.where(np.isfinite(top), top, 0.0)
    total = sign * np.exp(log - base) + other_sign * np.exp(other_log - base)
    return np.sign(total), base + np.log(np.abs(total))


def _negative(term: Call, names: Mapping[str, Value]) -> Signed:
    sign, log = _signed_log(term.arguments[0], names)
    return -sign, log


def _conditional(term: Call, names: Mapping[str, Value]) -> Signed:
    condition = _value(term.arguments[0], names)
    (sign, log), (other_sign, other_log) = (_signed_log(argument, names) for argument in term.arguments[1:])
    return np.where(condition != 0, sign, other_sign), np.where(condition != 0, log, other_log)


def _extreme(term: Call, names: Mapping[str, Value]) -> Signed:
    direction: Value = -1.0 if term.function == "min" else 1.0

    def better(first: Signed, second: Signed) -> Signed:
        # Of two negative values the larger one has the smaller logarithm.
        gap = np.where(first[0] == second[0], (second[1] - first[1]) * second[0], second[0] - first[0])
        takes = gap * direction > 0
        log = np.where(takes, second[1], first[1])
        return np.where(takes, second[0], first[0]), np.where(np.isnan(first[1] + second[1]), np.nan, log)

    return reduce(better, [_signed_log(argument, names) for argument in term.arguments])


_IN_LOGARITHMS: Mapping[str, Callable[[Call, Mapping[str, Value]], Signed]] = {
    "*": _product,
    "/": _quotient,
    "**": _power,
    "+": _sum,
    "-": _sum,
    "neg": _negative,
    "where": _conditional,
    "min": _extreme,
    "max": _extreme,
}


# ------------------------------------------------------------------------------------ densities


def _log_density(term: Call, names: Mapping[str, Value]) -> Value:
    return _LOG_DENSITIES[term.function](*[_value(argument, names) for argument in term.arguments])


def _log_normal(value: Value, mean: Value, sd: Value) -> Value:
    return -0.5 * ((value - mean) / sd) ** 2 - (np.log(sd) + _LOG_ROOT)


def _log_laplace(value: Value, mean: Value, scale: Value) -> Value:
    return -np.abs(value - mean) / scale - np.log(2.0 * scale)


def _log_student(value: Value, mean: Value, scale: Value, degrees: Value) -> Value:
    normaliser = _log_gamma_ratio(degrees)
    spread = np.log1p(((value - mean) / scale) ** 2 / degrees)
    return normaliser - 0.5 * np.log(math.pi * degrees) - np.log(scale) - 0.5 * (degrees + 1.0) * spread


def _log_uniform(value: Value, low: Value, high: Value) -> Value:
    in_range = (value >= low) & (value <= high)
    log = np.where(in_range, -np.log(high - low), -np.inf)
    return np.where(high > low, log, np.nan)


def _log_logistic(value: Value, mean: Value, scale: Value) -> Value:
    distance = np.abs(value - mean) / scale
    return -distance - np.log(scale) - 2.0 * np.log1p(np.exp(-distance))


def _log_lognormal(value: Value, mean: Value, sd: Value) -> Value:
    log = np.log(np.where(value > 0, value, 1.0))
    return np.where(value > 0, _log_normal(log, mean, sd) - log, _log_zero(value, (mean, sd), sd > 0))


def _log_gamma(value: Value, shape: Value, scale: Value) -> Value:
    # Imported here: most graphs have no such density.
    from scipy.special import gammaln, xlogy

    proper = (shape > 0) & (scale > 0)
    log = xlogy(shape - 1.0, value / scale) - value / scale - gammaln(shape) - np.log(scale)
    return np.where((value >= 0) & proper, log, _log_zero(value, (shape, scale), proper))


def _log_exponential(value: Value, scale: Value) -> Value:
    return np.where(value >= 0, -value / scale - np.log(scale), _log_zero(value, (scale,), scale > 0))


def _log_truncated(value: Value, mean: Value, sd: Value, low: Value, high: Value) -> Value:
    from scipy.special import log_ndtr

    a, b = (low - mean) / sd, (high - mean) / sd
    upper = a > 0  # in the tail whose probabilities are small, so that their difference is exact
    near_end, far_end = np.where(upper, -a, b), np.where(upper, -b, a)
    log_mass = log_ndtr(near_end) + np.log1p(-np.exp(log_ndtr(far_end) - log_ndtr(near_end)))
    proper = (sd > 0) & (high > low)
    in_range = (value >= low) & (value <= high) & proper
    return np.where(in_range, _log_normal(value, mean, sd) - log_mass, _log_zero(value, (mean, sd), proper))


def _log_zero(value: Value, parameters: tuple[Value, ...], proper: Value) -> Value:
    """-inf, or NaN where the value or a parameter is none."""
    sound = proper & ~np.isnan(sum((value, *parameters), 0.0))
    return np.where(sound, -np.inf, np.nan)


MANY_DEGREES = 1e6
"""From here on Stirling's formula is exact to rounding, and the gamma functions' difference is not."""


@np.vectorize
def _log_gamma_ratio(degrees: float) -> float:
    """log Gamma((d + 1) / 2) - log Gamma(d / 2)."""
    if not 0.0 < degrees / 2.0 < math.inf:  # half of the smallest number is 0
        return math.nan
    if degrees > MANY_DEGREES:
        return 0.5 * math.log(degrees / 2.0) - 0.25 / degrees
    return math.lgamma((degrees + 1.0) / 2.0) - math.lgamma(degrees / 2.0)


_LOG_DENSITIES: Mapping[str, Callable[..., Value]] = {
    "normal": _log_normal,
    "laplace": _log_laplace,
    "student_t": _log_student,
    "uniform": _log_uniform,
    "logistic": _log_logistic,
    "lognormal": _log_lognormal,
    "gamma": _log_gamma,
    "exponential": _log_exponential,
    "truncated_normal": _log_truncated,
}


# ------------------------------------------------------------------------------------ operations


def _conjunction(first: Value, second: Value) -> Value:
    return np.minimum(first != 0, second != 0) * 1.0


def _disjunction(first: Value, second: Value) -> Value:
    return np.maximum(first != 0, second != 0) * 1.0


_OPERATIONS: Mapping[str, Callable[..., Value]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "**": np.float_power,
    "neg": np.negative,
    "<": lambda first, second: (first < second) * 1.0,
    "<=": lambda first, second: (first <= second) * 1.0,
    ">": lambda first, second: (first > second) * 1.0,
    ">=": lambda first, second: (first >= second) * 1.0,
    "==": lambda first, second: (first == second) * 1.0,
    "!=": lambda first, second: (first != second) * 1.0,
    "and": _conjunction,
    "or": _disjunction,
    "not": lambda value: (value == 0) * 1.0,
    "where": lambda condition, first, second: np.where(condition != 0, first, second),
    "min": lambda *all_of: reduce(np.minimum, all_of),
    "max": lambda *all_of: reduce(np.maximum, all_of),
    "clip": lambda value, low, high: np.minimum(np.maximum(value, low), high),
    "abs": np.abs,
    "exp": np.exp,
    "log": np.log,
    "sqrt": np.sqrt,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "tanh": np.tanh,
    "sign": np.sign,
    "floor": np.floor,
    "mod": np.mod,
    "atan2": np.arctan2,
    "hypot": np.hypot,
}


# ------------------------------------------------------------------------------------ linear forms

COMPARISONS = frozenset(("<", "<=", ">", ">=", "==", "!="))
CONDITIONS = COMPARISONS | {"and", "or", "not"}


@dataclass(frozen=True)
class Linear:
    """A linear form of the state.

    Attributes:
        factors: name -> its factor; those that are 0 are left out.
        constant: what is added.
    """

    factors: Mapping[str, float]
    constant: float


def linear_of(term: Term, fixed: Mapping[str, float]) -> Linear | None:
    """The linear form that a term is, with the values of names that are `fixed`; None of any other.

    >>> from bayesnet_track.graph.expressions.parse import parse
    >>> linear_of(parse("2 * (x - a) + y / 4"), {"a": 3.0})
    Linear(factors={'x': 2.0, 'y': 0.25}, constant=-6.0)
    >>> linear_of(parse("x * y"), {}) is None
    True
    """
    if all(name in fixed or name == "pi" for name in names_in(term)):
        value = float(values_of(term, fixed))
        return Linear({}, value) if math.isfinite(value) else None
    if isinstance(term, Variable):
        return Linear({term.name: 1.0}, 0.0)
    if isinstance(term, Number) or term.function not in ("+", "-", "*", "/", NEGATIVE):
        return None
    parts = [linear_of(argument, fixed) for argument in term.arguments]
    if any(part is None for part in parts):
        return None
    first, *operands = (part for part in parts if part is not None)
    if not operands:
        return _scaled(first, -1.0)
    (second,) = operands
    if term.function in ("+", "-"):
        return _added(first, _scaled(second, 1.0 if term.function == "+" else -1.0))
    if term.function == "/":
        return None if second.factors or second.constant == 0.0 else _scaled(first, 1.0 / second.constant)
    if first.factors and second.factors:
        return None
    return _scaled(first, second.constant) if first.factors else _scaled(second, first.constant)


def _scaled(first: Linear, scale: float) -> Linear:
    factors = {name: factor * scale for name, factor in first.factors.items() if factor * scale != 0.0}
    return Linear(factors, first.constant * scale)


def _added(first: Linear, second: Linear) -> Linear:
    names = dict.fromkeys((*first.factors, *second.factors))
    factors = {name: first.factors.get(name, 0.0) + second.factors.get(name, 0.0) for name in names}
    factors_left = {name: factor for name, factor in factors.items() if factor != 0.0}
    return Linear(factors_left, first.constant + second.constant)


@dataclass(frozen=True)
class Between:
    """The condition that a linear form without a constant lies between two bounds.

    Attributes:
        factors: of the form; the first one is 1.
        low: lower bound; -inf without one.
        high: upper bound; inf without one.
    """

    factors: Mapping[str, float]
    low: float
    high: float


def between_of(term: Term, fixed: Mapping[str, float]) -> Between | None:
    """A condition as bounds of one linear form: a comparison, |form| < number, or `and` of such.

    None of any other. Bounds count as reached or not alike: a density has no mass there.

    >>> from bayesnet_track.graph.expressions.parse import parse
    >>> between_of(parse("x > 3 and 10 - x > 2"), {})
    Between(factors={'x': 1.0}, low=3.0, high=8.0)
    """
    if not isinstance(term, Call):
        return None
    if term.function == "and":
        first, second = (between_of(argument, fixed) for argument in term.arguments)
        if first is None or second is None or first.factors != second.factors:
            return None
        return Between(first.factors, max(first.low, second.low), min(first.high, second.high))
    if term.function not in ("<", "<=", ">", ">="):
        return None
    left, right = term.arguments if term.function in ("<", "<=") else term.arguments[::-1]
    if isinstance(left, Call) and left.function == "abs":
        limit = linear_of(right, fixed)
        form = linear_of(left.arguments[0], fixed)
        if limit is None or limit.factors or form is None or not form.factors:
            return None
        return _normal(form, -limit.constant, limit.constant)
    lesser, greater = linear_of(left, fixed), linear_of(right, fixed)
    if lesser is None or greater is None:
        return None
    difference = _added(lesser, _scaled(greater, -1.0))  # below 0
    return _normal(difference, -math.inf, 0.0) if difference.factors else None


def _normal(form: Linear, low: float, high: float) -> Between:
    """Bounds of a form as bounds of the same with the first factor 1 and no constant."""
    scale = 1.0 / next(iter(form.factors.values()))
    factors = {name: factor * scale for name, factor in form.factors.items()}
    if low > high:  # as abs(x) < -1: never
        return Between(factors, low, high)
    low, high = sorted(((low - form.constant) * scale, (high - form.constant) * scale))
    return Between(factors, low, high)
