"""What a measurement says of states: which fields it observes, and how likely it makes each hypothesis."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Hypotheses, Measurement

FAR = 1e100
"""Where a quantity has no value, it is so far from what was measured."""


def log_message(one: Measurement, hypotheses: Hypotheses, fields: tuple[str, ...]) -> Floats:
    """(N,) -d^2 / 2 of hypotheses under a measurement."""
    if one.choices:
        each = (weight * np.exp(log_message(own, hypotheses, fields)) for weight, own in one.choices)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(one.missed + sum(each)))
    states = np.column_stack([hypotheses.boxes, *(hypotheses.fields[name] for name in fields[4:])])
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
