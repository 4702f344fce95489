"""What a sample vouches for, against the binomial test that it inverts."""

import math

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st
from scipy import special

from bayesnet_track.numerics.distributions import vouched_share


@given(
    st.floats(0.01, 1.0),
    st.floats(1.0, 1e5),
    st.sampled_from([0.5, 0.9, 0.95, 0.999]),
)
def test_the_vouched_share_turns_the_test(inside, trials, confidence):
    """The lower Clopper-Pearson bound, also between whole numbers: the test grants it and nothing above."""
    found = vouched_share(inside, trials, confidence)
    k = inside * trials
    assert special.betainc(k, trials - k + 1, max(found - 1e-6, 0.0)) <= 1 - confidence
    if found < 1 - 1e-6:
        assert special.betainc(k, trials - k + 1, found + 1e-6) >= 1 - confidence


@example(0.0, 5e-324, 1.0, 1.0)
@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(1.0, 1e4), st.floats(1.0, 1e4))
def test_more_inside_or_more_trials_vouch_for_no_less(inside, other, trials, more):
    low, high = sorted((inside, other))
    assert vouched_share(low, trials, 0.95) <= vouched_share(high, trials, 0.95) + 1e-9
    few, many = sorted((trials, more))
    assert vouched_share(1.0, few, 0.95) <= vouched_share(1.0, many, 0.95) + 1e-9


def test_an_exact_share_vouches_for_itself_and_none_for_nothing():
    assert vouched_share(0.7, math.inf, 0.95) == 0.7
    assert vouched_share(0.0, 50, 0.95) == 0.0
    assert vouched_share(1.0, 28, 0.95) < 0.9 < vouched_share(1.0, 29, 0.95)  # 0.9^29 < 0.05 < 0.9^28


def test_the_error_rate_is_the_one_stated():
    """Of samples of a share just at the level, no more than 5 % are vouched for."""
    rng = np.random.default_rng(3)
    draws = rng.binomial(60, 0.9, 4000)
    vouched = {k: vouched_share(k / 60, 60, 0.95) >= 0.9 for k in np.unique(draws)}
    wrong = np.mean([vouched[k] for k in draws])
    assert wrong <= 0.05 + 4 * math.sqrt(0.05 * 0.95 / 4000)  # four standard errors
    assert wrong > 0.0
