"""Beliefs that hold the same object, against exact values."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.adapt.lifecycle import belief_overlap, near_pairs
from bayesnet_track.numerics.kernels.box_kernels import pairs_alike


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


@pytest.mark.parametrize("least", [0.0, 0.5])
def test_near_pairs_are_those_of_every_pair_looked_at(least):
    rng = np.random.default_rng(4)
    boxes = rng.uniform([0, 0, 5, 5], [120, 90, 30, 40], (60, 4))
    spreads = rng.uniform(0.0, 60.0, (60, 4))[:, :, None] * np.eye(4)
    sides = np.sqrt(boxes[:, 2] * boxes[:, 3])
    expected = []
    for i in range(60):
        for j in range(i + 1, 60):
            is_near = np.hypot(*(boxes[i] - boxes[j])[:2]) < (sides[i] + sides[j]) / 2
            pair = boxes[i], spreads[i], boxes[j], spreads[j]
            if is_near and (least == 0.0 or belief_overlap(*pair) >= least):
                expected.append((i, j))
    found = list(zip(*(one.tolist() for one in near_pairs(boxes, spreads, least)), strict=True))
    assert found == sorted(found)
    assert set(expected) <= set(found)
    assert least > 0.0 or expected == found
    assert 0 < len(found) < 1770 / 4


def test_no_target_and_several_need_one_compiled_version():
    boxes = np.array([[10.0, 10, 8, 8], [12.0, 10, 8, 8]])
    for count in (0, 2):
        near_pairs(boxes[:count], np.stack([np.eye(4)] * 2)[:count], 0.5)
    assert len(pairs_alike.signatures) <= 1
