"""Standard deviations that follow their target: where they come to rest, and what leaves them as they are."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.numerics.distributions import BOUNDS, follow_spread, spread_of, start_spread


def test_factors_come_to_what_the_errors_vary_by():
    rng = np.random.default_rng(1)
    reference = start_spread(2, 5.0)
    seen = []
    for errors in rng.normal(0, [0.5, 12.0], (4000, 2)):
        reference = follow_spread(reference, [errors[:1], errors[1:]], (2.0, 2.0), 5.0)
        seen.append(spread_of(reference, 2))
    # Means of 4000 frames of which some 10 are alike: 3 %, four of them.
    assert np.mean(seen[50:], axis=0) == pytest.approx([0.25, 6.0], rel=0.12)


def test_a_frame_without_errors_changes_nothing():
    reference = {"spread": np.array([0.5, 3.0])}
    after = spread_of(follow_spread(reference, [np.empty(0), np.array([0.0])], (1.0, 1.0), 5.0), 2)
    assert after[0] == 0.5 and after[1] < 3.0


def test_factors_stay_within_bounds():
    low, high = {}, {}
    for _ in range(300):
        low, high = (follow_spread(one, [np.array([e])], (1.0,), 5.0) for one, e in ((low, 0.0), (high, 1e9)))
    assert (spread_of(low, 1)[0], spread_of(high, 1)[0]) == BOUNDS


def test_without_a_memory_nothing_is_remembered():
    assert start_spread(2, None) == {} and follow_spread({}, [np.ones(3)], (1.0,), None) == {}
    assert spread_of({}, 2).tolist() == [1.0, 1.0]
