"""The grid's kernels are the sums that their docstrings state."""

import numpy as np
import pytest

from bayesnet_track.numerics.kernels.box_kernels import STRIP, spread_columns, spread_rows, turn


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def test_columns_are_spread_by_the_kernel_of_their_velocity(rng):
    mass, taps, first = rng.random((2, 3, 2, 4)), rng.random((3, 3)), np.array([0, 2, 1])
    before = rng.random((2, 3, 2, 8))
    out = before.copy()
    spread_columns(mass, taps, first, out)
    for b in range(3):
        for t in range(3):
            before[:, b, :, first[b] + t : first[b] + t + 4] += taps[b, t] * mass[:, b]
    np.testing.assert_allclose(out, before, rtol=1e-14)


def test_rows_are_spread_by_the_kernel_of_theirs(rng):
    mass, taps, first = rng.random((3, 2, 4, 2)), rng.random((3, 3)), np.array([0, 2, 1])
    before = rng.random((3, 2, 8, 2))
    out = before.copy()
    spread_rows(mass, taps, first, out)
    for a in range(3):
        for t in range(3):
            before[a, :, first[a] + t : first[a] + t + 4] += taps[a, t] * mass[a]
    np.testing.assert_allclose(out, before, rtol=1e-14)


@pytest.mark.parametrize("places", [3, 2 * STRIP, STRIP + 5])
def test_velocities_are_turned_by_a_matrix_of_each_axis(places, rng):
    mass, down, across = rng.random((2, 3, places)), rng.random((2, 2)), rng.random((3, 3))
    out = np.full(mass.shape, np.nan)
    turn(mass, down, across, out)
    np.testing.assert_allclose(out, np.einsum("ac,bd,cdp->abp", down, across, mass), rtol=1e-13)
