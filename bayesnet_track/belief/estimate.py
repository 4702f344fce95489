"""One state, a covariance and central regions that stand for a weighted set of hypotheses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.particles import ParticleSet, Step
from bayesnet_track.graph import spec

Floats = NDArray[np.float64]


def estimate(chosen: spec.Estimate | None, posterior: ParticleSet, step: Step) -> Floats:
    """(D,) the state that stands for the belief; the MAP hypothesis when nothing is chosen.

    - `map`: largest posterior density, prior density included.
    - `best`: largest weight.
    - `mean`: weighted mean, which lies between the modes of a bimodal belief.
    - `robust_mean`: weighted mean of the hypotheses whose centres lie within `box` sqrt(w h) of the best,
      in x and in y (tracking chapter, estimators).
    """
    kind = "map" if chosen is None else chosen.kind
    if kind == "map":
        return step.map_state
    weights = posterior.weights.weights
    if kind == "mean":
        return np.asarray(weights @ posterior.states)
    best = np.asarray(posterior.states[int(np.argmax(weights))])
    if kind == "best" or chosen is None or chosen.robust_mean is None:
        return best
    reach = chosen.robust_mean.box * float(np.sqrt(best[2] * best[3]))
    near = np.all(np.abs(posterior.states[:, :2] - best[:2]) <= reach, axis=1)
    return np.asarray(weights[near] @ posterior.states[near] / weights[near].sum())


def covariance(posterior: ParticleSet) -> Floats:
    """(D, D) weighted covariance, sum w (x - mean)(x - mean)'; zeros when one hypothesis holds all weight.

    Without the correction for degrees of freedom, which divides by zero there.
    """
    weights = posterior.weights.weights
    away = posterior.states - weights @ posterior.states
    return np.asarray((away * weights[:, None]).T @ away)


def central_region(posterior: ParticleSet, share: float) -> tuple[float, float, float, float]:
    """x_low, x_high, y_low, y_high in px: the central `share` of the centre's weight on each axis."""
    weights = posterior.weights.weights
    tails = np.array([(1.0 - share) / 2.0, (1.0 + share) / 2.0])
    x_low, x_high = _quantiles(posterior.states[:, 0], weights, tails)
    y_low, y_high = _quantiles(posterior.states[:, 1], weights, tails)
    return x_low, x_high, y_low, y_high


def _quantiles(values: Floats, weights: Floats, shares: Floats) -> tuple[float, ...]:
    """Weighted quantiles: the least value that has at least the share of the weight up to it."""
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    found = np.searchsorted(cumulative, shares * cumulative[-1])
    return tuple(float(q) for q in values[order][found])
