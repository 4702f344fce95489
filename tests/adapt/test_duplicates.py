"""Beliefs that hold the same object, against exact values."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.adapt.duplicates import belief_overlap


def test_overlap_of_beliefs_is_the_integral_of_the_root_of_their_product():
    """Axes are independent here: the product of four integrals over a fine grid."""
    rng = np.random.default_rng(1)
    means = np.array([[50.0, 40, 30, 20], [53.0, 39, 31, 22]])
    variances = rng.uniform(1.0, 9.0, (2, 4))
    box = means.mean(axis=0)
    wide = variances + (0.1 * box[[2, 3, 2, 3]]) ** 2
    exact = 1.0
    for k in range(4):
        x = np.linspace(means[0, k] - 60, means[0, k] + 60, 24001)
        p, q = (
            np.exp(-((x - m[k]) ** 2) / (2 * v[k])) / np.sqrt(2 * np.pi * v[k])
            for m, v in zip(means, wide, strict=True)
        )
        exact *= np.sum(np.sqrt(p * q)) * (x[1] - x[0])
    found = belief_overlap(means[0], np.diag(variances[0]), means[1], np.diag(variances[1]))
    assert found == pytest.approx(exact, rel=1e-9)
