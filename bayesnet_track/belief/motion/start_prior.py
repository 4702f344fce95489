"""Distribution of a state when its target starts, field by field, by expressions of the start box."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from bayesnet_track.belief.contract import BOX_FIELDS, MotionModel
from bayesnet_track.graph.expressions.distributions import (
    Names,
    distribution_of,
    draw,
    is_proper,
    moments,
    parameters_of,
)
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import Term, names_in
from bayesnet_track.graph.spec import InferenceNode
from bayesnet_track.numerics.arrays import Floats

LEAST_SIDE = 1.0
"""Sides of boxes are at least so long, px."""


@dataclass(frozen=True)
class StartPrior:
    """p(field | start box) of some fields of a state; the fields are independent given the box.

    Where an expression has no value, or its distribution has none, the field starts as the motion says.

    Attributes:
        terms: field -> its distribution, a density of the variable `DRAWN`, or its value.
        constants: numbers that they use by name.
    """

    terms: Mapping[str, Term]
    constants: Mapping[str, float]

    def applied_to(
        self, fields: tuple[str, ...], states: Floats, box: ArrayLike, rng: np.random.Generator
    ) -> Floats:
        """`states` (N, D), changed in place: the fields drawn for a target first seen in a box (4,)."""
        for name, term in self.terms.items():
            parameters = parameters_of(term, self._names(box), len(states))
            values = draw(distribution_of(term), parameters, rng)
            column = fields.index(name)
            states[:, column] = np.where(np.isfinite(values), values, states[:, column])
        np.maximum(states[:, 2:4], LEAST_SIDE, out=states[:, 2:4])
        return states

    def moments_of(
        self, fields: tuple[str, ...], mean: Floats, covariance: Floats, box: ArrayLike
    ) -> tuple[Floats, Floats]:
        """Mean (D,) and covariance (D, D), or of each of N, changed in place: those of the distributions.

        Exact of a normal distribution. `box` is (4,), or (N, 4).
        """
        means, spreads = mean.reshape(-1, len(fields)), covariance.reshape(-1, len(fields), len(fields))
        for name, term in self.terms.items():
            parameters = parameters_of(term, self._names(box), len(means))
            centre, variance = moments(distribution_of(term), parameters)
            rows, column = np.flatnonzero(np.isfinite(centre) & np.isfinite(variance)), fields.index(name)
            spreads[rows, column, :] = 0.0
            spreads[rows, :, column] = 0.0
            means[rows, column], spreads[rows, column, column] = centre[rows], variance[rows]
        np.maximum(means[:, 2:4], LEAST_SIDE, out=means[:, 2:4])
        return mean, covariance

    def is_uncertain(self, name: str) -> bool:
        """True if a field is drawn."""
        return name in self.terms and distribution_of(self.terms[name]) != ""

    def undefined(self, box: ArrayLike) -> tuple[str, ...]:
        """Fields without a distribution at a centre box (4,)."""
        names = []
        for name, term in self.terms.items():
            function, parameters = distribution_of(term), parameters_of(term, self._names(box), 1)
            if not is_proper(function, parameters)[0]:
                names.append(name)
        return tuple(names)

    def _names(self, box: ArrayLike) -> Names:
        sides = np.asarray(box, dtype=np.float64)
        return {**{name: sides[..., k] for k, name in enumerate(BOX_FIELDS)}, **self.constants}


def start_moments_of_each(motion: MotionModel, boxes: Floats) -> tuple[Floats, Floats]:
    """(N, D) means and (N, D, D) covariances of targets first seen in centre boxes (N, 4), at least one."""
    if not hasattr(motion, "prior"):  # it may be in a motion inside
        each = [motion.start_moments(box) for box in boxes]
        return np.array([mean for mean, _ in each]), np.array([spread for _, spread in each])
    prior: StartPrior | None = motion.prior
    free: Any = motion if prior is None else replace(cast(Any, motion), prior=None)
    mean, spread = free.start_moments(boxes[0])
    means, spreads = np.tile(mean, (len(boxes), 1)), np.tile(spread, (len(boxes), 1, 1))
    means[:, :4] = boxes
    if prior is None:
        return means, spreads
    return prior.moments_of(tuple(motion.fields)[: len(mean)], means, spreads, boxes)


def make_start_prior(root: InferenceNode, constants: Mapping[str, float]) -> StartPrior | None:
    """The prior that a graph writes for fields of a root's state; None where it writes none."""
    if not root.start_texts:
        return None
    terms = {name: parse(text, draws=True) for name, text in root.start_texts.items()}
    mentioned = {name for term in terms.values() for name in names_in(term)}
    return StartPrior(terms, {name: value for name, value in constants.items() if name in mentioned})
