"""How well each measurement was predicted: p-values of what agents measured, under the belief before it."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayesnet_track.belief.contract import Step
from bayesnet_track.belief.gaussian.update import update_by_errors
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
    for agent, one in _measured(plate, step):
        if one.errors is None and (mixture := _predicted(one, step, hidden)) is not None:
            found[agent] = p_value(one.mean, *mixture)
    return found


def log_predictive(
    plate: CheckedTarget, step: Step[Any], hidden: Sequence[bool] = (), given: Container[str] = ()
) -> dict[str, float]:
    """Agent -> log density of what it measured, under the belief before the frame, in its quantities' units.

    Of the same agents as `p_values`, without those that are `given` detections, and without floors. Errors
    that are written as expressions have theirs, too.
    """
    found = {}
    for agent, one in _measured(plate, step):
        if agent in given:
            continue
        if one.errors is not None:
            log = _by_errors(one, step)
            if log is not None:
                found[agent] = log
        elif (mixture := _predicted(one, step, hidden)) is not None:
            found[agent] = max(_log_mixture(one.mean, *mixture), LEAST_LOG)
    return found


LEAST_LOG = -1e6
"""Log densities are cut here, so that sums of them are numbers."""


def _measured(plate: CheckedTarget, step: Step[Any]) -> Iterator[tuple[str, Measurement]]:
    for agent in plate.agents:
        one = step.evidence.gaussians.get(agent)
        seen_by_root = plate.agent(agent).parent in (plate.root, *plate.views)
        if one is not None and not one.choices and seen_by_root:
            yield agent, one


def _predicted(
    one: Measurement, step: Step[Any], hidden: Sequence[bool]
) -> tuple[Floats, Floats, Floats] | None:
    """Weights (P,), means (P, K) and covariances (P, K, K) or (1, K, K) of the predicted measurement."""
    fields = step.posterior.fields
    if step.predicted:
        parts = [(mode, part) for mode, part in enumerate(step.predicted) if part.weight > 0]
        weights = np.array([part.weight for _, part in parts])
        each = [_of_gaussian(one.in_mode(mode), fields, part.mean, part.covariance) for mode, part in parts]
        means, covariances = np.array([mean for mean, _ in each]), np.array([own for _, own in each])
        if not parts:
            return None
    else:
        states, weights = step.support.states, step.prior.weights
        if any(hidden):
            weights = np.where(np.asarray(hidden)[states[:, -1].astype(np.intp)], 0.0, weights)
        means, covariances = _values(one, fields, states), one.covariance[None]
    known = np.isfinite(means).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2))
    weights = np.where(known, weights, 0.0)
    total = float(weights.sum())
    if not total > 0:
        return None
    kept = np.flatnonzero(weights > 0)
    spreads = covariances if len(covariances) == 1 else covariances[kept]
    return weights[kept] / total, means[kept], spreads


def _log_mixture(value: Floats, weights: Floats, means: Floats, covariances: Floats) -> float:
    """log density of a mixture of Gaussians at `value` (K,)."""
    away = value - means
    inverse = np.linalg.inv(covariances)
    d2 = np.einsum("pi,pij,pj->p", away, np.broadcast_to(inverse, (len(away), *inverse.shape[1:])), away)
    log = np.log(weights) - 0.5 * (d2 + np.linalg.slogdet(2.0 * np.pi * covariances)[1])
    top = float(log.max())
    return top + float(np.log(np.exp(log - top).sum()))


def _by_errors(one: Measurement, step: Step[Any]) -> float | None:
    """The same where the distribution of the errors is written as an expression."""
    exact, fields = replace(one, floor=0.0), step.posterior.fields
    if step.predicted:
        modal = [(mode, part) for mode, part in enumerate(step.predicted) if part.weight > 0]
        parts = [part for _, part in modal]
        each = [
            update_by_errors(part.mean, part.covariance, fields, exact.in_mode(mode)) for mode, part in modal
        ]
        log = np.array([-np.inf if own is None else own.log_likelihood for own in each])
        log = log + np.log([part.weight for part in parts])
    else:
        states = dict(zip(fields, step.support.states.T, strict=True))
        log = exact.log_by_errors(states) + step.prior.log
    top = float(log.max()) if len(log) else -np.inf
    if not np.isfinite(top):
        return None
    return max(top + float(np.log(np.exp(log - top).sum())) + one.log_constant, LEAST_LOG)


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
