"""Angles among expressions."""

import math

import pytest

from bayesnet_track.graph.expressions.distributions import period_of
from bayesnet_track.graph.expressions.parse import parse


@pytest.mark.parametrize(
    ("text", "period"),
    [
        ("atan2(y, x)", 2 * math.pi),
        ("-atan2(y, x)", 2 * math.pi),
        ("atan2(y, x) - heading", 2 * math.pi),
        ("90 - atan2(y, x) * 180 / pi", 360.0),
        ("atan2(y, x) * mils / 2", 6400 / 2),
        ("atan2(y, x) * x", math.inf),
        ("1 / atan2(y, x)", math.inf),
        ("sin(atan2(y, x))", math.inf),
        ("hypot(x, y)", math.inf),
        ("3", math.inf),
    ],
)
def test_after_how_much_a_value_is_the_same_again(text, period):
    assert period_of(parse(text), {"mils": 6400 / (2 * math.pi)}) == pytest.approx(period)
