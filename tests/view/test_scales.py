"""Round numbers on scales."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.view.svg import decades, ticks


@given(st.integers(0, 10**6), st.integers(0, 10**6), st.integers(2, 12))
def test_ticks_are_round_inside_and_few(first, more, most):
    found = ticks(first, first + more, most)
    assert len(found) <= most + 1 and all(first <= tick <= first + more for tick in found)
    steps = {after - before for before, after in pairwise(found)}
    assert len(steps) <= 1
    for step in steps:
        assert str(step).rstrip("0") in ("1", "2", "5") and all(tick % step == 0 for tick in found)


@pytest.mark.parametrize(
    ("scale", "expected"),
    [
        ((1.0, 10.0), [1, 2, 5, 10]),
        ((0.3, 0.9), [0.5]),
        ((1.0, 1e4), [1, 10, 100, 1000, 1e4]),  # with 2 and 5 there would be 13
    ],
)
def test_decades(scale, expected):
    assert decades(*scale) == pytest.approx(expected)


def test_more_decades_than_fit_are_thinned():
    assert decades(1.0, 1e20, max_ticks=8) == pytest.approx([10.0**e for e in range(0, 21, 3)])
