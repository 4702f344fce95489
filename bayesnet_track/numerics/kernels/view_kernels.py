"""Compiled kernels for what is seen of states: outlines in images without distortion, and updates by them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.compiled import compiled, plain
from bayesnet_track.numerics.gaussian import Expectation, factor, independent_log


@compiled
def straight_outlines(axes: Floats, origin: Floats, ground: Floats) -> tuple[Floats, Floats]:
    """Boxes (N, 4) of targets (N, D) by a projection [axes origin] to pixels, and derivatives (N, 4, D).

    As of `numerics.outlines`, whose lens is none: nan in a whole row where a target is not entirely in front
    of the camera.
    """
    count, width_of_state = ground.shape
    boxes, slopes = np.empty((count, 4)), np.empty((count, 4, width_of_state))
    centre, halves, tangent_axes = np.empty(3), np.empty(3), np.empty(3)
    bounds, moves = np.empty((2, 2)), np.empty((2, 2, width_of_state))
    stands = width_of_state == 4
    for n in range(count):
        width, height = ground[n, 2], ground[n, 3]
        halves[0] = halves[1] = abs(width) / 2
        halves[2] = abs(height) / 2
        reached = 0.0
        for i in range(3):
            centre[i] = origin[i] + axes[i, 0] * ground[n, 0] + axes[i, 1] * ground[n, 1]
            centre[i] += axes[i, 2] * height / 2 if stands else axes[i, 2] * ground[n, 4]
        for k in range(3):
            reached += (halves[k] * axes[2, k]) ** 2
        is_seen = centre[2] > math.sqrt(reached)
        for b in range(2):
            # s_k^2 (a_k - d g_k)^2 = (p - d q)^2 with d = x or y, a its row of the axes, g the depth's
            along = square = 0.0
            middle = centre[b] / centre[2] if is_seen else 0.0
            for k in range(3):
                centred_axis = axes[b, k] - middle * axes[2, k]
                along += halves[k] ** 2 * centred_axis * axes[2, k]
                square += halves[k] ** 2 * centred_axis**2
            depth_term = reached - centre[2] ** 2
            discriminant = along * along - square * depth_term
            is_seen = is_seen and discriminant >= 0.0
            for side in range(2):
                sign = -1.0 if side == 0 else 1.0
                offset = (along - sign * math.sqrt(max(discriminant, 0.0))) / depth_term if is_seen else 0.0
                double_depth = (along - offset * depth_term) * 2.0
                bounds[b, side] = middle + offset
                for k in range(3):
                    tangent_axes[k] = axes[b, k] - (middle + offset) * axes[2, k]
                p = -offset * centre[2]
                if is_seen and double_depth != 0.0:
                    moves[b, side, 0] = -2.0 * p * tangent_axes[0] / double_depth
                    moves[b, side, 1] = -2.0 * p * tangent_axes[1] / double_depth
                    moves[b, side, 2] = (
                        width / 2 * (tangent_axes[0] ** 2 + tangent_axes[1] ** 2) / double_depth
                    )
                    rise = p * tangent_axes[2]
                    half = height / 2 * tangent_axes[2] ** 2
                    moves[b, side, 3] = (half - rise if stands else half) / double_depth
                    if not stands:
                        moves[b, side, 4] = -2.0 * rise / double_depth
                else:
                    moves[b, side] = math.nan
        for b in range(2):
            boxes[n, b] = (bounds[b, 0] + bounds[b, 1]) / 2 if is_seen else math.nan
            boxes[n, b + 2] = bounds[b, 1] - bounds[b, 0] if is_seen else math.nan
            for j in range(width_of_state):
                slopes[n, b, j] = (moves[b, 0, j] + moves[b, 1, j]) / 2 if is_seen else math.nan
                slopes[n, b + 2, j] = moves[b, 1, j] - moves[b, 0, j] if is_seen else math.nan
    return boxes, slopes


@compiled
def mix_seen_rows(
    moments: tuple[Floats, Floats],
    expected: tuple[Floats, Floats, Bools],
    starts: Ints,
    measured: tuple[Floats, Floats],
    shares: tuple[Floats, Floats],
    considered: Bools,
) -> Floats:
    """Update rows by functions of the state with K values, in place; (T,) log evidence, 0 of rows without.

    Row t has choices from `starts[t]` to `starts[t + 1]`, each with a Kalman update P - C S^-1 C'; fields
    that are `considered` (D,), not estimated, have the gain 0 (Schmidt). The moments are those of the mixture
    of the updates and of none. `moments` are (T, D), (T, D, D); `expected` covariances of the values
    (T, K, K), of state and values C (T, D, K), and which rows have values; `measured` (P, K) values less
    those expected, and their errors' (P, K, K); `shares` (P,) the probability of each choice, (T,) of none.
    """
    (mean, covariance), (spreads, crosses, is_known), (innovations, noises) = moments, expected, measured
    (weights, missed), (count, size), width = shares, mean.shape, innovations.shape[1]
    lower, whitened, logs = np.zeros((width, width)), np.empty(width), np.zeros(count)
    total, carried = np.empty((width, width)), np.empty((size, width))
    move, shift, change = np.empty(size), np.empty(size), np.empty((size, size))
    for t in range(count):
        if not is_known[t] or starts[t] == starts[t + 1]:
            continue
        evidence, cross = missed[t], crosses[t]
        shift[:] = 0.0
        change[:] = 0.0
        for n in range(starts[t], starts[t + 1]):
            for i in range(width):
                for j in range(width):
                    total[i, j] = spreads[t, i, j] + noises[n, i, j]
            half_log, d2 = factor(total, lower, width), 0.0
            for i in range(width):
                value = innovations[n, i]
                for j in range(i):
                    value -= lower[i, j] * whitened[j]
                whitened[i] = value / lower[i, i]
                d2 += whitened[i] * whitened[i]
            for k in range(size):
                move[k] = 0.0
                for i in range(width):
                    value = cross[k, i]
                    for j in range(i):
                        value -= lower[i, j] * carried[k, j]
                    carried[k, i] = value / lower[i, i]  # C L^-T, S = L L'
                    if not considered[k]:
                        move[k] += carried[k, i] * whitened[i]
            share = weights[n]
            for k in range(size):
                shift[k] += share * move[k]
                for m in range(k + 1):
                    value = 0.0
                    if not (considered[k] and considered[m]):
                        for i in range(width):
                            value += carried[k, i] * carried[m, i]
                    change[k, m] += share * (move[k] * move[m] - value)
            log_noise = factor(noises[n], lower, width)
            evidence += share * math.exp(log_noise - half_log - 0.5 * d2)
        for k in range(size):
            mean[t, k] += shift[k]
            for m in range(k + 1):
                value = 0.5 * (covariance[t, k, m] + covariance[t, m, k]) + change[k, m] - shift[k] * shift[m]
                covariance[t, k, m], covariance[t, m, k] = value, value
        logs[t] = math.log(max(evidence, 1e-300))
    return logs


def mix_expected(
    moments: tuple[Floats, Floats],
    expected: Expectation,
    measured: tuple[Floats, Floats],
    choices: tuple[Ints, Floats, Floats],
    considered: Sequence[int] = (),
) -> Floats:
    """Update Gaussians by what was measured of expected values, in place; (T,) log evidence.

    As `mix_seen_rows`, of which `choices` are starts and shares, and
    `considered` the columns that are allowed for and not estimated.
    """
    (mean, covariance), (starts, weights, missed) = moments, choices
    is_considered = np.zeros(mean.shape[1], dtype=np.bool_)
    is_considered[[*considered]] = True
    values = plain(expected.spread), plain(expected.cross), expected.is_known
    shares = plain(weights), plain(missed)
    return mix_seen_rows(
        (mean, covariance), values, starts, (plain(measured[0]), plain(measured[1])), shares, is_considered
    )


@compiled
def message_choices(
    hypotheses: Floats,
    starts: Ints,
    measured: tuple[Floats, Floats],
    shares: tuple[Floats, Floats],
    floor: float,
    largest: float,
) -> Floats:
    """(T, N) log-likelihoods of hypotheses (T, N, K) of rows under the choices of each, at most 0.

    Row t has choices from `starts[t]` to `starts[t + 1]`. `measured` (P, K) values and variances of their
    errors, which are independent; `shares` as of `mix_seen_rows`. The likelihood of a choice is mixed with a
    `floor`; squares of errors in sds are at most `largest`.
    """
    (values, variances), (weights, missed), (count, size, width) = measured, shares, hypotheses.shape
    logs, errors, log = np.zeros((count, size)), np.empty((size, width)), np.empty(size)
    for t in range(count):
        if starts[t] == starts[t + 1]:
            continue
        for n in range(size):
            logs[t, n] = missed[t]
        for p in range(starts[t], starts[t + 1]):
            for n in range(size):
                for k in range(width):
                    errors[n, k] = hypotheses[t, n, k] - values[p, k]
            independent_log(errors, variances[p], largest, log)
            for n in range(size):
                logs[t, n] += weights[p] * min(floor + (1.0 - floor) * math.exp(log[n]), 1.0)
        for n in range(size):
            logs[t, n] = min(math.log(logs[t, n]), 0.0) if logs[t, n] > 0.0 else -math.inf
    return logs
