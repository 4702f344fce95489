"""How a cue goes sharper and comes back: bounds over all episodes, for widths and for exponents."""

import numpy as np
import pytest

from bayesnet_track.numerics.log_weights import MOST_BACK, SHARPER, STEPS, factor_of, relax, sharpen


@pytest.mark.parametrize("step", [0.5, 2.0])
def test_three_steps_in_all_however_many_episodes(step):
    reference = {"other": np.ones(2)}
    for episode in range(3):
        for attempt in range(1, STEPS + 2):
            sharper = sharpen(reference, attempt, step)
            if sharper is None:
                break
            reference = sharper
        assert factor_of(reference) == pytest.approx(step**STEPS), episode
    assert sharpen(reference, 1, step) is None
    np.testing.assert_array_equal(reference["other"], 1.0)


def test_a_step_from_in_between_ends_at_the_bound():
    part = sharpen({SHARPER: np.array(0.2)}, 1, 0.5)
    assert factor_of(part) == 0.125  # 0.1 lies beyond
    assert sharpen({SHARPER: np.array(1.0)}, STEPS + 1, 0.5) is None


def test_an_old_reference_is_as_learnt():
    assert factor_of({}) == 1.0
    assert factor_of(relax({}, {}, 0.5)) == 1.0


@pytest.mark.parametrize(("rate", "share"), [(0.0, 0.0), (0.02, 0.02), (1.0, MOST_BACK)])
def test_it_comes_back_slowly(rate, share):
    back = relax({SHARPER: np.array(4.0), "other": np.ones(2)}, {SHARPER: np.array(1.0)}, rate)
    assert set(back) == {SHARPER} and factor_of(back) == pytest.approx(4.0 - 3.0 * share)
