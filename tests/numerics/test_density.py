"""Mixtures of Gaussians against sums written out; fast sums within their stated error."""

import numpy as np
import pytest

from bayesnet_track.numerics.density import (
    FAST_ERROR,
    _add_some,
    _likely,
    _moments,
    _peaks,
    add_sums,
    exact_sum,
    log_gaussians,
    mixture_argmax,
    mixture_log_density,
)


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
    count = points.shape[1]
    points = np.pad(points, ((0, 0), (0, -count % 16)))
    sums, spans = np.zeros(points.shape[1]), np.tile([0, count], (-(-len(peaks) // 16), 1))
    singles = (array.astype(np.float32, order="C") for array in (points, peaks, means, precisions))
    add_sums(*singles, spans, sums)
    return sums[:count]


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


@pytest.fixture
def small():
    """Points over two blocks, components over three groups; coordinates that a single holds exactly."""
    rng = np.random.default_rng(3)
    points, means = np.rint(rng.normal(size=(300, 3)) * 16) / 8, np.rint(rng.normal(size=(70, 3)) * 16) / 8
    return points, means, np.exp2(rng.integers(-2, 2, (70, 3)).astype(float)), rng.random(70)


def sums_at(points, means, precisions, peaks):
    away = (points[:, None] - means) * precisions
    return np.exp(-0.5 * np.sum(away**2, axis=2)) @ peaks


def test_sums_over_blocks_and_groups(small):
    points, means, precisions, peaks = small
    exact = sums_at(points, means, precisions, peaks)
    single = [exact_sum(point, peaks, means, precisions) for point in points[::30]]
    np.testing.assert_allclose(single, exact[::30], rtol=1e-12)
    rows = np.vstack([points.T, np.zeros(300)])  # an even number of dimensions
    padded = np.hstack([means, np.zeros((70, 1))]), np.hstack([precisions, np.ones((70, 1))])
    assert np.abs(fast_sums(rows, peaks, *padded) - exact).max() < FAST_ERROR * peaks.sum()


def test_some_components_are_added_for_some_points(small):
    points, means, precisions, peaks = small
    chosen, centre = np.array([3, 7, 50, 200]), np.array([1.0, -2.0, 0.5])
    some = (peaks > 0.25) & (peaks <= 0.75)
    sums = np.full(4, 5.0)
    spread = means.var(axis=0)
    weight, worst = _add_some(0.25, 0.75, points, chosen, peaks, means, precisions, centre, spread, sums)
    assert weight == pytest.approx(peaks[some].sum())
    exact = sums_at(points[chosen], means[some], precisions[some], peaks[some])
    assert np.abs(sums - 5.0 - exact).max() < (FAST_ERROR + worst) * weight
    extent, away = np.abs(points[chosen] - centre).max(axis=0), np.abs(means[some] - centre)
    steepest = ((extent + away) * precisions[some]).max()
    assert worst == pytest.approx(0.61 * 2 * 2.0**-24 * 3 * steepest)


def test_components_far_away_are_left_out_and_none_that_counts():
    rng = np.random.default_rng(1)
    points, means = rng.uniform(-40, 40, (90, 2)) * [1, 0.05], rng.uniform(-40, 40, (333, 2)) * [1, 0.05]
    peaks, precisions = rng.random(333), np.exp(rng.normal(size=(333, 2)) * 0.3)
    chosen = np.flatnonzero(rng.random(90) < 0.8)
    sums = np.zeros(len(chosen))
    weight, worst = _add_some(
        0.0, 1.0, points, chosen, peaks, means, precisions, np.zeros(2), means.var(axis=0), sums
    )
    exact = sums_at(points[chosen], means, precisions, peaks)
    assert np.abs(sums - exact).max() < (FAST_ERROR + worst) * weight
    assert weight == pytest.approx(peaks.sum())
    nobody = _add_some(
        2.0, 3.0, points, chosen, peaks, means, precisions, np.zeros(2), means.var(axis=0), sums
    )
    assert nobody == (0.0, 0.0)


def test_peaks_and_moments_of_the_components(small):
    points, means, precisions, peaks = small
    log_weights = np.log(peaks)
    heights = peaks * precisions.prod(axis=1)
    np.testing.assert_allclose(_peaks(log_weights, precisions), heights / heights.max())
    np.testing.assert_allclose(_peaks(log_weights, np.full((70, 3), 2.0)), peaks / peaks.max())
    centre, spread = _moments(peaks, peaks.sum(), means, precisions)
    share = peaks / peaks.sum()
    np.testing.assert_allclose(centre, share @ means)
    np.testing.assert_allclose(spread, share @ ((means - centre) ** 2 + precisions**-2.0))
    factors = np.linspace(-3, 3, 300)
    value = factors - 0.5 * ((points - centre) ** 2 / spread).sum(axis=1)
    assert _likely(factors, points, centre, spread) == value.argmax()


@pytest.mark.parametrize("spread", [0.0, 1.0, 40.0])
def test_argmax_of_a_few(spread, small):
    points, means, precisions, peaks = small
    for seed in range(4):
        rng = np.random.default_rng(seed)
        factors = spread * rng.normal(size=300)
        exact = factors + np.log(sums_at(points, means, precisions, peaks * precisions.prod(axis=1)))
        assert mixture_argmax(factors, points, np.log(peaks), means, 1 / precisions) == exact.argmax()
        points = points[rng.permutation(300)]
    twice = np.vstack([points, points])
    assert mixture_argmax(np.r_[factors, factors], twice, np.log(peaks), means, 1 / precisions) < 300
    far = mixture_argmax(
        np.zeros(3), np.array([[1e4], [9e3], [2e4]]), np.zeros(1), np.zeros((1, 1)), np.ones((1, 1))
    )
    assert far == 1
