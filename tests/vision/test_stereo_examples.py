"""Standard deviations from examples: the usual variance without a default, the default without examples."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.vision.stereo_planes import estimate_spread


def one_group(count):
    return np.zeros(count, np.int64)


def test_without_a_default_it_is_the_unbiased_variance():
    features = np.random.default_rng(0).normal(3.0, [0.1, 2.0], (50, 2))
    spread = estimate_spread(features, one_group(50), np.array([9.0, 9.0]), 0.0)
    assert spread.sd == pytest.approx(features.std(axis=0, ddof=1))
    assert spread.freedom == 49


def test_groups_are_taken_about_their_own_means():
    """20,000 examples in groups of 5: 16,000 deviations, sd right to 5 / sqrt(2 * 16,000) = 2.8 %."""
    rng = np.random.default_rng(1)
    groups = np.repeat(np.arange(4000), 5) * 7
    drift = rng.normal(0.0, 50.0, 4000).repeat(5)[:, None]
    true = np.array([0.2, 1.0, 3.0])
    features = drift + rng.normal(0.0, true, (20_000, 3))
    spread = estimate_spread(features, groups, np.ones(3), 0.0)
    assert spread.freedom == 16_000
    assert spread.sd == pytest.approx(true, rel=5 / np.sqrt(2 * 16_000))


@given(st.integers(0, 1000), st.integers(2, 30), st.floats(0.01, 10.0))
def test_it_lies_between_examples_and_default_the_nearer_to_the_default_the_more_that_counts(
    seed, count, default
):
    features = np.random.default_rng(seed).normal(0.0, 1.0, (count, 1))
    spreads = [
        estimate_spread(features, one_group(count), np.array([default]), prior) for prior in (0, 3, 30, 1e12)
    ]
    off = np.abs([spread.sd[0] - default for spread in spreads])
    assert np.all(np.diff(off) <= 1e-9)
    assert spreads[0].sd == pytest.approx(spreads[0].raw)
    assert spreads[-1].sd[0] == pytest.approx(default, rel=1e-4)


@pytest.mark.parametrize("groups", [[], [4], [1, 2, 3]])
def test_a_mean_without_a_deviation_is_refused(groups):
    with pytest.raises(ValueError, match="one group of two at least"):
        estimate_spread(np.zeros((len(groups), 2)), np.array(groups, np.int64), np.ones(2), 10.0)
