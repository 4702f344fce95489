"""Gaussian messages at the cells of a grid, and the evidence of further cells of the same frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesnet_track.belief.contract import Evaluate, Evidence
from bayesnet_track.belief.states import hypotheses_of
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.cue import Measurement


def log_gaussian(measured: Measurement, values: list[Floats]) -> Floats:
    """Log-likelihood of a Gaussian message at the values of its fields, mixed with its floor."""
    return _log_away(measured, np.stack(values, axis=-1) - measured.mean)


def log_measured(measured: Measurement, states: Floats, fields: tuple[str, ...]) -> Floats:
    """(N,) the same of states (N, D), by their fields or by functions of them."""
    if measured.seen is None:
        return log_gaussian(measured, [states[:, fields.index(name)] for name in measured.fields])
    values = measured.seen.function(dict(zip(fields, states.T, strict=True)))
    return _log_away(measured, np.nan_to_num(measured.seen.less(values, measured.mean), nan=1e100))


def _log_away(measured: Measurement, away: Floats) -> Floats:
    distance2 = np.einsum("...k,kl,...l->...", away, np.linalg.inv(measured.covariance), away)
    likelihood = measured.floor + (1.0 - measured.floor) * np.exp(-0.5 * distance2)
    return np.asarray(np.log(likelihood + 1e-300))  # finite far out, as products of masses need it


def ask_again(
    evaluate: Evaluate,
    first: Evidence,
    states: Floats,
    fields: tuple[str, ...],
    prior_log: Floats | None = None,
) -> Evidence:
    """The evidence at other states (N, D) of a frame that was measured already.

    Agents that measure look around the hypotheses that they are given, and would find another place now.
    What they measured first stands, so that both are evidence of one frame.
    """
    prior_log = LogWeights.uniform(len(states)).log if prior_log is None else prior_log
    again = evaluate(hypotheses_of(states, fields), prior_log)
    if not first.gaussians and not again.gaussians:
        return again
    sampled = again.log_likelihood if again.sampled is None else again.sampled
    total = sampled
    for one in first.gaussians.values():
        total = total + log_measured(one, states, fields)
    return replace(
        again, log_likelihood=total, gaussians=first.gaussians, sampled=sampled, measured=first.measured
    )
