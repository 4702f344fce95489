"""Compiled kernels: what sizes detections have, as a Gaussian over the logarithms of width and height."""

from __future__ import annotations

import math

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled


@compiled
def follow_sizes(
    boxes: Floats, mean: Floats, covariance: Floats, held: float, first_variance: float
) -> tuple[Floats, Floats]:
    """Mean (2,) and covariance (2, 2) after boxes (N, 4), from those that rest on `held` detections.

    Where that is none, the covariance is half theirs, half `first_variance`.
    """
    count = boxes.shape[0]
    now, spread, after = np.zeros(2), np.zeros((2, 2)), np.empty((2, 2))
    for n in range(count):
        for k in range(2):
            now[k] += math.log(max(boxes[n, 2 + k], 1.0)) / count
    for n in range(count):
        for i in range(2):
            for k in range(2):
                away = math.log(max(boxes[n, 2 + i], 1.0)) - now[i]
                spread[i, k] += away * (math.log(max(boxes[n, 2 + k], 1.0)) - now[k]) / count
    share = count / (held + count) if held > 0 else 0.5
    for i in range(2):
        for k in range(2):
            before = first_variance if i == k else 0.0
            if held > 0:
                before = covariance[i, k] + share * (now[i] - mean[i]) * (now[k] - mean[k])
            after[i, k] = (1.0 - share) * before + share * spread[i, k]
    for k in range(2):
        now[k] = mean[k] + share * (now[k] - mean[k]) if held > 0 else now[k]
    return now, after


@compiled
def log_size_densities(boxes: Floats, mean: Floats, covariance: Floats, least_variance: float) -> Floats:
    """(N,) log density of the width and height of boxes (N, 4), px^-2; `least_variance` is added."""
    a, b = covariance[0, 0] + least_variance, covariance[0, 1]
    c = covariance[1, 1] + least_variance
    determinant = a * c - b * b
    normal = 0.5 * math.log(determinant) + math.log(2.0 * math.pi)
    found = np.empty(boxes.shape[0])
    for n in range(boxes.shape[0]):
        width, height = math.log(max(boxes[n, 2], 1.0)), math.log(max(boxes[n, 3], 1.0))
        u, v = width - mean[0], height - mean[1]
        d2 = (c * u * u - 2.0 * b * u * v + a * v * v) / determinant
        found[n] = -0.5 * d2 - normal - width - height
    return found
