"""Gaussian beliefs of T targets at once: hypotheses that stand for them, and Kalman updates by measurements.

Arrays of all targets come first in every shape. A target's bytes do not depend on who else is in the group.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from bayesnet_track.belief.contract import LEAST_SIDE_PX, Choices, MotionModel
from bayesnet_track.belief.gaussian.update import (
    LEAST,
    Gated,
    MeasurementUpdate,
    SigmaPoints,
    gated_of,
    measured_columns,
    observe_fields,
    update_by,
)
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.formulas import linearise_seen
from bayesnet_track.graph import spec
from bayesnet_track.graph.expressions.distributions import LinearNormal
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import (
    Expectation,
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
from bayesnet_track.observation.protocols import Seen

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


def take(
    mean: Floats,
    covariance: Floats,
    fields: tuple[str, ...],
    measured: Mapping[str, Measurement],
    gate: float,
    is_unscented: bool = False,
) -> MeasurementUpdate:
    """Kalman updates by what agents measured, one after the other, as exact as all at once.

    A measurement is left out when d^2 = v' S^-1 v exceeds the chi-square quantile of `gate` (tracking chapter
    3.9 b: no object near the prediction, so that only the prediction stands). Every d^2 is taken against the
    belief before any of them, so that their order decides nothing. One with choices gives the mean and the
    covariance of the mixture of its updates; it is never left out, because its choices were gated when they
    were made, nor is one whose errors are not Gaussian (`update_by_errors`). Quantities that are functions of
    the state are taken by their derivative at the mean, or at sigma points where `is_unscented`; without a
    value there they are not used.
    """
    accepted: dict[str, Measurement] = {}
    gated: list[Gated] = []
    for agent, measurement in measured.items():
        if measurement.choices or (measurement.errors is not None and not measurement.errors.is_normal):
            accepted[agent] = measurement
            continue
        if measurement.seen is None and gate >= 1.0:  # nothing is too far
            accepted[agent] = measurement
            continue
        trial = update_by(mean, covariance, fields, evolve(measurement, errors=None), is_unscented)
        if trial is None:
            continue
        d2 = trial.d2
        degrees = len(measurement.fields)
        limit = chi_square_quantile(gate, degrees)
        if d2 > limit:
            gated.append(gated_of(agent, d2, gate, degrees))
        else:
            accepted[agent] = measurement
    log_evidence = 0.0
    for measurement in accepted.values():
        if measurement.choices:
            means, covariances = mean[None].copy(), covariance[None].copy()
            choices = choices_of([measurement])
            log_evidence += float(mix_choices((means, covariances), fields, choices, is_unscented)[0])
            mean, covariance = means[0], covariances[0]
            continue
        update = update_by(mean, covariance, fields, measurement, is_unscented)
        if update is None:
            continue
        mean, covariance = update.mean, update.covariance
        log_evidence += update.log_likelihood
    return MeasurementUpdate(mean, covariance, log_evidence, accepted, tuple(gated))


def expect_seen(
    quantities: Seen, fields: tuple[str, ...], moments: Moments, is_unscented: bool
) -> Expectation:
    """Expected values of quantities z = h(x) of states (T, D), (T, D, D): by slopes, or by sigma points."""
    mean, covariance = moments
    values, slopes = linearise_seen(mean, fields, quantities)
    if not is_unscented:
        expected = _expect_by_slopes(values, slopes, covariance)
    else:

        def measure_near(states: Floats, centre: Floats) -> Floats:
            measured = quantities.function(dict(zip(fields, states.T, strict=True)))
            return np.asarray(centre + quantities.less(measured, centre))

        expected = _expect_by_points(measure_near, values, mean, covariance)
    if quantities.beyond is None:
        return expected
    expected = evolve(expected, values=expected.values.copy())
    for row in np.flatnonzero(expected.is_known).tolist():
        shift, spread = quantities.beyond(mean[row], covariance[row])
        expected.values[row] += 0.0 if is_unscented else shift  # sigma points see it by themselves
        expected.spread[row] += spread
    return expected


def _expect_by_slopes(values: Floats, slopes: Floats, covariance: Floats) -> Expectation:
    """Expected values by those at the mean (T, K) and derivatives there (T, K, D); covariances (T, D, D)."""
    with np.errstate(all="ignore"):
        cross = covariance @ slopes.swapaxes(1, 2)
        spread = slopes @ cross
    return _finite(values, spread, cross, values)


def _expect_by_points(
    measure: Callable[[Floats, Floats], Floats], at_mean: Floats, mean: Floats, covariance: Floats
) -> Expectation:
    """Expected values by the unscented transform; `measure` has values (N, K) of states, near some (K,).

    At 2 K + 1 points that lie at +-sqrt(max(K, 3)) sds, K the covariance's rank.
    """
    values, spread = np.empty_like(at_mean), np.empty((*at_mean.shape, at_mean.shape[1]))
    cross = np.zeros((*mean.shape, at_mean.shape[1]))
    with np.errstate(all="ignore"):
        for row in range(len(mean)):
            lower = root(covariance[row])
            rank = lower.shape[1]
            scale = max(rank, 3.0)
            unit = sigma_points(rank, scale)
            weights = np.full(len(unit), 0.5 / scale)
            weights[0] = 1.0 - rank / scale
            points = measure(mean[row] + unit @ lower.T, at_mean[row])
            values[row] = weights @ points
            weighted = (points - values[row]) * weights[:, None]
            spread[row] = weighted.T @ (points - values[row])
            cross[row] = lower @ (unit.T @ weighted)
    return _finite(values, spread, cross, at_mean)


def _finite(values: Floats, spread: Floats, cross: Floats, at_mean: Floats) -> Expectation:
    """The expectation, with harmless numbers where the functions have no values."""
    is_known = np.asarray(np.isfinite(values).all(axis=1) & np.isfinite(spread).all(axis=(1, 2)))
    if not is_known.all():
        values, cross = (
            np.where(is_known[:, None], values, 0.0),
            np.where(is_known[:, None, None], cross, 0.0),
        )
        spread = np.where(is_known[:, None, None], spread, 0.0)
    return Expectation(values, symmetric(spread), cross, is_known, at_mean)


def choices_of(measured: Sequence[Measurement]) -> Choices:
    """The choices of a measurement of each target, of the same quantities."""
    choices = [choice for message in measured for _, choice in message.choices]
    quantities, starts = choices[0].seen, np.cumsum([0, *(len(message.choices) for message in measured)])
    covariances = np.array([choice.covariance for choice in choices])
    if quantities is not None and quantities.covariance is not None:
        covariances = np.zeros_like(covariances)
        for place, choice in enumerate(choices):
            if choice.seen is not None and choice.seen.extra_covariance is not None:
                covariances[place] = choice.seen.extra_covariance
    return Choices(
        choices[0].fields,
        starts,
        np.array([choice.mean for choice in choices]),
        covariances,
        np.array([weight for message in measured for weight, _ in message.choices]),
        np.array([message.missed for message in measured]),
        quantities,
    )


def mix_choices(moments: Moments, fields: tuple[str, ...], choices: Choices, is_unscented: bool) -> Floats:
    """Update Gaussians (T, D), (T, D, D) by the choices of each, in place; (T,) log evidence.

    Their moments are those of the mixture of the updates by each choice, and by none. Where functions of the
    state have no value at the mean nothing is used.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.view_kernels import mix_expected

    mean, covariance = moments
    rows, quantities = np.repeat(np.arange(len(mean)), choices.counts), choices.quantities
    considered: tuple[int, ...] = ()
    noises = choices.covariances
    if quantities is None:
        columns = [*measured_columns(choices.fields, fields)]
        at_mean, cross = mean[:, columns], covariance[:, :, columns]
        expected = Expectation(at_mean, cross[:, columns], cross, np.ones(len(mean), dtype=np.bool_), at_mean)
        innovations = choices.values - at_mean[rows]
    else:
        expected = expect_seen(quantities, fields, moments, is_unscented)
        innovations = quantities.less(choices.values, expected.values[rows])
        considered = measured_columns(quantities.shared, fields)
        if quantities.covariance is not None:
            noises = quantities.covariance(expected.at_mean)[rows] + noises
    weighed = (choices.starts, choices.weights, choices.missed)
    return mix_expected(moments, expected, (innovations, noises), weighed, considered)


def take_each(
    moments: Sequence[Moments],
    fields: tuple[str, ...],
    measured: Sequence[Mapping[str, Measurement]],
    gate: float,
    is_unscented: bool = False,
    choices: Mapping[str, Choices] = MappingProxyType({}),
) -> list[MeasurementUpdate]:
    """Kalman updates of each Gaussian by what its agents measured (`update.take`).

    Where `choices` has the detections of all agents nothing else was measured.
    """
    if choices:
        mean, covariance = (np.array(arrays) for arrays in zip(*moments, strict=True))
        logs = sum(
            mix_choices((mean, covariance), fields, detections, is_unscented)
            for detections in choices.values()
        )
        return [
            MeasurementUpdate(mean[row], covariance[row], log, {}, ())
            for row, log in enumerate(np.asarray(logs).tolist())
        ]
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

    Their agents are those of the longest row, in its order.
    """
    order = [*max(measured, key=len, default={})]
    return [
        row
        for row, messages in enumerate(measured)
        if messages and [agent for agent in order if agent in messages] == [*messages]
        if all(message.choices and message.choices[0][1].seen is not None for message in messages.values())
    ]


def _mix_each(
    moments: Mapping[int, Moments],
    fields: tuple[str, ...],
    measured: Sequence[Mapping[str, Measurement]],
    is_unscented: bool,
) -> dict[int, MeasurementUpdate]:
    """Row -> its update by choices alone (`update.take`), one agent after the other, all rows at once."""
    if not moments:
        return {}
    places, logs = {row: place for place, row in enumerate(moments)}, np.zeros(len(moments))
    mean = np.array([mean for mean, _ in moments.values()])
    covariance = np.array([covariance for _, covariance in moments.values()])
    for agent in max((measured[row] for row in moments), key=len):
        rows = [row for row in moments if agent in measured[row]]
        group = [measured[row][agent] for row in rows]
        some = [places[row] for row in rows]
        group_mean, group_covariance = mean[some], covariance[some]
        logs[some] += mix_choices((group_mean, group_covariance), fields, choices_of(group), is_unscented)
        mean[some], covariance[some] = group_mean, group_covariance
    return {
        row: MeasurementUpdate(mean[place], covariance[place], float(logs[place]), measured[row], ())
        for row, place in places.items()
    }


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
