"""Whether a probability is one: reliability, ranking; and fits that make it one. Pure functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bayesnet_track.numerics.arrays import Floats

ON_TARGET, OFF_TARGET = 0.5, 0.1
"""IoU above which a frame is on target, and below which it is off."""

NEWTON_STEPS = 50
SLACKS = np.geomspace(0.002, 0.5, 34)
LOST_SLACKS = np.geomspace(0.05, 20.0, 37)
"""Sds in box sides among which the localization error is chosen: 18 % apart."""
HEAVY_TAIL: Mapping[str, float] = {"weight": 0.2, "factor": 5.0}
"""Of the localization error: errors of different videos, each of an sd of its own, have such a tail."""


def auroc(scores: ArrayLike, positive: ArrayLike) -> float | None:
    """Probability that a positive has a larger score than a negative, ties counted half; None without both.

    >>> auroc([0.1, 0.4, 0.4, 0.9], [False, False, True, True])
    0.875
    """
    values, flags = np.asarray(scores, dtype=np.float64), np.asarray(positive, dtype=bool)
    on, off = np.sort(values[flags]), values[~flags]
    if not len(on) or not len(off):
        return None
    above = len(on) - np.searchsorted(on, off, side="right")
    equal = np.searchsorted(on, off, side="right") - np.searchsorted(on, off, side="left")
    return float((above + 0.5 * equal).mean() / len(on))


def brier(scores: ArrayLike, hits: ArrayLike) -> float:
    """Mean squared difference of probability and outcome; 0.25 for one that always says one half."""
    return float(np.mean((np.asarray(scores, dtype=np.float64) - np.asarray(hits, dtype=np.float64)) ** 2))


@dataclass(frozen=True)
class Bin:
    """Frames with scores in [low, high), the last bin's high included: their mean score, and the truth."""

    low: float
    high: float
    frames: int
    said: float
    was: float


def reliability(scores: ArrayLike, hits: ArrayLike, bins: int = 5) -> tuple[Bin, ...]:
    """What was said against what was, in `bins` equal bins of the score; empty ones are left out."""
    values, flags = np.asarray(scores, dtype=np.float64), np.asarray(hits, dtype=bool)
    edges = np.linspace(0.0, 1.0, bins + 1)
    at = np.clip(np.digitize(values, edges) - 1, 0, bins - 1)
    return tuple(
        Bin(
            float(edges[k]),
            float(edges[k + 1]),
            int(inside.sum()),
            float(values[inside].mean()),
            float(flags[inside].mean()),
        )
        for k in range(bins)
        if (inside := at == k).any()
    )


def longest_run(flags: ArrayLike) -> int:
    """Length of the longest stretch of True.

    >>> longest_run([True, False, True, True])
    2
    """
    steps = np.diff(np.concatenate([[0], np.asarray(flags, dtype=int), [0]]))
    starts, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    return int((ends - starts).max(initial=0))


def fit_logistic(
    features: Mapping[str, ArrayLike],
    hits: ArrayLike,
    weights: ArrayLike,
    signs: Mapping[str, int],
    ridge: float = 0.1,
) -> dict[str, float]:
    """Coefficients and `bias` of a logistic regression with known signs.

    Maximises sum w log p(outcome) - ridge / 2 |coefficients of standardised features|^2 by Newton's method. A
    feature whose coefficient comes out with the wrong sign is left out (coefficient 0), the worst first:
    more evidence cannot mean that the target is lost.

    Args:
        features: name -> (n,) values.
        hits: (n,) outcomes; both kinds occur.
        weights: (n,) of the frames.
        signs: name -> 1 or -1, what a larger value speaks for.
        ridge: precision of the coefficients' Gaussian prior, in the unit of the weights.
    """
    w, y = np.asarray(weights, dtype=np.float64), np.asarray(hits, dtype=np.float64)
    left = list(features)
    while True:
        table = (
            np.array([np.asarray(features[name], dtype=np.float64) for name in left]).reshape(-1, len(y)).T
        )
        means = w @ table / w.sum()
        sds = np.sqrt(w @ (table - means) ** 2 / w.sum()) + 1e-9
        solved = _newton(np.column_stack([np.ones(len(y)), (table - means) / sds]), y, w, ridge)
        wrong = {name: signs[name] * solved[1 + k] for k, name in enumerate(left)}
        if not wrong or min(wrong.values()) >= 0:
            slopes = solved[1:] / sds
            found = {name: float(slope) for name, slope in zip(left, slopes, strict=True)}
            bias = float(solved[0] - slopes @ means)
            return {"bias": bias, **{name: found.get(name, 0.0) for name in features}}
        left.remove(min(wrong, key=lambda name: wrong[name]))


def _newton(table: Floats, y: Floats, w: Floats, ridge: float) -> Floats:
    penalty = np.full(table.shape[1], ridge)
    penalty[0] = 1e-9
    solved = np.zeros(table.shape[1])
    for _ in range(NEWTON_STEPS):
        p = 1.0 / (1.0 + np.exp(-np.clip(table @ solved, -30.0, 30.0)))
        gradient = table.T @ (w * (y - p)) - penalty * solved
        curvature = (table * (w * p * (1.0 - p))[:, None]).T @ table + np.diag(penalty)
        step = np.linalg.solve(curvature, gradient)
        solved = solved + step / max(1.0, float(np.abs(step).max()) / 5.0)
        if np.abs(step).max() < 1e-9:
            break
    return solved


def fit_localization_error(
    offsets: Sequence[ArrayLike], scores: Sequence[ArrayLike], shares: tuple[float, float] = (0.5, 0.9)
) -> tuple[float, float]:
    """The localization error (sd_box, lost_sd_box) with which regions hold as many true centres as they say.

    On target it has the heavy tail `HEAVY_TAIL`, so that both regions can be right where videos differ.
    The pair, on a logarithmic grid, whose coverage of the central 50 % and 90 % regions, averaged over
    videos, is nearest to 50 % and 90 % (sum of squared differences).

    Args:
        offsets: of each video (n, M, 2) true centre less M equally probable centres, in sqrt(w h).
        scores: of each video (n,) probabilities of being on target.
        shares: of the two regions.
    """
    near = [below_on_target(np.asarray(video, dtype=np.float64), SLACKS) for video in offsets]
    far = [blurred_below(np.asarray(video, dtype=np.float64), LOST_SLACKS) for video in offsets]
    held = [np.asarray(p, dtype=np.float64)[:, None] for p in scores]
    best, chosen = np.inf, (float(SLACKS[0]), float(LOST_SLACKS[-1]))
    for a, sd in enumerate(SLACKS):
        for b, lost_sd in enumerate(LOST_SLACKS):
            if lost_sd <= sd:
                continue
            inside = np.array(
                [
                    [np.mean(np.abs(p * n[a] + (1.0 - p) * f[b] - 0.5) <= share / 2.0) for share in shares]
                    for n, f, p in zip(near, far, held, strict=True)
                ]
            )
            miss = float(((inside.mean(axis=0) - shares) ** 2).sum())
            if miss < best:
                best, chosen = miss, (float(sd), float(lost_sd))
    return chosen


def below_on_target(offsets: Floats, sds: Floats) -> Floats:
    """(S, n, 2) mass below the true centre, of the (n, M, 2) points blurred by each sd and its heavy tail."""
    weight, factor = HEAVY_TAIL["weight"], HEAVY_TAIL["factor"]
    return (1.0 - weight) * blurred_below(offsets, sds) + weight * blurred_below(offsets, factor * sds)


def blurred_below(offsets: Floats, sds: Floats) -> Floats:
    """(S, n, 2) mass below the true centre, of the (n, M, 2) points blurred by each sd."""
    from scipy.special import ndtr  # here, because it takes long to import

    return np.array([ndtr(offsets / sd).mean(axis=1) for sd in sds])


@dataclass(frozen=True)
class Levels:
    """Levels of the score, for the statuses."""

    score_below: float
    uncertain_below: float


def fit_levels(scores: ArrayLike, iou: ArrayLike, spared: float = 0.02) -> Levels:
    """Levels that tell on target from off it.

    `uncertain_below` is where the share of frames off target below it exceeds that of frames on target most
    (Youden's index; 0.5 when there is none of one kind); `score_below` leaves only the share `spared` of
    frames on target below it, and lies below the other.
    """
    values, overlaps = np.asarray(scores, dtype=np.float64), np.asarray(iou, dtype=np.float64)
    on, off = np.sort(values[overlaps > ON_TARGET]), np.sort(values[overlaps < OFF_TARGET])
    if not len(on) or not len(off):
        return Levels(0.2, 0.5)
    grid = np.linspace(0.05, 0.95, 91)
    gain = np.searchsorted(off, grid) / len(off) - np.searchsorted(on, grid) / len(on)
    high = float(grid[int(np.argmax(gain))])
    low = min(float(np.quantile(on, spared)), 0.8 * high)
    return Levels(max(low, 0.01), high)
