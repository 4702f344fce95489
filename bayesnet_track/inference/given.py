"""Latent states whose distribution given the parent's is written as expressions, field by field.

p(c | h) = p(x | h) p(y | h, x) p(w | h, x, y) p(height | h, x, y, w): each field of the node's own box c is
drawn from a distribution, or has a value, by the parent's box h and the fields of c before it.
"""

from __future__ import annotations

from collections.abc import MutableMapping

import numpy as np

from bayesnet_track.belief.contract import BOX_FIELDS
from bayesnet_track.belief.motion.formulas import Undefined
from bayesnet_track.graph.checked import Conditional
from bayesnet_track.graph.expressions.distributions import (
    Names,
    distribution_of,
    draw,
    median,
    parameters_of,
)
from bayesnet_track.graph.expressions.evaluate import log_values, values_of
from bayesnet_track.graph.expressions.terms import DRAWN, PARENT, Term
from bayesnet_track.numerics.arrays import Floats

STEP = 1e-3
"""Of numerical derivatives, px."""

LEAST_SIDE = 1.0
"""Sides of boxes are at least so long, px."""


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
        parameters = parameters_of(term, _names(given, above, boxes), len(above))
        values = draw(distribution_of(term), parameters, rng)
        known = np.isfinite(values)
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
        parameters = parameters_of(term, _names(given, above, boxes), len(above))
        middle = median(distribution_of(term), parameters)
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
        parameters = parameters_of(term, _names(given, above, mine), len(moves))
        sd = float(parameters[1, 0]) if distribution_of(term) else 0.0
        slopes = (parameters[0, 1:9] - parameters[0, 9:]) / (2.0 * STEP)
        if not (
            np.isfinite(parameters[0]).all() and np.isfinite(sd) and (sd > 0 or not distribution_of(term))
        ):
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
        elif distribution_of(term):
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


def _names(given: Conditional, above: Floats, own: Floats) -> Names:
    mine = {name: own[:, k] for k, name in enumerate(BOX_FIELDS)}
    return {**_of_parents(above), **mine, **given.constants}


def _of_parents(above: Floats) -> dict[str, Floats]:
    return {PARENT + name: above[:, k] for k, name in enumerate(BOX_FIELDS)}
