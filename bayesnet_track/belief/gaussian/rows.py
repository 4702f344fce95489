"""Gaussian beliefs of T targets at once: hypotheses that stand for them, and Kalman updates by measurements.

Arrays of all targets come first in every shape. A target's bytes do not depend on who else is in the group.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from bayesnet_track.belief.contract import LEAST_SIDE_PX, MotionModel
from bayesnet_track.belief.gaussian.update import (
    LEAST,
    MeasurementUpdate,
    SigmaPoints,
    gated_of,
    mix_choices,
    observe_fields,
    take,
)
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.formulas import linearise_seen
from bayesnet_track.graph import spec
from bayesnet_track.graph.expressions.distributions import LinearNormal
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import (
    Updated,
    chi_square_quantile,
    linear_update,
    root,
    roots,
    sigma_points,
    symmetric,
)
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import Measurement

Moments = tuple[Floats, Floats]
"""Mean (D,) and covariance (D, D)."""


def stand_for_each(
    moments: Sequence[Moments],
    motion: MotionModel,
    settings: spec.Gaussian,
    draws: Iterable[np.random.Generator],
) -> list[SigmaPoints]:
    """Hypotheses that stand for each Gaussian: samples, or sigma points at +-sqrt(K + 1) sds and the mean.

    A hypothesis that would leave the image is moved to drawn border: what is said of it there is taken as the
    likelihood outside, so that the moments stay exact.
    """
    if settings.likelihood == "sigma_points":
        return [_sigma_points(*gaussian, motion) for gaussian in moments]
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.gaussian import stand_for

    width, bounds = len(moments[0][0]), (math.inf, math.inf, LEAST)
    if isinstance(motion, Confined) and not motion.leaves_image:
        bounds = float(motion.width), float(motion.height), LEAST
    is_in_pixels = getattr(motion, "least_side", LEAST_SIDE_PX) == LEAST_SIDE_PX
    size = max(settings.samples, 2 * (width + 1))
    halves = [rng.standard_normal((size // 2, width)) for rng in draws]
    points, flat, beta = dict[int, SigmaPoints](), list[int](), LogWeights.uniform(size)
    for row, ((mean, covariance), half) in enumerate(zip(moments, halves, strict=True)):
        lower, unit, states = np.empty((width, width)), np.empty((size, width)), np.empty((size, width))
        is_full = is_in_pixels and bool((covariance.diagonal() > 0.0).all())
        if is_full and stand_for(plain(mean), plain(covariance), half, bounds, unit, (lower, states)):
            points[row] = SigmaPoints(unit, lower, states, beta)
        else:
            flat.append(row)
    if flat:
        points |= _draw_flat(flat, moments, motion, settings.samples, halves)
    return [points[row] for row in range(len(moments))]


def _sigma_points(mean: Floats, covariance: Floats, motion: MotionModel) -> SigmaPoints:
    """Points at +-sqrt(K + 1) sds and the mean."""
    lower = root(covariance)
    width = lower.shape[1]
    unit = sigma_points(width, width + 1.0)
    log_beta = np.full(len(unit), -np.log(2.0 * (width + 1.0)))
    log_beta[0] = -np.log(width + 1.0)
    states = _placed(mean + unit @ lower.T, motion)
    return SigmaPoints(unit, lower, states, LogWeights.normalise(log_beta)[0])


def _placed(states: Floats, motion: MotionModel) -> Floats:
    """States (N, D), changed in place: sizes of 1 px at least, confined to the image where the motion is."""
    np.maximum(states[:, 2:4], getattr(motion, "least_side", LEAST_SIDE_PX), out=states[:, 2:4])
    return motion.confine(states) if isinstance(motion, Confined) else states


def _draw_flat(
    rows: Sequence[int], moments: Sequence[Moments], motion: MotionModel, samples: int, halves: list[Floats]
) -> dict[int, SigmaPoints]:
    """Row -> samples of drawn Gaussian, so many or as many as drawn rank needs, of those that may be flat."""
    groups: dict[int, list[tuple[int, Floats]]] = {}
    for row, lower in zip(rows, roots(np.array([moments[row][1] for row in rows])), strict=True):
        groups.setdefault(lower.shape[1], []).append((row, lower))
    points: dict[int, SigmaPoints] = {}
    for rank, group in groups.items():
        size = max(samples, 2 * (rank + 1))
        count = size // 2 * rank  # as if only these were drawn
        units = _whiten_each(
            np.array([halves[row].ravel()[:count].reshape(size // 2, rank) for row, _ in group]), size
        )
        lowers = np.array([lower for _, lower in group])
        means = np.array([moments[row][0] for row, _ in group])
        states = means[:, None] + units @ lowers.swapaxes(1, 2)
        _placed(states.reshape(-1, states.shape[2]), motion)
        beta = LogWeights.uniform(size)
        for (row, lower), unit, row_states in zip(group, units, states, strict=True):
            points[row] = SigmaPoints(unit, lower, row_states, beta)
    return points


def _whiten_each(halves: Floats, size: int) -> Floats:
    """(T, size, K) draws `halves` (T, size // 2, K), their negatives, 0 for an odd `size`; covariance I."""
    lower = np.linalg.cholesky((halves.swapaxes(1, 2) @ halves) * (2.0 / size))
    white = halves @ np.linalg.inv(lower).swapaxes(1, 2)
    middle = (np.zeros((len(halves), 1, halves.shape[2])),) if size % 2 else ()
    return np.concatenate([white, -white, *middle], axis=1)


def update_by_normals(
    mean: Floats, covariance: Floats, fields: Sequence[str], normals: Sequence[LinearNormal]
) -> Updated:
    """The product of the Gaussian with normal densities of linear forms of the state, exact.

    Its log-likelihood is the log of the product's integral.
    """
    observe, variances = np.zeros((len(normals), len(mean))), np.empty(len(normals))
    for row, normal in enumerate(normals):
        observe[row, [fields.index(name) for name in normal.form.factors]] = [*normal.form.factors.values()]
        variances[row] = normal.sd**2
    innovation = -np.array([normal.form.constant for normal in normals]) - observe @ mean
    updated = linear_update(mean, covariance, innovation, observe, np.diag(variances))
    log_peak = -0.5 * float(np.log(2.0 * np.pi * variances).sum())
    return evolve(updated, log_likelihood=updated.log_likelihood + log_peak)


def take_each(
    moments: Sequence[Moments],
    fields: tuple[str, ...],
    measured: Sequence[Mapping[str, Measurement]],
    gate: float,
    is_unscented: bool = False,
) -> list[MeasurementUpdate]:
    """Kalman updates of each Gaussian by what its agents measured (`update.take`)."""
    groups: dict[tuple[str, tuple[str, ...]], list[int]] = {}
    updates: dict[int, MeasurementUpdate] = {}
    mixed = _rows_of_choices(measured)
    updates |= _mix_each({row: moments[row] for row in mixed}, fields, measured, is_unscented)
    for row, (gaussian, messages) in enumerate(zip(moments, measured, strict=True)):
        if row in updates:
            continue
        agent, message = next(iter(messages.items()), ("", None))
        if message is not None and len(messages) == 1 and _is_correlated(message):
            groups.setdefault((agent, message.fields), []).append(row)
        else:
            updates[row] = take(*gaussian, fields, messages, gate, is_unscented)
    for (agent, _), rows in groups.items():
        group = [measured[row][agent] for row in rows]
        for row, update in zip(
            rows, _update_each(agent, [moments[row] for row in rows], fields, group, gate), strict=True
        ):
            updates[row] = update
    return [updates[row] for row in range(len(moments))]


def _rows_of_choices(measured: Sequence[Mapping[str, Measurement]]) -> list[int]:
    """Rows that are updated by choices alone, of quantities that are functions of the state.

    Their agents are those of the longest row, in its order; of one row alone nothing is found together.
    """
    order = [*max(measured, key=len, default={})]
    rows = [
        row
        for row, messages in enumerate(measured)
        if messages and [agent for agent in order if agent in messages] == [*messages]
        if all(message.choices and message.choices[0][1].seen is not None for message in messages.values())
    ]
    return rows if len(rows) > 1 else []


def _mix_each(
    moments: Mapping[int, Moments],
    fields: tuple[str, ...],
    measured: Sequence[Mapping[str, Measurement]],
    is_unscented: bool,
) -> dict[int, MeasurementUpdate]:
    """Row -> its update by choices alone (`update.take`); derivatives of an agent's are found at once."""
    beliefs, logs = dict(moments), dict.fromkeys(moments, 0.0)
    for agent in max((measured[row] for row in moments), key=len, default={}):
        rows = [row for row in moments if agent in measured[row]]
        quantities = measured[rows[0]][agent].choices[0][1].seen
        assert quantities is not None
        linear = linearise_seen(np.array([beliefs[row][0] for row in rows]), fields, quantities)
        for row, at_mean in zip(rows, linear, strict=True):
            message = measured[row][agent]
            mean, covariance, log = mix_choices(*beliefs[row], fields, message, is_unscented, at_mean)
            beliefs[row], logs[row] = (mean, covariance), logs[row] + log
    return {row: MeasurementUpdate(*beliefs[row], logs[row], measured[row], ()) for row in moments}


def _is_correlated(message: Measurement) -> bool:
    """True of a place by fields of the state, whose Gaussian errors depend on each other."""
    return (
        not message.choices and message.errors is None and message.seen is None and message.variances is None
    )


def _update_each(
    agent: str, moments: Sequence[Moments], fields: tuple[str, ...], group: Sequence[Measurement], gate: float
) -> list[MeasurementUpdate]:
    """Updates of each Gaussian by a measurement of the same K fields (`numerics.gaussian.linear_update`)."""
    means, covariances = (
        np.array([mean for mean, _ in moments]),
        np.array([covariance for _, covariance in moments]),
    )
    observe, noises = observe_fields(group[0], fields), np.array([message.covariance for message in group])
    innovations = np.array([message.mean for message in group]) - means @ observe.T
    cross = covariances @ observe.T
    expected = symmetric(observe @ cross + noises)
    gains = np.linalg.solve(expected, cross.swapaxes(1, 2)).swapaxes(1, 2)
    complement = np.eye(means.shape[1]) - gains @ observe
    d2s = (innovations[:, None] @ np.linalg.solve(expected, innovations[..., None]))[:, 0, 0]
    log_ratios = np.linalg.slogdet(noises)[1] - np.linalg.slogdet(expected)[1]
    updated_covariances = symmetric(
        complement @ covariances @ complement.swapaxes(1, 2) + gains @ noises @ gains.swapaxes(1, 2)
    )
    updated_means, logs = means + (gains @ innovations[..., None])[..., 0], 0.5 * log_ratios - 0.5 * d2s
    limit = math.inf if gate >= 1.0 else chi_square_quantile(gate, len(group[0].fields))
    return [
        MeasurementUpdate(updated_means[row], updated_covariances[row], log, {agent: group[row]}, ())
        if d2 <= limit
        else MeasurementUpdate(*moments[row], 0.0, {}, (gated_of(agent, d2, gate, len(group[row].fields)),))
        for row, (d2, log) in enumerate(zip(d2s.tolist(), logs.tolist(), strict=True))
    ]
