"""Derivatives of functions at many states at once, and their inverses, followed from a known place."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayesnet_track.numerics.arrays import Floats

Function = Callable[[Floats], Floats]
"""(N, D) states -> (N, K) values."""

Less = Callable[[Floats, Floats], Floats]
"""(N, K) values, those they are compared with -> the differences; of angles the shorter way."""

STEPS, LAST = 12, 6
"""Steps in which a function is followed, and the corrections after the last one."""

CLOSE = 1e-6
"""How near, in units of the errors, the value of an inverse has to be to the one that was asked for."""


def shorter_way(periods: Floats) -> Less:
    """Differences of quantities with these periods (K,), infinite of those that are no angles.

    >>> shorter_way(np.array([np.inf, 360.0]))(np.array([5.0, 350.0]), np.array([3.0, 10.0])).tolist()
    [2.0, -20.0]
    """
    turns = periods < np.inf
    period = np.where(turns, periods, 1.0)

    def less(values: Floats, expected: Floats) -> Floats:
        away = values - expected
        return np.where(turns, (away + period / 2) % period - period / 2, away) if turns.any() else away

    return less


def derivatives(function: Function, states: Floats) -> Floats:
    """(N, K, D) derivatives at states (N, D) by central differences.

    `function` takes (2 D * N, D) states, all N of one step below each other. Steps of eps^(1/3) max(1, |x|).

    >>> derivatives(lambda x: x**2, np.array([[1.0, 3.0]])).round(6).tolist()
    [[[2.0, 0.0], [0.0, 6.0]]]
    """
    count, size = states.shape
    step = np.cbrt(np.finfo(np.float64).eps) * np.maximum(1.0, np.abs(states))
    moved = np.tile(states, (2 * size, 1, 1))
    for k in range(size):
        moved[k, :, k] += step[:, k]
        moved[size + k, :, k] -= step[:, k]
    taken = np.stack([moved[k, :, k] - moved[size + k, :, k] for k in range(size)])
    values = function(moved.reshape(-1, size)).reshape(2 * size, count, -1)
    slopes = (values[:size] - values[size:]) / taken[:, :, None]
    return np.asarray(np.moveaxis(slopes, 0, 2))


def follow(
    function: Function, less: Less, place: Floats, values: Floats, way: Floats, variances: Floats
) -> Floats:
    """(N, D) states at which a function has the `values` (K,) plus the way (N, K); NaN where none is found.

    It is followed along straight ways of values, from the state `place` (D,), at which it has `values`: each
    step is one of Newton's (of Gauss and Newton, weighted by 1 / variances, with more values than fields). So
    the branch of the inverse is that of the place. `function` takes a multiple of N states.
    """
    states = np.tile(place, (len(way), 1))
    for step in range(1, STEPS + 1):
        wanted = values + way * (step / STEPS)
        for _ in range(1 if step < STEPS else LAST):
            states = states + _newton(function, less, states, wanted, variances)[0]
    is_found = _newton(function, less, states, wanted, variances)[1] < CLOSE
    return np.where(is_found[:, None], states, np.nan)


def _newton(
    function: Function, less: Less, states: Floats, wanted: Floats, variances: Floats
) -> tuple[Floats, Floats]:
    """(N, D) the step of Gauss and Newton towards the values wanted (N, K), and (N,) what is left to gain.

    The latter is the largest cosine-weighted error, in sds: 0 where no field can bring the values nearer.
    """
    count, size = states.shape
    step = np.cbrt(np.finfo(np.float64).eps) * np.maximum(1.0, np.abs(states))
    moved = np.tile(states, (2 * size + 1, 1, 1))
    for k in range(size):
        moved[1 + k, :, k] += step[:, k]
        moved[1 + size + k, :, k] -= step[:, k]
    values = function(moved.reshape(-1, size)).reshape(2 * size + 1, count, -1)
    taken = np.stack([moved[1 + k, :, k] - moved[1 + size + k, :, k] for k in range(size)])
    sds = np.sqrt(variances)
    change = less(values[1 : size + 1], values[size + 1 :])
    slopes = np.moveaxis(change / taken[:, :, None], 0, 2) / sds[:, None]
    error = less(wanted, values[0]) / sds
    normal = np.swapaxes(slopes, 1, 2) @ slopes
    scale = np.sqrt(np.diagonal(normal, axis1=1, axis2=2)) + 1e-300
    pull = (np.swapaxes(slopes, 1, 2) @ error[:, :, None])[:, :, 0] / scale
    normal = normal / (scale[:, :, None] * scale[:, None, :])
    usable = np.isfinite(normal).all(axis=(1, 2)) & np.isfinite(pull).all(axis=1)
    normal[~usable] = np.eye(size)
    usable &= np.abs(np.linalg.det(normal)) > 1e-12
    normal[~usable] = np.eye(size)
    towards = np.linalg.solve(normal, pull[:, :, None])[:, :, 0] / scale
    left = np.where(usable, np.abs(pull).max(axis=1), np.inf)
    return np.where(usable[:, None], towards, 0.0), left


def solutions(function: Function, less: Less, values: Floats, variances: Floats) -> Floats:
    """(S, 2) the different states at which a function has `values` (K,), of those found from many starts.

    Steps of Gauss and Newton, halved until they bring the values nearer; starts lie around 0 on circles of
    radii from 0.1 to 100,000.

    >>> line = lambda x: np.stack([np.hypot(x[:, 0], x[:, 1]), x[:, 1]], axis=1)
    >>> solutions(line, shorter_way(np.full(2, np.inf)), np.array([5.0, 3.0]), np.ones(2)).round(6).tolist()
    [[-4.0, 3.0], [4.0, 3.0]]
    """
    turn = 2.0 * np.pi * (np.arange(8) + 0.37) / 8
    circles = 10.0 ** np.arange(-1.0, 5.5, 0.5)
    states = (circles[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)).reshape(-1, 2)
    wanted = np.tile(values, (len(states), 1))

    def distance(at: Floats) -> Floats:
        with np.errstate(all="ignore"):
            away = (less(wanted, function(at)) ** 2 / variances).sum(axis=1)
        return np.where(np.isfinite(away), away, np.inf)

    best = distance(states)
    for _ in range(60):
        with np.errstate(all="ignore"):
            step = _newton(function, less, states, wanted, variances)[0]
        for _ in range(6):
            near = distance(states + step)
            is_nearer = near < best
            states = np.where(is_nearer[:, None], states + step, states)
            best = np.where(is_nearer, near, best)
            step = np.where(is_nearer[:, None], 0.0, step / 2)
    least = float(best.min())
    if not np.isfinite(least) or (len(values) == states.shape[1] and least > CLOSE):
        return np.empty((0, 2))
    found: list[Floats] = []
    for state in states[best <= least + CLOSE]:
        if all(np.abs(state - one).max() > 1e-4 * (1.0 + np.abs(one).max()) for one in found):
            found.append(state)
    return np.array(sorted(one.tolist() for one in found)).reshape(-1, 2)
