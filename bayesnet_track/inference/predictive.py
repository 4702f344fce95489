"""How well each measurement was predicted: p-values of what agents measured, under the belief before it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayesnet_track.belief.contract import Step
from bayesnet_track.belief.motion.formulas import derivative
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.distributions import p_value
from bayesnet_track.observation.cue import Measurement


def p_values(plate: CheckedTarget, step: Step[Any], hidden: Sequence[bool] = ()) -> dict[str, float]:
    """Agent -> probability of a measurement that is farther from the prediction than its own.

    Of agents at the root that measured, whose message reaches it as a Gaussian. A measurement shared by
    several targets has none, nor has one whose
    errors are written as expressions. Hypotheses in modes in which the target is `hidden` are left out, and
    those for which a measured function of the state has no value. Of a Gaussian belief its derivative is
    taken.
    """
    found = {}
    for agent in plate.agents:
        one = step.evidence.gaussians.get(agent)
        above = plate.agent(agent).parent
        if one is None or one.choices or one.errors is not None or above not in (plate.root, *plate.views):
            continue
        fields = step.posterior.fields
        if step.predicted:
            parts = [part for part in step.predicted if part.weight > 0]
            weights = np.array([part.weight for part in parts])
            each = [_of_gaussian(one, fields, part.mean, part.covariance) for part in parts]
            means, covariances = np.array([mean for mean, _ in each]), np.array([own for _, own in each])
        else:
            states, weights = step.support.states, step.prior.weights
            if any(hidden):
                weights = np.where(np.asarray(hidden)[states[:, -1].astype(np.intp)], 0.0, weights)
            means, covariances = _values(one, fields, states), one.covariance[None]
        known = np.isfinite(means).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2))
        weights = np.where(known, weights, 0.0)
        total = float(weights.sum())
        if total > 0:
            kept = np.flatnonzero(weights > 0)
            spreads = covariances if len(covariances) == 1 else covariances[kept]
            found[agent] = p_value(one.mean, weights[kept] / total, means[kept], spreads)
    return found


def _values(one: Measurement, fields: Sequence[str], states: Floats) -> Floats:
    """(N, K) what would be measured of states (N, D); angles within half a turn of what was."""
    if one.seen is None:
        return states[:, [fields.index(name) for name in one.fields]]
    values = one.seen.function({name: states[:, k] for k, name in enumerate(fields)})
    return np.asarray(one.mean + one.seen.less(values, one.mean))


def _of_gaussian(
    one: Measurement, fields: Sequence[str], mean: Floats, covariance: Floats
) -> tuple[Floats, Floats]:
    """Mean (K,) and covariance (K, K) of a measurement, its error included, under a Gaussian."""
    if one.seen is None:
        columns = [fields.index(name) for name in one.fields]
        return mean[columns], covariance[np.ix_(columns, columns)] + one.covariance
    slopes = derivative(lambda states: _values(one, fields, states), mean)
    return _values(one, fields, mean[None])[0], slopes @ covariance @ slopes.T + one.covariance
