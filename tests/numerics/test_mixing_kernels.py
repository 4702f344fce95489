"""Updates by mixtures, and covers, against plain arithmetic."""

import numpy as np
import pytest

from bayesnet_track.numerics.gaussian import linear_update
from bayesnet_track.numerics.kernels.pair_kernels import cover_rows, mix_row, mix_rows

MEAN = np.array([100.0, 80, 30, 60, 2, -1, 0, 0])


def covariance(seed=0):
    root = np.random.default_rng(seed).normal(0, 2, (8, 8))
    return root @ root.T + np.eye(8)


def test_a_mixture_has_the_moments_of_its_kalman_updates():
    boxes = np.array([[104.0, 82, 31, 58], [92, 75, 29, 63]])
    variances = np.array([[4.0, 4, 9, 9], [5, 5, 8, 8]])
    weights, missed, before = np.array([0.6, 0.3]), 0.1, covariance()
    observe = np.eye(8)[:4]
    done = [
        linear_update(MEAN, before, box - MEAN[:4], observe, np.diag(own))
        for box, own in zip(boxes, variances, strict=True)
    ]
    parts = [
        (missed, MEAN, before),
        *((w, one.mean, one.covariance) for w, one in zip(weights, done, strict=True)),
    ]
    expected = sum(w * m for w, m, _ in parts)
    spread = sum(w * (p + np.outer(m - expected, m - expected)) for w, m, p in parts)
    evidence = missed + sum(w * np.exp(one.log_likelihood) for w, one in zip(weights, done, strict=True))
    mean, after = MEAN.copy(), before.copy()
    log = mix_row(mean, after, boxes, variances, weights, missed)
    np.testing.assert_allclose(mean, expected, rtol=1e-9)
    np.testing.assert_allclose(after, spread, rtol=1e-7, atol=1e-8)
    assert log == pytest.approx(np.log(evidence), rel=1e-9)


def test_rows_without_detections_stay_and_do_not_disturb_others():
    mean, before = np.tile(MEAN, (3, 1)), np.stack([covariance(k) for k in range(3)])
    box, variances = np.array([[101.0, 81, 30, 60]]), np.full((1, 4), 4.0)
    alone, own = MEAN.copy(), before[1].copy()
    mix_row(alone, own, box, variances, np.array([0.8]), 0.2)
    after = before.copy()
    mix_rows(mean, after, np.array([0, 0, 1, 1]), box, variances, np.array([0.8]), np.array([1.0, 0.2, 1.0]))
    np.testing.assert_array_equal(mean[[0, 2]], np.tile(MEAN, (2, 1)))
    np.testing.assert_array_equal(after[[0, 2]], before[[0, 2]])
    np.testing.assert_array_equal(mean[1], alone)
    np.testing.assert_array_equal(after[1], own)


def test_cover_is_the_share_that_another_may_hide():
    boxes = np.array([[0.0, 0, 10, 20], [5, 0, 10, 20], [30, 0, 10, 20], [31, 0, 2, 2], [5, 50, 10, 20]])
    existence = np.array([1.0, 0.8, 0.5, 0.9, 1.0])
    order = np.argsort(boxes[:, 0] - boxes[:, 2] / 2)
    cover = cover_rows(boxes, existence, order, 0.5)
    # halves of the first two are shared; a small one lies inside the third, of whose area it is 4 of 200
    np.testing.assert_allclose(cover, [0.8, 1.0, 0.9 * 0.02 / 0.5, 0.5, 0.0])
