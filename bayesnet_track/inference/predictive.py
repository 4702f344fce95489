"""How well each measurement was predicted: p-values of what agents measured, under the belief before it."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayesnet_track.belief.contract import Step
from bayesnet_track.belief.gaussian.update import update_by_errors
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.distributions import p_value
from bayesnet_track.numerics.lenses import derivatives
from bayesnet_track.observation.cue import Measurement


def p_values(plate: CheckedTarget, step: Step[Any], hidden: Sequence[bool] = ()) -> dict[str, float]:
    """Agent -> probability of a measurement that is farther from the prediction than its own.

    Of agents at the root that measured, whose message reaches it as a Gaussian. A measurement shared by
    several targets has none, nor has one whose
    errors are written as expressions. Hypotheses in modes in which the target is `hidden` are left out, and
    those for which a measured function of the state has no value. Of a Gaussian belief its derivative is
    taken.
    """
    values = {}
    for agent, measurement in _measured(plate, step):
        if measurement.errors is None and (mixture := _predicted(measurement, step, hidden)) is not None:
            values[agent] = p_value(measurement.mean, *mixture)
    return values


def log_predictive(
    plate: CheckedTarget, step: Step[Any], hidden: Sequence[bool] = (), detections: Container[str] = ()
) -> dict[str, float]:
    """Agent -> log density of what it measured, under the belief before the frame, in its quantities' units.

    Of the same agents as `p_values`, without those that are given `detections`, and without floors. Errors
    that are written as expressions have theirs, too.
    """
    densities = {}
    for agent, measurement in _measured(plate, step):
        if agent in detections:
            continue
        if measurement.errors is not None:
            log = _by_errors(measurement, step)
            if log is not None:
                densities[agent] = log
        elif (mixture := _predicted(measurement, step, hidden)) is not None:
            densities[agent] = max(_log_mixture(measurement.mean, *mixture), LEAST_LOG)
    return densities


LEAST_LOG = -1e6
"""Log densities are cut here, so that sums of them are numbers."""


def _measured(plate: CheckedTarget, step: Step[Any]) -> Iterator[tuple[str, Measurement]]:
    for agent in plate.agents:
        measurement = step.evidence.gaussians.get(agent)
        seen_by_root = plate.agent(agent).parent in (plate.root, *plate.views)
        if measurement is not None and not measurement.choices and seen_by_root:
            yield agent, measurement


def _predicted(
    measurement: Measurement, step: Step[Any], hidden: Sequence[bool]
) -> tuple[Floats, Floats, Floats] | None:
    """Weights (P,), means (P, K) and covariances (P, K, K) or (1, K, K) of the predicted measurement."""
    fields = step.posterior.fields
    if step.predicted:
        parts = [(mode, part) for mode, part in enumerate(step.predicted) if part.weight > 0]
        weights = np.array([part.weight for _, part in parts])
        each = [
            _of_gaussian(measurement.in_mode(mode), fields, part.mean, part.covariance)
            for mode, part in parts
        ]
        means, covariances = (
            np.array([mean for mean, _ in each]),
            np.array([covariance for _, covariance in each]),
        )
        if not parts:
            return None
    else:
        states, weights = step.support.states, step.prior.weights
        if any(hidden):
            weights = np.where(np.asarray(hidden)[states[:, -1].astype(np.intp)], 0.0, weights)
        means, covariances = _values(measurement, fields, states), measurement.covariance[None]
    has_value = np.isfinite(means).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2))
    weights = np.where(has_value, weights, 0.0)
    total = float(weights.sum())
    if not total > 0:
        return None
    rows = np.flatnonzero(weights > 0)
    spreads = covariances if len(covariances) == 1 else covariances[rows]
    return weights[rows] / total, means[rows], spreads


def _log_mixture(value: Floats, weights: Floats, means: Floats, covariances: Floats) -> float:
    """log density of a mixture of Gaussians at `value` (K,)."""
    deviations = value - means
    inverse = np.linalg.inv(covariances)
    d2 = np.einsum(
        "pi,pij,pj->p",
        deviations,
        np.broadcast_to(inverse, (len(deviations), *inverse.shape[1:])),
        deviations,
    )
    log = np.log(weights) - 0.5 * (d2 + np.linalg.slogdet(2.0 * np.pi * covariances)[1])
    top = float(log.max())
    return top + float(np.log(np.exp(log - top).sum()))


def _by_errors(measurement: Measurement, step: Step[Any]) -> float | None:
    """The same where the distribution of the errors is written as an expression."""
    exact, fields = replace(measurement, floor=0.0), step.posterior.fields
    if step.predicted:
        modal = [(mode, part) for mode, part in enumerate(step.predicted) if part.weight > 0]
        parts = [part for _, part in modal]
        each = [
            update_by_errors(part.mean, part.covariance, fields, exact.in_mode(mode)) for mode, part in modal
        ]
        log = np.array([-np.inf if update is None else update.log_likelihood for update in each])
        log = log + np.log([part.weight for part in parts])
    else:
        states = dict(zip(fields, step.support.states.T, strict=True))
        log = exact.log_by_errors(states) + step.prior.log
    top = float(log.max()) if len(log) else -np.inf
    if not np.isfinite(top):
        return None
    return max(top + float(np.log(np.exp(log - top).sum())) + measurement.log_constant, LEAST_LOG)


def _values(measurement: Measurement, fields: Sequence[str], states: Floats) -> Floats:
    """(N, K) what would be measured of states (N, D); angles within half a turn of what was."""
    if measurement.seen is None:
        return states[:, [fields.index(name) for name in measurement.fields]]
    values = measurement.seen.function({name: states[:, k] for k, name in enumerate(fields)})
    return np.asarray(measurement.mean + measurement.seen.less(values, measurement.mean))


def _of_gaussian(
    measurement: Measurement, fields: Sequence[str], mean: Floats, covariance: Floats
) -> tuple[Floats, Floats]:
    """Mean (K,) and covariance (K, K) of a measurement, its error included, under a Gaussian."""
    if measurement.seen is None:
        columns = [fields.index(name) for name in measurement.fields]
        return mean[columns], covariance[np.ix_(columns, columns)] + measurement.covariance
    slopes = derivatives(lambda states: _values(measurement, fields, states), mean[None])[0]
    return _values(measurement, fields, mean[None])[
        0
    ], slopes @ covariance @ slopes.T + measurement.covariance
