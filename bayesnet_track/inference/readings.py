"""Measurements of quantities that are functions of the state: h(x) by the graph's expressions."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import replace

import numpy as np

from bayesnet_track.belief.motion.formulas import Undefined
from bayesnet_track.belief.motion.modes import FIELD
from bayesnet_track.graph.checked import PAST, MeasuredAs
from bayesnet_track.graph.expressions.distributions import distribution_of, moments, parameters_of
from bayesnet_track.graph.expressions.evaluate import log_values, values_of
from bayesnet_track.graph.expressions.periods import period_of
from bayesnet_track.graph.expressions.terms import DRAWN, Variable
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Hypotheses, Measurement
from bayesnet_track.observation.planes import FramePair
from bayesnet_track.observation.protocols import BOX, Errors, Seen


def read_as(measured: Measurement, functions: MeasuredAs, frames: FramePair) -> Measurement:
    """The measurement with h: what its quantities would be of states in these frames."""
    seen = seen_by(measured.fields, functions, frames)
    choices = tuple((weight, replace(one, seen=seen)) for weight, one in measured.choices)
    errors = None if not functions.errors else errors_by(measured.fields, functions, frames)
    return replace(measured, seen=seen, choices=choices, errors=errors)


def errors_by(quantities: Sequence[str], functions: MeasuredAs, frames: FramePair) -> Errors:
    """The distributions of errors in these frames, by states."""
    fixed = _fixed(functions, frames)
    terms = [functions.errors[name] for name in quantities]

    def densities(states: Mapping[str, Floats], away: Floats) -> Floats:
        names = {**in_modes(at_delay(states, functions), functions), **fixed}
        columns = [log_values(term, {**names, DRAWN: away[:, k]}) for k, term in enumerate(terms)]
        return np.stack([np.broadcast_to(column, (len(away),)) for column in columns], axis=1)

    return Errors(densities, all(distribution_of(term) == "normal" for term in terms))


def at_prediction(
    measured: Measurement, functions: MeasuredAs, states: Mapping[str, float], frames: FramePair
) -> tuple[Floats, float]:
    """Covariance (K, K) of the errors at a state, and the log density of an error of 0 there.

    Where a distribution has no variance its squared scale stands for it; where there is none, 1.
    """
    fields: dict[str, Floats] = {name: np.array([value]) for name, value in states.items()}
    names: dict[str, Floats | float] = {**fields, **_fixed(functions, frames)}
    variances = []
    for name in measured.fields:
        term = functions.errors[name]
        function, parameters = distribution_of(term), parameters_of(term, names, 1)
        variance = float(moments(function, parameters)[1][0])
        spread = variance if np.isfinite(variance) else float(parameters[1, 0]) ** 2
        variances.append(spread if np.isfinite(spread) and spread > 0 else 1.0)
    assert measured.errors is not None
    log = float(measured.errors.log_density(fields, np.zeros((1, len(variances)))).sum())
    return np.diag(variances), log if np.isfinite(log) else 0.0


def _fixed(functions: MeasuredAs, frames: FramePair) -> dict[str, float]:
    return {**frames.names, **functions.constants}


def at_delay(states: Mapping[str, Floats], functions: MeasuredAs) -> Mapping[str, Floats]:
    """The states as they were when the agent measured: between two frame intervals they change evenly."""
    if not functions.delay:
        return states
    whole, share = int(functions.delay), functions.delay % 1.0

    def before(name: str, lag: int) -> Floats:
        return states[f"{name}{PAST}{lag}"] if lag else states[name]

    late = {name: before(name, whole) for name in functions.late}
    if share:
        late = {name: (1.0 - share) * now + share * before(name, whole + 1) for name, now in late.items()}
    return {**states, **late}


def in_modes(states: Mapping[str, Floats], functions: MeasuredAs) -> Mapping[str, Floats]:
    """The states with what their combination of mode and values is, where they have the combination alone."""
    if FIELD not in states or all(name in states for name in functions.discrete):
        return states
    combination = states[FIELD].astype(np.intp)
    numbers = {name: np.array(own, dtype=np.float64) for name, own in functions.discrete.items()}
    return {**states, **{name: own[combination] for name, own in numbers.items()}}


def seen_by(quantities: Sequence[str], functions: MeasuredAs, frames: FramePair) -> Seen:
    """h: what quantities would be of states in these frames."""
    fixed = _fixed(functions, frames)
    terms = [functions.terms.get(name, Variable(name)) for name in quantities]

    def values(states: Mapping[str, Floats]) -> Floats:
        names = {**in_modes(at_delay(states, functions), functions), **fixed}
        size = len(next(iter(states.values())))
        return np.stack([np.broadcast_to(values_of(term, names), (size,)) for term in terms], axis=1)

    return Seen(values, np.array([period_of(term, functions.constants) for term in terms]))


def note_undefined(
    agent: str, measured: Measurement, hypotheses: Hypotheses, found: MutableMapping[str, Undefined]
) -> None:
    """Write down of which quantities hypotheses have no value."""
    if measured.seen is None:
        return
    states = {**{name: hypotheses.boxes[:, k] for k, name in enumerate(BOX)}, **hypotheses.fields}
    values = measured.seen.function(states)
    unknown = (~np.isfinite(values)).sum(axis=0)
    for name, count in zip(measured.fields, unknown.tolist(), strict=True):
        if count:
            found.setdefault(f"measures {agent}.{name}", Undefined(count, len(hypotheses)))
    if measured.errors is None:
        return
    without = (~np.isfinite(measured.errors.log_density(states, np.zeros_like(values)))).sum(axis=0)
    for name, count in zip(measured.fields, without.tolist(), strict=True):
        if count:
            found.setdefault(f"sd {agent}.{name}", Undefined(count, len(hypotheses)))
