"""Evaluating expressions: densities against SciPy, logarithms that do not underflow, what has no value."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from bayesnet_track.graph.expressions.evaluate import LARGEST_LOG, log_values, values_of
from bayesnet_track.graph.expressions.parse import parse

X = np.array([-40.0, -1.0, 0.0, 0.5, 3.0, 100.0])


@pytest.mark.parametrize(
    ("text", "density"),
    [
        ("normal(x, 1, 2)", stats.norm(1, 2)),
        ("laplace(x, 1, 2)", stats.laplace(1, 2)),
        ("student_t(x, 1, 2, 2.5)", stats.t(2.5, 1, 2)),
        ("uniform(x, -2, 4)", stats.uniform(-2, 6)),
        ("logistic(x, 1, 2)", stats.logistic(1, 2)),
        ("lognormal(x, 1, 2)", stats.lognorm(2, scale=math.e)),
        ("gamma(x, 2.5, 3)", stats.gamma(2.5, scale=3)),
        ("gamma(x, 1, 3)", stats.gamma(1, scale=3)),
        ("exponential(x, 3)", stats.expon(scale=3)),
        ("truncated_normal(x, 1, 2, -1, 4)", stats.truncnorm(-1, 1.5, 1, 2)),
        ("truncated_normal(x, -30, 1, 0, 4)", stats.truncnorm(30, 34, -30, 1)),
    ],
)
def test_densities_are_those_of_their_names(text, density):
    np.testing.assert_allclose(log_values(parse(text), {"x": X}), density.logpdf(X), rtol=1e-12)
    np.testing.assert_allclose(values_of(parse(text), {"x": X}), density.pdf(X), rtol=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        "lognormal(x, 0, 0)",
        "gamma(x, -1, 2)",
        "gamma(x, 2, 0)",
        "exponential(x, -1)",
        "truncated_normal(x, 0, 1, 2, 2)",
        "truncated_normal(x, 0, -1, 0, 2)",
        "exponential(x / 0 - x / 0, 1)",
    ],
)
def test_a_distribution_that_is_none_has_no_value(text):
    assert np.isnan(log_values(parse(text), {"x": np.array([-1.0, 0.5])})).all()


def test_students_t_of_many_degrees_is_normal():
    for degrees, close in (("1e5", 1e-5), ("2e6", 1e-6), ("1e300", 1e-12)):
        log = log_values(parse(f"student_t(x, 0, 1, {degrees})"), {"x": 1.5})
        assert log == pytest.approx(stats.norm().logpdf(1.5), abs=close)


@pytest.mark.parametrize(
    ("text", "log"),
    [
        ("normal(x, 0, 1) * normal(y, 0, 1)", -0.5 * (300**2 + 400**2) - math.log(2 * math.pi)),
        ("exp(-3000) ** 2 / exp(-2000)", -4000),
        ("3 * exp(-3000) + exp(-3000)", math.log(4) - 3000),
        ("exp(-3000) - 0.5 * exp(-3000)", math.log(0.5) - 3000),
        ("--exp(-3000)", -3000),
        ("-exp(-3000) * -2", math.log(2) - 3000),
        ("(-exp(-3000)) ** 2", -6000),
        ("exp(-3000) ** 0", 0),
        ("max(exp(-3000), exp(-4000), -exp(9))", -3000),
        ("min(exp(-3000), exp(-4000))", -4000),
        ("max(-exp(-3000), -exp(-4000)) * -1", -4000),
        ("where(x > y, 1, exp(-3000))", -3000),
        ("0.1 + exp(-3000)", math.log(0.1)),
    ],
)
def test_nothing_underflows_far_out(text, log):
    assert log_values(parse(text), {"x": 300.0, "y": 400.0}) == pytest.approx(log, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "log"),
    [
        ("0", -math.inf),
        ("-1", -math.inf),
        ("-exp(1)", -math.inf),
        ("exp(0) - exp(0)", -math.inf),
        ("1 / 0", LARGEST_LOG),
        ("9 ** 9 ** 9", LARGEST_LOG),
        ("exp(1000)", LARGEST_LOG),
        ("exp(800) / exp(100)", 700),
        ("0 / 0", math.nan),
        ("log(-1)", math.nan),
        ("sqrt(-1) * exp(1)", math.nan),
        ("normal(x, 0, 0)", math.nan),
        ("normal(x, 0, -1)", math.nan),
        ("uniform(x, 2, 1)", math.nan),
        ("student_t(x, 0, 1, 0)", math.nan),
        ("(-exp(1)) ** 0.5", math.nan),
        ("min(exp(1), 0 / 0)", math.nan),
        ("max(-exp(1), 0 / 0)", math.nan),
    ],
)
def test_every_value_is_finite_zero_or_none(text, log):
    assert log_values(parse(text), {"x": 1.0}) == pytest.approx(log, nan_ok=True)


@given(data=st.data())
@settings(max_examples=100, deadline=None)
def test_logarithms_are_those_of_the_values(terms, data):
    """Where neither under- nor overflows; nothing warns, and nothing raises."""
    term = data.draw(terms)
    values = {name: np.array([0.5, 2.0, 30.0]) for name in ("x", "y", "w", "h", "parent.x")}
    plain, logs = np.broadcast_arrays(values_of(term, values), log_values(term, values))
    assert not np.any(logs > LARGEST_LOG)
    ordinary = (plain > 1e-6) & (plain < 1e6) & np.isfinite(logs) & (np.abs(logs) < 14)
    np.testing.assert_allclose(np.exp(logs[ordinary]), plain[ordinary], rtol=1e-6)
