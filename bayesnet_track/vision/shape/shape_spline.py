"""Closed uniform cubic B-splines: fit control points to a closed run of points, and follow the curve."""

from __future__ import annotations

from functools import cache

import numpy as np

from bayesnet_track.numerics.arrays import Floats

CONTROL_POINTS = 40
"""Control points of a silhouette (thesis 3.3)."""


def basis(at: Floats, controls: int) -> Floats:
    """(n, controls) weights of the control points at the curve parameters `at` (n,), each in 0 .. controls.

    Parameter i is the knot at which control point i weighs 4/6 and its two neighbours 1/6. The weights of a
    row sum to 1; the curve is closed, so that parameter `controls` is parameter 0.

    >>> (6 * basis(np.array([2.0]), 5)).round(12).tolist()
    [[0.0, 1.0, 4.0, 1.0, 0.0]]
    """
    knot = np.floor(at).astype(np.int64)
    t = at - knot
    blends = ((1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3)
    weights = np.zeros((len(at), controls))
    rows = np.arange(len(at))
    for offset, blend in enumerate(blends, start=-1):
        np.add.at(weights, (rows, (knot + offset) % controls), blend / 6.0)
    return weights


@cache
def fit_matrix(points: int, controls: int = CONTROL_POINTS) -> Floats:
    """(controls, points): least-squares control points of `points` points evenly spaced in the parameter.

    At least as many points as control points are needed, or the curve is not determined.
    """
    weights = basis(_even_parameters(points, controls), controls)
    matrix = np.asarray(np.linalg.solve(np.einsum("ma,mb->ab", weights, weights), weights.T), np.float64)
    matrix.flags.writeable = False
    return matrix


@cache
def curve_matrix(points: int, controls: int = CONTROL_POINTS) -> Floats:
    """(points, controls): the curve's points at even parameters, from its control points."""
    matrix = basis(_even_parameters(points, controls), controls)
    matrix.flags.writeable = False
    return matrix


def _even_parameters(points: int, controls: int) -> Floats:
    return np.arange(points, dtype=np.float64) * (controls / points)
