"""Mixtures of Gaussians: log-density, largest point of a weighted one, quantiles.

A sum over all components in double precision is expensive. So a likely winner sets the value to beat;
points that cannot reach it by an upper bound are given up; sums in single precision, of a known error, over
the components that are near give up nearly all that are left; the last few are summed exactly. The result
is that of exact sums everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from bayesnet_track.numerics.arrays import Floats, Ints, Singles
from bayesnet_track.numerics.compiled import compiled, compiled_fusing

FAST_ERROR = 1e-5
"""Largest error of `add_sums`, as a share of the sum of peaks, for coordinates without rounding.

exp(-x) is taken to be the 32nd power of the fourth-order series at x / 32: an error of about
max x^5 e^-x / (32^4 5!) = 2e-7. The powers enlarge the rounding of a single (6e-8) 64 times, 4e-6; groups of
32 sum with 2e-6. What lies beyond `_REACH` counts 1.3e-6."""

_SLACK = 1e-9
"""Bounds are compared with this much room for the rounding of double precision, nats."""

_BLOCK = 256
_GROUP = 16
_LANES = 16
_CELLS = 64
_REACH = 5.2
"""Standard deviations beyond which a component counts nothing: exp(-5.2^2 / 2) = 1.3e-6 is in the error."""
_HEAVY = 0.1
"""Components with more than this share of the largest peak come first: they alone give up most points.

Where most are so heavy, all come at once."""


@compiled_fusing
def add_sums(
    points: Singles, peaks: Singles, means: Singles, precisions: Singles, spans: Ints, sums: Floats
) -> None:
    """Add sum_n peaks_n exp(-|(point - means_n) precisions_n|^2 / 2) to `sums` (M,), see `FAST_ERROR`.

    Of each group of 16 components `spans` (G, 2) has the first point that it counts for, and that after the
    last.

    `points` is (K, M), C order, one row per dimension: the inner loops run over points, so that the compiler
    can use vector instructions without leave to reorder a sum. Two dimensions a turn: K is even (add a row of
    zeros). peaks (N,), means and precisions (1 / sd) (N, K).
    """
    size, count = points.shape
    y, part = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    unity, half = np.float32(1), np.float32(1 / 2)
    sixth, twenty_fourth = np.float32(1 / 6), np.float32(1 / 24)
    cutoff = np.float32(0.6)  # beyond, exp(-32 * 0.6) is below the error
    eighth = np.float32(0.125)
    for first in range(0, count, _BLOCK):
        for group in range(spans.shape[0]):
            low, high = max(first, spans[group, 0]), min(first + _BLOCK, spans[group, 1])
            low, high = low // _LANES * _LANES, min((high + _LANES - 1) // _LANES * _LANES, count)
            width = high - low
            if width <= 0:
                continue
            part[:width] = np.float32(0)
            for n in range(group * _GROUP, min((group + 1) * _GROUP, peaks.shape[0])):
                peak = peaks[n]
                if size == 4:  # the usual number, in one loop instead of three
                    a, b = points[0, low:high], points[1, low:high]
                    c, d = points[2, low:high], points[3, low:high]
                    ma, mb, mc, md = means[n, 0], means[n, 1], means[n, 2], means[n, 3]
                    sa, sb = precisions[n, 0] * eighth, precisions[n, 1] * eighth
                    sc, sd = precisions[n, 2] * eighth, precisions[n, 3] * eighth
                    for m in range(width):
                        wa, wb = (a[m] - ma) * sa, (b[m] - mb) * sb
                        wc, wd = (c[m] - mc) * sc, (d[m] - md) * sd
                        t = min((wa * wa + wb * wb) + (wc * wc + wd * wd), cutoff)
                        e = unity - t * (unity - t * (half - t * (sixth - t * twenty_fourth)))
                        e *= e
                        e *= e
                        e *= e
                        e *= e
                        e *= e
                        part[m] += peak * e
                    continue
                y[:width] = np.float32(0)
                for k in range(0, size, 2):
                    row, next_row = points[k, low:high], points[k + 1, low:high]
                    mean, scale = means[n, k], precisions[n, k] * eighth
                    other_mean, other_scale = means[n, k + 1], precisions[n, k + 1] * eighth
                    for m in range(width):
                        gap, next_gap = (row[m] - mean) * scale, (next_row[m] - other_mean) * other_scale
                        y[m] += gap * gap + next_gap * next_gap
                for m in range(width):
                    t = min(y[m], cutoff)
                    e = unity - t * (unity - t * (half - t * (sixth - t * twenty_fourth)))
                    e *= e
                    e *= e
                    e *= e
                    e *= e
                    e *= e
                    part[m] += peak * e
            for m in range(width):
                sums[low + m] += part[m]


@compiled
def exact_sum(point: Floats, peaks: Floats, means: Floats, precisions: Floats) -> float:
    """The same sum at one point (K,), in full accuracy; means and precisions (N, K)."""
    total = 0.0
    for n in range(peaks.shape[0]):
        square = 0.0
        for k in range(point.shape[0]):
            deviation = (point[k] - means[n, k]) * precisions[n, k]
            square += deviation * deviation
        total += peaks[n] * np.exp(-0.5 * square)
    return total


@compiled
def _peaks(log_weights: Floats, precisions: Floats) -> Floats:
    """(N,) heights of the components, the largest 1, so that sums stay finite."""
    peaks, highest = np.empty(log_weights.shape[0]), -np.inf
    previous, log_density = 1.0, 0.0
    for n in range(log_weights.shape[0]):
        density = 1.0
        for k in range(precisions.shape[1]):
            density *= precisions[n, k]
        if density != previous:  # often all are equal, and a logarithm is expensive
            previous, log_density = density, np.log(density)
        peaks[n] = log_weights[n] + log_density
        highest = max(highest, peaks[n])
    for n in range(peaks.shape[0]):
        peaks[n] = np.exp(peaks[n] - highest)
    return peaks


@compiled
def _moments(peaks: Floats, total: float, means: Floats, precisions: Floats) -> tuple[Floats, Floats]:
    """(K,) mean and variance of the components, each counted by its peak; `total` is their sum."""
    size = means.shape[1]
    centre, spread = np.zeros(size), np.zeros(size)
    for n in range(means.shape[0]):
        share = peaks[n] / total
        for k in range(size):
            centre[k] += share * means[n, k]
    for n in range(means.shape[0]):
        share = peaks[n] / total
        for k in range(size):
            deviation = means[n, k] - centre[k]
            spread[k] += share * (deviation * deviation + 1.0 / (precisions[n, k] * precisions[n, k]))
    return centre, spread


@compiled
def _likely(log_factors: Floats, points: Floats, centre: Floats, spread: Floats) -> int:
    """The winner if the mixture were one Gaussian."""
    guess, highest = 0, -np.inf
    half = 0.5 / spread
    for m in range(points.shape[0]):
        value = log_factors[m]
        for k in range(points.shape[1]):
            deviation = points[m, k] - centre[k]
            value -= half[k] * deviation * deviation
        if value > highest:
            guess, highest = m, value
    return guess


@compiled
def _cell(value: float, low: float, scale: float) -> int:
    return int(min(max((value - low) * scale, 0.0), _CELLS - 1.0))


@compiled
def _in_cells(values: Floats) -> tuple[Ints, Ints, float, float]:
    """The order of values (N,) by cells of equal width; where each cell begins; what `_cell` needs."""
    low, high = values[0], values[0]
    for value in values:
        low, high = min(low, value), max(high, value)
    scale = _CELLS / (high - low) if high - low > 1e-300 else 0.0
    starts, order = np.zeros(_CELLS + 1, np.int64), np.empty(values.shape[0], np.int64)
    for value in values:
        starts[_cell(value, low, scale) + 1] += 1
    for cell in range(_CELLS):
        starts[cell + 1] += starts[cell]
    cursors = starts.copy()
    for n in range(values.shape[0]):
        cell = _cell(values[n], low, scale)
        order[cursors[cell]] = n
        cursors[cell] += 1
    return order, starts, low, scale


@compiled
def _entries(array: Floats, rows: Ints, column: int) -> Floats:
    """(R,) `array[rows, column]`; compiled in a tenth of the time."""
    entries = np.empty(rows.shape[0])
    for n in range(rows.shape[0]):
        entries[n] = array[rows[n], column]
    return entries


@compiled
def _add_some(
    lower: float,
    upper: float,
    points: Floats,
    candidates: Ints,
    peaks: Floats,
    means: Floats,
    precisions: Floats,
    centre: Floats,
    spread: Floats,
    sums: Floats,
) -> tuple[float, float]:
    """Add the components with lower < peak <= upper to the sums of the points `candidates`.

    Returns their sum of peaks, and the largest error of `sums` by rounding coordinates, as a share of it.
    """
    size, axis = points.shape[1], 0
    even = size + size % 2
    some, count = np.empty(peaks.shape[0], np.int64), 0
    for n in range(peaks.shape[0]):
        if lower < peaks[n] <= upper:
            some[count] = n
            count += 1
    rows = np.zeros((even, (candidates.shape[0] + _LANES - 1) // _LANES * _LANES), np.float32)
    mus, scales = np.zeros((count, even), np.float32), np.ones((count, even), np.float32)
    heights, weight, steepest = np.empty(count, np.float32), 0.0, 0.0
    for k in range(size):  # along which they are farthest apart, in standard deviations
        if spread[k] * precisions[0, k] ** 2 > spread[axis] * precisions[0, axis] ** 2:
            axis = k
    if count == 0:
        return 0.0, 0.0
    places, starts, low, scale = _in_cells(_entries(points, candidates, axis))
    order = _in_cells(_entries(means, some[:count], axis))[0]
    extent = np.zeros(size)
    for k in range(size):
        row = rows[k]
        for m in range(candidates.shape[0]):
            deviation = points[candidates[places[m]], k] - centre[k]
            row[m] = deviation
            extent[k] = max(extent[k], abs(deviation))
    spans = np.empty(((count + _GROUP - 1) // _GROUP, 2), np.int64)
    for group in range(spans.shape[0]):
        first, end = np.inf, -np.inf
        for i in range(group * _GROUP, min((group + 1) * _GROUP, count)):
            n = some[order[i]]
            heights[i] = peaks[n]
            weight += peaks[n]
            reach = _REACH / precisions[n, axis]
            first, end = min(first, means[n, axis] - reach), max(end, means[n, axis] + reach)
            for k in range(size):
                deviation = means[n, k] - centre[k]
                mus[i, k], scales[i, k] = deviation, precisions[n, k]
                steepest = max(steepest, (extent[k] + abs(deviation)) * precisions[n, k])
        spans[group, 0] = starts[_cell(first, low, scale)]
        spans[group, 1] = starts[_cell(end, low, scale) + 1]
    partial_sums = np.zeros(rows.shape[1])
    add_sums(rows, heights, mus, scales, spans, partial_sums)
    for m in range(candidates.shape[0]):
        sums[places[m]] += partial_sums[m]
    # A coordinate, its mean and their difference are rounded to 2^-24; the slope of exp(-a^2 / 2) is < .61.
    return weight, 0.61 * 2.0 * 2.0**-24 * size * steepest


@compiled
def likeliest(
    log_factors: Floats, points: Floats, log_weights: Floats, means: Floats, precisions: Floats
) -> int:
    """argmax_m of log_factors_m + log sum_n w_n N(points_m; means_n, 1 / precisions_n^2), the first of equal.

    -1 when all of these are 0 in double precision. All arrays in C order, means and precisions (N, K).
    """
    # Loops, since expressions of arrays take several times as long to compile.
    peaks, total, heavies = _peaks(log_weights, precisions), 0.0, 0
    for peak in peaks:
        total += peak
        heavies += peak > _HEAVY
    centre, spread = _moments(peaks, total, means, precisions)
    guess = _likely(log_factors, points, centre, spread)
    beat = log_factors[guess] + np.log(exact_sum(points[guess], peaks, means, precisions))
    candidates, count = np.empty(log_factors.shape[0], np.int64), 0
    for point in range(log_factors.shape[0]):
        if log_factors[point] + np.log(total) >= beat - _SLACK:
            candidates[count] = point
            count += 1
    candidates, sums = candidates[:count], np.zeros(count)
    remaining, rounding = total, 0.0
    lightest = FAST_ERROR / peaks.shape[0]
    heavy = _HEAVY if 2 * heavies < peaks.shape[0] else lightest
    for lower, upper in ((heavy, 1.0), (lightest, heavy)):
        if count < 2:
            break
        weight, worst = _add_some(
            lower, upper, points, candidates, peaks, means, precisions, centre, spread, sums
        )
        remaining, rounding = max(remaining - weight, 0.0), max(rounding, worst)
        error = total * (FAST_ERROR + rounding)
        for i in range(count):
            beat = max(beat, log_factors[candidates[i]] + np.log(max(sums[i] - error, 0.0)))
        end = 0
        for i in range(count):
            if log_factors[candidates[i]] + np.log(sums[i] + (error + remaining)) >= beat - _SLACK:
                candidates[end], sums[end] = candidates[i], sums[i]
                end += 1
        count = end
        candidates, sums = candidates[:count], sums[:count]
        if count == 1 and sums[0] > error:
            return int(candidates[0])
    highest, winner = -np.inf, -1
    for m in candidates:
        value = log_factors[m] + np.log(exact_sum(points[m], peaks, means, precisions))
        if value > highest:
            highest, winner = value, int(m)
    return winner


def likeliest_of_each(
    log_factors: Floats, points: Floats, log_weights: Floats, means: Floats, precisions: Floats
) -> Ints:
    """(T,) `likeliest` of each of T mixtures: (T, M), (T, M, K), (T, N), (T, N, K), (T, N, K), in C order.

    A loop around the call takes microseconds a target; compiled with it, `likeliest` would exist twice.
    """
    mixtures = zip(log_factors, points, log_weights, means, precisions, strict=True)
    return np.array([likeliest(*mixture) for mixture in mixtures], dtype=np.int64)


def log_gaussians(points: Floats, means: Floats, sds: Floats) -> Floats:
    """(M, N) log N(points_m; means_n, diag sds_n^2) of points (M, K), means (N, K), positive sds (N, K).

    K = 0 gives zeros.
    """
    size = points.shape[1]
    result = np.tile(-np.log(sds).sum(axis=1) - 0.5 * size * np.log(2.0 * np.pi), (len(points), 1))
    for k in range(size):
        result -= 0.5 * ((points[:, k, None] - means[None, :, k]) / sds[None, :, k]) ** 2
    return result


def mixture_log_density(points: Floats, log_weights: Floats, means: Floats, sds: Floats) -> Floats:
    """(M,) log sum_n w_n N(points_m; means_n, diag sds_n^2); O(M N)."""
    return np.asarray(np.logaddexp.reduce(log_gaussians(points, means, sds) + log_weights, axis=1))


def mixture_argmax(
    log_factors: Floats, points: Floats, log_weights: Floats, means: Floats, sds: Floats
) -> int:
    """argmax_m of log_factors_m + `mixture_log_density`_m, the first of equals; exact, seldom O(M N).

    Args:
        log_factors: (M,) finite or -inf.
        points: (M, K).
        log_weights: (N,) -inf for a weight of zero.
        means: (N, K) of the components.
        sds: (N, K), positive.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain

    # One compiled version only: writable and in C order.
    arrays = (log_factors, points, log_weights, means, 1.0 / sds)
    index = int(likeliest(*(plain(array) for array in arrays)))
    if index >= 0:
        return index
    # Every point is so far from every component that all densities are 0 in floating point.
    return int(np.argmax(log_factors + mixture_log_density(points, log_weights, means, sds)))


HALVINGS = 18
"""Of the bracket in which a quantile lies: 4e-6 of its width is left."""


@compiled
def quantiles(points: Floats, sds: Floats, shares: Floats, levels: Floats) -> Floats:
    """(K, L) quantiles of K mixtures of (K, M) points, blurred by each of (S,) `sds` in its share above 0."""
    count, size = points.shape
    values = np.empty((count, len(levels)))
    reach = 9.0 * sds.max()
    for k in range(count):
        lowest, highest = points[k].min() - reach, points[k].max() + reach
        for n in range(len(levels)):
            low, high = lowest, highest
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                mass = 0.0
                for m in range(size):
                    deviation = (middle - points[k, m]) / math.sqrt(2.0)
                    for s in range(len(sds)):
                        mass += shares[s] * 0.5 * math.erfc(-deviation / sds[s])
                if mass < levels[n] * size:
                    low = middle
                else:
                    high = middle
            values[k, n] = 0.5 * (low + high)
    return values


def mixture_quantiles(
    points: ArrayLike, sds: Sequence[float], shares: Sequence[float], levels: ArrayLike
) -> Floats:
    """(K, L) values with (L,) `levels` of the mass below them, for K mixtures.

    A mixture is its (K, M) equally probable points, each blurred by a Gaussian: of sd `sds[s]` with
    probability `shares[s]`. The sds are above 0, the shares sum to 1.

    >>> mixture_quantiles([[0.0]], (1.0, 5.0), (1.0, 0.0), [0.5, 0.975]).round(4).tolist()
    [[-0.0, 1.96]]
    """

    centres = np.ascontiguousarray(np.atleast_2d(np.asarray(points, dtype=np.float64)))
    targets = np.array(levels, dtype=np.float64)
    components = [(sd, share) for sd, share in zip(sds, shares, strict=True) if share > 0.0]
    widths, weights = np.array(components, dtype=np.float64).T.copy()
    return quantiles(centres, widths, weights, targets)
