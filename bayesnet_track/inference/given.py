"""Latent states whose distribution given the parent's is written as expressions, field by field.

p(c | h) = p(x | h) p(y | h, x) p(w | h, x, y) p(height | h, x, y, w): each field of the node's own box c is
drawn from a distribution, or has a value, by the parent's box h and the fields of c before it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import BOX_FIELDS
from bayesnet_track.belief.motion.formulas import Undefined
from bayesnet_track.graph.checked import Conditional
from bayesnet_track.graph.expressions.evaluate import log_values, values_of
from bayesnet_track.graph.expressions.terms import DRAWN, PARENT, Call, Term, Variable
from bayesnet_track.numerics.arrays import Floats

Names = Mapping[str, Floats | float]

STEP = 1e-3
"""Of numerical derivatives, px."""

LEAST_SIDE = 1.0
"""Sides of boxes are at least so long, px."""


def _draw_truncated(rng: np.random.Generator, mean: Floats, sd: Floats, low: Floats, high: Floats) -> Floats:
    # Imported here: most graphs have no such distribution.
    from scipy.stats import truncnorm

    drawn = truncnorm.ppf(rng.random(mean.shape), (low - mean) / sd, (high - mean) / sd)
    return np.asarray(np.clip(mean + sd * drawn, low, high))


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


def draw_given(
    given: Conditional,
    above: Floats,
    rng: np.random.Generator,
    undefined: MutableMapping[str, Undefined] | None = None,
) -> Floats:
    """(N, 4) own boxes, one drawn for each of the parent's (N, 4).

    Where an expression has no value, or its distribution has none, the field is the parent's; `undefined`
    then says so by field.
    """
    boxes = above.copy()
    for column, name, term in _fields(given):
        parameters = _parameters(term, _names(given, above, boxes), len(above))
        known: NDArray[np.bool_] = np.isfinite(parameters).min(axis=0)
        function = _distribution(term)
        if function == "":
            values = parameters[0]
        else:
            known &= _is_proper(function, parameters)
            sound = np.where(known, parameters, _SOUND[function][:, None])
            values = _DRAWS[function](rng, *sound)
        boxes[:, column] = np.where(known, values, above[:, column])
        if undefined is not None and not known.all():
            undefined.setdefault(name, Undefined(int((~known).sum()), len(known)))
        if column >= 2:
            np.maximum(boxes[:, column], LEAST_SIDE, out=boxes[:, column])
    return boxes


def usual_boxes(given: Conditional, above: Floats) -> Floats:
    """(N, 4) own boxes with the median of each field, for parents (N, 4)."""
    boxes = above.copy()
    for column, _, term in _fields(given):
        parameters = _parameters(term, _names(given, above, boxes), len(above))
        median = _MEDIANS.get(_distribution(term))
        middle = parameters[0] if median is None else median(*parameters)
        boxes[:, column] = np.where(np.isfinite(middle), middle, above[:, column])
        if column >= 2:
            np.maximum(boxes[:, column], LEAST_SIDE, out=boxes[:, column])
    return boxes


def linearise_given(given: Conditional, parent: Floats) -> tuple[Floats, Floats, Floats]:
    """Own box (4,) at the parent's mean box (4,), its Jacobian (4, 4) by that box, and covariance (4, 4).

    c = own + A (h - parent) + noise, by numerical derivatives: exact where means are linear and sds constant.
    What is drawn is normal. A field without a value is the parent's, as in `draw_given`.
    """
    own, by_parent, noise = parent.copy(), np.eye(4), np.zeros((4, 4))
    moves = np.concatenate([np.zeros((1, 8)), STEP * np.eye(8), -STEP * np.eye(8)])
    for column, _, term in _fields(given):
        above, mine = parent + moves[:, :4], own + moves[:, 4:]
        parameters = _parameters(term, _names(given, above, mine), len(moves))
        sd = float(parameters[1, 0]) if _distribution(term) else 0.0
        slopes = (parameters[0, 1:9] - parameters[0, 9:]) / (2.0 * STEP)
        if not (np.isfinite(parameters[0]).all() and np.isfinite(sd) and (sd > 0 or not _distribution(term))):
            continue
        own[column] = max(parameters[0, 0], LEAST_SIDE) if column >= 2 else parameters[0, 0]
        before = slopes[4 : 4 + column]
        by_parent[column] = slopes[:4] + before @ by_parent[:column]
        noise[column] = before @ noise[:column]
        noise[column, column] += sd
    return own, by_parent, noise @ noise.T


def log_given(given: Conditional, above: Floats, own: Floats) -> Floats:
    """(N, M) log p(c_j | h_i) of own boxes (M, 4), for parents (N, 4), over the fields that are drawn.

    -inf where a field that has a value, or is the parent's, differs from it.
    """
    log = np.zeros((len(above), len(own)))
    written = {column: term for column, _, term in _fields(given)}
    columns = {name: own[None, :, k] for k, name in enumerate(BOX_FIELDS)}
    names = {**_of_parents(above[:, :, None]), **columns, **given.constants}
    for column in range(len(BOX_FIELDS)):
        term = written.get(column)
        if term is None:
            values = above[:, column, None]
        elif _distribution(term):
            log = log + log_values(term, {**names, DRAWN: own[None, :, column]})
            continue
        else:
            values = np.broadcast_to(values_of(term, names), log.shape)
            values = np.where(np.isfinite(values), values, above[:, column, None])
            values = np.maximum(values, LEAST_SIDE) if column >= 2 else values
        if np.ptp(values) > 0:
            log = np.where(
                np.abs(values - own[None, :, column]) > 1e-9 * (1.0 + np.abs(values)), -np.inf, log
            )
    return np.where(np.isnan(log), -np.inf, log)


def _fields(given: Conditional) -> list[tuple[int, str, Term]]:
    return [(k, name, given.fields[name]) for k, name in enumerate(BOX_FIELDS) if name in given.fields]


def _distribution(term: Term) -> str:
    """The distribution that a field is drawn from; empty where it has a value."""
    is_drawn = isinstance(term, Call) and len(term.arguments) > 0 and term.arguments[0] == Variable(DRAWN)
    return term.function if is_drawn and isinstance(term, Call) else ""


def _parameters(term: Term, names: Names, size: int) -> Floats:
    """(K, size) the parameters of a field's distribution, or (1, size) its value."""
    terms = term.arguments[1:] if isinstance(term, Call) and _distribution(term) else (term,)
    return np.stack([np.broadcast_to(values_of(one, names), (size,)) for one in terms]).astype(np.float64)


def _is_proper(function: str, parameters: Floats) -> NDArray[np.bool_]:
    """(N,) whether a distribution with these parameters exists."""
    if function == "uniform":
        return np.asarray(parameters[1] > parameters[0])
    if function == "truncated_normal":
        return np.asarray((parameters[1] > 0) & (parameters[3] > parameters[2]))
    first = 0 if function in ("gamma", "exponential") else 1
    return np.asarray((parameters[first:] > 0).min(axis=0))


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


def _names(given: Conditional, above: Floats, own: Floats) -> Names:
    mine = {name: own[:, k] for k, name in enumerate(BOX_FIELDS)}
    return {**_of_parents(above), **mine, **given.constants}


def _of_parents(above: Floats) -> dict[str, Floats]:
    return {PARENT + name: above[:, k] for k, name in enumerate(BOX_FIELDS)}
