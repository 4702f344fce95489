"""Orthogonal dynamic programming against every possible path."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.vision.kernels.dense_flow_kernels import best_path, odp_pass


def cost_of(costs, path, penalty):
    return sum(costs[i, d] for i, d in enumerate(path)) + penalty * np.abs(np.diff(path)).sum()


@given(st.integers(1, 6), st.integers(1, 4), st.floats(0, 3), st.integers(0, 10_000))
def test_best_path_against_all_paths(length, count, penalty, seed):
    """Every path whose neighbours differ by at most one candidate: at most 4^6."""
    costs = np.random.default_rng(seed).uniform(0, 5, (length, count)).astype(np.float32)
    path = np.zeros(length, np.int64)
    total = best_path(costs, penalty, np.zeros((length, count), np.int8), path)
    allowed = [p for p in product(range(count), repeat=length) if np.all(np.abs(np.diff(p)) <= 1)]
    least = min(cost_of(costs, p, penalty) for p in allowed)
    assert total == pytest.approx(least, abs=1e-4)
    assert cost_of(costs, path, penalty) == pytest.approx(least, abs=1e-4)
    assert np.all(np.abs(np.diff(path)) <= 1)


def signal(seed, length=9):
    return np.random.default_rng(seed).uniform(0, 30, length).astype(np.float32)


@pytest.mark.parametrize("seed", range(4))
def test_a_strip_is_aligned_as_its_signal(seed):
    """All rows alike: the strip is a 1-D signal; its shifts are those of the cheapest of all alignments."""
    one, other = signal(seed), signal(seed + 50)
    other[1:] = 0.7 * one[:-1] + 0.3 * other[1:]  # mostly the same, one pixel further
    source, target = np.tile(one, (3, 1)), np.tile(other, (3, 1))
    along = np.zeros((3, 9), np.float32)
    odp_pass(source, target, along, np.zeros((3, 9), np.float32), 7, 1, 1.0, 1.5)
    columns = np.arange(9)

    def cost(shift):
        there = np.clip(columns + shift.astype(int), 0, 8)
        return (
            np.abs(one - other[there]).sum() + 0.05 * np.abs(shift).sum() + 1.5 * np.abs(np.diff(shift)).sum()
        )

    shifts = [np.array(s) for s in product((-1, 0, 1), repeat=9) if np.all(np.abs(np.diff(s)) <= 1)]
    best = min(shifts, key=cost)
    assert cost(along[0]) == pytest.approx(cost(best), abs=1e-3)
    assert np.array_equal(along[0], best)
    assert np.all(along == along[0])


def test_a_flow_that_fits_stays():
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 30, (12, 20)).astype(np.float32)
    for picture in (image, np.full_like(image, 7.0)):
        along = np.zeros(picture.shape, np.float32)
        odp_pass(picture, picture, along, np.zeros_like(along), 5, 3, 0.5, 0.5)
        assert not along.any()


@pytest.mark.parametrize(("up", "side"), [(0, 2), (2, -3)])
def test_a_shifted_picture(up, side):
    """Rows are compared where `across` says; inside, all of it moves by the shift."""
    rng = np.random.default_rng(1)
    image = rng.uniform(0, 100, (24, 40)).astype(np.float32)
    moved = np.roll(image, (up, side), axis=(0, 1))
    along = np.zeros(image.shape, np.float32)
    odp_pass(image, moved, along, np.full(image.shape, up, np.float32), 7, 4, 1.0, 0.5)
    assert np.all(along[4:-6, 6:-6] == side)
