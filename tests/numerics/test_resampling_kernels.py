"""The compiled look-ups give the indices of a search in NumPy's cumulative sums, bit by bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.numerics.resampling import look_up, look_up_even


def searched(weights, positions):
    cumulative = np.cumsum(weights)
    found = np.searchsorted(cumulative / cumulative[-1], positions, side="right")
    return np.minimum(found, np.flatnonzero(weights)[-1]).tolist()


ALMOST = np.nextafter(1.0, 0.0)
weight = st.one_of(st.just(0.0), st.sampled_from([0.1, 0.25, 1.0]), st.floats(0, 1))
some_weights = st.lists(weight, min_size=1, max_size=30).filter(lambda w: sum(w) > 1e-3).map(np.array)
shift = st.one_of(st.sampled_from([0.0, 0.5, ALMOST]), st.floats(0, ALMOST))


@given(some_weights, st.integers(1, 100), shift)
def test_a_comb_is_looked_up_as_numpy_does(weights, count, shift):
    positions = (np.arange(count) + shift) / count
    assert look_up_even(weights, shift, count).tolist() == searched(weights, positions)
    assert look_up(weights, positions).tolist() == searched(weights, positions)


@given(some_weights, st.lists(shift, min_size=2, max_size=60).map(np.array))
def test_so_is_one_position_in_each_interval(weights, shifts):
    positions = (np.arange(len(shifts)) + shifts) / len(shifts)
    assert look_up(weights, positions).tolist() == searched(weights, positions)


@given(some_weights, st.lists(st.floats(0, 1), min_size=1, max_size=60).map(sorted).map(np.array))
def test_so_are_any_ascending_positions(weights, positions):
    assert look_up(weights, positions).tolist() == searched(weights, positions)


@pytest.mark.parametrize("spread", [0.1, 3.0])
def test_so_are_many_weights(spread):
    rng = np.random.default_rng(0)
    weights = np.exp(spread * rng.standard_normal(20_000)) * (rng.random(20_000) < 0.8)
    for count in (20_000, 7, 65_537):
        shift = rng.random()
        positions = (np.arange(count) + shift) / count
        assert look_up_even(weights, shift, count).tolist() == searched(weights, positions)


def test_weights_that_are_no_numbers_are_not_read_past_their_end():
    found = look_up_even(np.array([0.5, np.nan, 0.5]), 0.5, 4)
    assert np.all((found >= 0) & (found < 3))


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 40])
@pytest.mark.parametrize(
    "weights",
    [
        [1.0],
        [0.0, 1.0],
        [1.0, 0.0],
        [0.0, 0.3, 0.0, 0.7, 0.0],
        [0.25] * 4,
        [0.9, 0.05, 0.05],
        [1e-9, 1.0, 1e-9, 3.0],
    ],
)
def test_so_are_few_weights(weights, count):
    rng = np.random.default_rng(count)
    weights = np.array(weights)
    for shift in (0.0, 0.5, ALMOST, rng.random()):
        positions = (np.arange(count) + shift) / count
        assert look_up_even(weights, shift, count).tolist() == searched(weights, positions)
        assert look_up(weights, positions).tolist() == searched(weights, positions)
