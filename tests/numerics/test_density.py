"""Mixtures of Gaussians against sums written out; fast sums within their stated error."""

import numpy as np
import pytest

from bayesnet_track.numerics.density import log_gaussians, mixture_argmax, mixture_log_density
from bayesnet_track.numerics.density_kernels import FAST_ERROR, add_sums, exact_sum


def test_log_gaussians_written_out():
    points, means, sds = (
        np.array([[1.0, 5.0]]),
        np.array([[0.0, 4.0], [3.0, 5.0]]),
        np.array([[1, 2], [4, 0.5]]),
    )
    expected = [
        -0.5 * (1 + 0.25) - np.log(2 * np.pi * 2),
        -0.5 * (0.25 + 0) - np.log(2 * np.pi * 2),
    ]
    np.testing.assert_allclose(log_gaussians(points, means, sds)[0], expected)
    total = np.log(0.3 * np.exp(expected[0]) + 0.7 * np.exp(expected[1]))
    assert mixture_log_density(points, np.log([0.3, 0.7]), means, sds)[0] == pytest.approx(total)


def fast_sums(points, peaks, means, precisions):
    sums = np.zeros(points.shape[1])
    add_sums(*(array.astype(np.float32, order="C") for array in (points, peaks, means, precisions)), sums)
    return sums


def test_fast_sums_keep_their_error_at_every_distance():
    distances = np.linspace(0, 12, 5001).astype(np.float32)
    points = np.stack([distances, np.zeros(5001)])
    fast = fast_sums(points, np.ones(1), np.zeros((1, 2)), np.ones((1, 2)))
    assert np.abs(fast - np.exp(-0.5 * distances.astype(float) ** 2)).max() < FAST_ERROR


def test_fast_and_exact_sums_agree():
    rng = np.random.default_rng(0)
    points, means = rng.normal(size=(700, 4)) * 2, rng.normal(size=(2000, 4)) * 2
    peaks, precisions = rng.random(2000), np.exp(rng.normal(size=(2000, 4)))
    points, means, precisions = (a.astype(np.float32).astype(float) for a in (points, means, precisions))
    exact = np.array([exact_sum(point, peaks, means, precisions) for point in points])
    away = (points[:, None] - means) * precisions
    np.testing.assert_allclose(exact, np.exp(-0.5 * np.sum(away**2, axis=2)) @ peaks, rtol=1e-11)
    fast = fast_sums(points.T, peaks, means, precisions)
    # Coordinates of up to 9 px, rounded before they are scaled by up to 30, add to the error.
    assert np.abs(fast - exact).max() < (FAST_ERROR + 0.61 * 4 * 2**-23 * 18 * 30) * peaks.sum()


@pytest.mark.parametrize("size", [1, 2, 3, 6])
def test_argmax_with_sds_of_very_different_widths(size):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        points, means = rng.normal(size=(200, size)) * 3, rng.normal(size=(120, size)) * 3
        sds = np.exp(rng.normal(size=(120, size)) * 1.5)
        factors, log_weights = rng.normal(size=200) * rng.choice([0, 1, 50]), rng.normal(size=120) * 5
        expected = int(np.argmax(factors + mixture_log_density(points, log_weights, means, sds)))
        assert mixture_argmax(factors, points, log_weights, means, sds) == expected
