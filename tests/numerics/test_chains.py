"""Chains of few states: over any time, and in the long run."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.numerics.distributions import Chain

RATES = Chain(((-0.1, 0.1), (0.5, -0.5)), by_rates=True)
MATRIX = Chain(((0.9, 0.1, 0.0), (0.0, 0.8, 0.2), (0.5, 0.0, 0.5)), by_rates=False)


@pytest.mark.parametrize("dt", [0.25, 1.0, 3.7])
def test_two_states_by_rates_are_the_closed_form(dt):
    rest, memory = 0.1 / 0.6, np.exp(-0.6 * dt)
    expected = [[1 - rest * (1 - memory), rest * (1 - memory)], [(1 - rest) * (1 - memory), 0.0]]
    expected[1][1] = 1 - expected[1][0]
    assert RATES.over(dt) == pytest.approx(np.array(expected))


def test_steps_of_rates_follow_each_other():
    assert RATES.over(1.3) @ RATES.over(0.4) == pytest.approx(RATES.over(1.7))


def test_a_matrix_is_raised_to_whole_frames_and_stays_a_matrix_between_them():
    one = np.array(MATRIX.rows)
    assert MATRIX.over(1.0) == pytest.approx(one)
    assert MATRIX.over(3.0) == pytest.approx(one @ one @ one)
    between = MATRIX.over(2.5)
    assert (between >= 0).all() and between.sum(axis=1) == pytest.approx(np.ones(3))


@pytest.mark.parametrize("chain", [RATES, MATRIX])
def test_the_long_run_is_kept_by_a_step(chain):
    shares = chain.stationary()
    assert shares @ chain.over(1.0) == pytest.approx(shares)
    assert shares.sum() == pytest.approx(1.0)


def test_rates_are_the_inverse_of_mean_durations():
    """The mean number of frames until it leaves, of steps of a hundredth of a frame."""
    stay = RATES.over(0.01)[0, 0]
    assert 0.01 / (1 - stay) == pytest.approx(10.0, rel=0.01)
