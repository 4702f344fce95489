"""Mass inside a disc: how much of a distribution over the plane lies within a distance of a point."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from bayesnet_track.numerics.arrays import Floats

_REACH = 9.0
"""Sds at which a Gaussian is taken to end: 2e-19 of its mass lies further out."""


def weighted_mass_in_disc(points: Floats, weights: Floats, centre: Floats, radius: float) -> float:
    """Share of the weights (N,), summing to 1, whose points (N, 2) lie within `radius` of `centre`.

    >>> weighted_mass_in_disc(np.array([[0.0, 3], [4, 0]]), np.array([0.25, 0.75]), np.zeros(2), 3.0)
    0.25
    """
    away = points - centre
    inside = np.einsum("nk,nk->n", away, away) <= radius * radius
    return min(float(weights[inside].sum()), 1.0)


def gaussian_mass_in_disc(offset: Floats, covariance: Floats, radius: float) -> float:
    """Mass of N(offset, covariance), (2,) and (2, 2), within `radius` of the origin; error below 1e-9.

    On the principal axes, along the narrower one: the integral of phi(u / s1) / s1 times the normal mass of
    the chord there, with u = radius sin(theta), which takes the root out of the chord's ends.

    >>> round(gaussian_mass_in_disc(np.zeros(2), np.eye(2), 1.0), 9), round(1 - math.exp(-0.5), 9)
    (0.39346934, 0.39346934)
    """
    from scipy.special import ndtr  # here, because it takes long to import

    variances, axes = np.linalg.eigh(covariance)
    (a, b), (s1, s2) = axes.T @ offset, np.sqrt(np.maximum(variances, (1e-9 * radius) ** 2))
    low, high = max(-radius, a - _REACH * s1), min(radius, a + _REACH * s1)
    if low >= high:
        return 0.0
    start, end = math.asin(low / radius), math.asin(high / radius)
    nodes, weights = _gauss_legendre()
    theta = 0.5 * (end - start) * nodes + 0.5 * (end + start)
    u, chord = radius * np.sin(theta), radius * np.cos(theta)
    density = np.exp(-0.5 * ((u - a) / s1) ** 2) / (s1 * math.sqrt(2.0 * math.pi))
    ends = ndtr((chord - b) / s2) - ndtr((-chord - b) / s2)
    return min(max(float(0.5 * (end - start) * np.sum(weights * density * ends * chord)), 0.0), 1.0)


@lru_cache(maxsize=1)
def _gauss_legendre() -> tuple[Floats, Floats]:
    nodes, weights = np.polynomial.legendre.leggauss(160)
    return nodes, weights
