"""KL and UD against sums written out, on asymmetric cases."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from bayesnet_track.numerics.log_weights import (
    LogWeights,
    kl,
    uncertainty_deviation,
)

logs = hnp.arrays(np.float64, st.shared(st.integers(1, 12), key="n"), elements=st.floats(-30, 30))


def normal(log):
    return LogWeights.normalise(log)[0]


def plain_kl(f, g):
    return sum(a * np.log(a / b) for a, b in zip(f, g, strict=True) if a > 0)


@given(logs, logs)
def test_kl_is_the_sum_and_never_negative(a, b):
    f, g = normal(a), normal(b)
    assert kl(f.log, g.log) >= 0
    assert kl(f.log, g.log) == pytest.approx(plain_kl(f.weights, g.weights), rel=1e-9, abs=1e-12)
    assert kl(f.log, f.log) == 0


def test_kl_is_not_symmetric():
    f, g = np.log([0.5, 0.5]), np.log([0.25, 0.75])
    assert kl(f, g) == pytest.approx(0.5 * np.log(2) + 0.5 * np.log(2 / 3))
    assert kl(g, f) == pytest.approx(0.25 * np.log(0.5) + 0.75 * np.log(1.5))


def test_zeros_of_kl():
    with np.errstate(divide="ignore"):
        f, g = np.log([0.5, 0.5, 0.0]), np.log([0.5, 0.0, 0.5])
        assert kl(f, g) == np.inf
        assert kl(f, np.log([0.25, 0.25, 0.5])) == pytest.approx(np.log(2))
    assert kl(np.array([0.0, -2000.0]), np.array([0.0, -np.inf])) == np.inf


def test_two_equal_modes_have_twice_the_trace():
    """Modes at +-30 px, sd 5.5 on the axis: trace 930, and UD = trace + 30^2 about one of the modes."""
    rng = np.random.default_rng(3)
    count = 200_000
    x = np.where(np.arange(count) % 2, 30.0, -30.0) + 5.5 * rng.standard_normal(count)
    states = x[:, None]
    weights = np.full(count, 1 / count)
    ud = uncertainty_deviation(states, weights, np.array([30.0]))
    assert ud == pytest.approx(states.var() + (states.mean() - 30) ** 2, rel=1e-9)
    # sd of the mean of d^2: its own sd is below 1850, over sqrt(200,000) that is 4.2; four of them.
    assert ud == pytest.approx(900 + 900 + 5.5**2, abs=17)


def test_the_published_figure_of_two_modes():
    """UD 1766 against a trace of 860: the mean and MAP are (1766 - 860)^(1/2) = 30.1 px apart."""
    spread = np.sqrt(860.0)
    states = np.array([[-spread, 0.0], [spread, 0.0]])
    ud = uncertainty_deviation(states, np.array([0.5, 0.5]), np.array([np.sqrt(906.0), 0.0]))
    assert ud == pytest.approx(1766)


@given(
    hnp.arrays(np.float64, (7, 3), elements=st.floats(-1e3, 1e3)),
    hnp.arrays(np.float64, 7, elements=st.floats(0.01, 1)),
    hnp.arrays(np.float64, 3, elements=st.floats(-1e3, 1e3)),
)
def test_ud_is_trace_plus_squared_distance_of_mean_and_centre(states, raw, centre):
    weights = raw / raw.sum()
    mean = weights @ states
    trace = np.trace(np.cov(states.T, aweights=weights, ddof=0))
    expected = trace + np.sum((mean - centre) ** 2)
    assert uncertainty_deviation(states, weights, centre) == pytest.approx(expected, rel=1e-9, abs=1e-6)
