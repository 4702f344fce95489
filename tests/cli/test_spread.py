"""Several seeds as one summary: the interval holds the mean as often as it says."""

import numpy as np
import pytest

from bayesnet_track.cli.commands.tracking import seed_spread, spread_over_seeds, spread_text


def test_the_interval_holds_the_true_mean_as_often_as_it_says():
    drawn = np.random.default_rng(11).normal(0.7, 0.05, (2000, 5))
    spreads = [seed_spread(list(map(float, row))) for row in drawn]
    share = np.mean([one.low <= 0.7 <= one.high for one in spreads])
    assert abs(share - 0.95) < 4 * np.sqrt(0.95 * 0.05 / 2000)


def test_one_seed_has_no_interval():
    one = seed_spread([0.5])
    assert (one.mean, one.low, one.high, one.least, one.most) == (0.5, None, None, 0.5, 0.5)
    assert seed_spread([2.0, 2.0, 2.0]).low == 2.0


def test_seeds_are_compared_over_the_videos_that_all_have():
    rows = [
        {"video": "a", "seed": 0, "auc": 0.2, "reason": ""},
        {"video": "b", "seed": 0, "auc": 0.4},
        {"video": "a", "seed": 1, "auc": 0.4},
        {"video": "b", "seed": 1, "auc": 0.6},
        {"video": "c", "seed": 1, "auc": 1.0},
        {"video": "d", "seed": 1, "auc": None},
    ]
    found = spread_over_seeds(rows, ("auc", "mota"))
    assert list(found) == ["auc"]
    assert found["auc"].seeds == 2 and found["auc"].mean == pytest.approx(0.4)
    assert (found["auc"].least, found["auc"].most) == pytest.approx((0.3, 0.5))
    heading, line = spread_text(found).splitlines()
    assert "95 % interval" in heading and line.split()[:2] == ["auc", "0.4"]
