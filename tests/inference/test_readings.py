"""Measurement functions: EKF and UKF against hand-written ones, all beliefs by enumeration."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import cholesky

from bayesnet_track.belief.gaussian.measured import log_message
from bayesnet_track.belief.gaussian.update import take, update_seen
from bayesnet_track.engine.compiled import make_engine
from bayesnet_track.graph.checked import MeasuredAs
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.inference.gaussian_messages import measurement_message
from bayesnet_track.inference.readings import read_as
from bayesnet_track.observation.cue import Hypotheses, Measurement

FIELDS = ("x", "y", "w", "h", "vx", "vy")
MEAN = np.array([70.0, 45.0, 20.0, 20.0, 2.0, -1.0])
AT = np.array([20.0, 90.0])
"""Where the radar stands."""
NOISE = np.diag([3.0, 0.05]) ** 2
FUNCTIONS = MeasuredAs(
    {"range": parse("hypot(x - at_x, y - 90)"), "bearing": parse("atan2(y - 90, x - at_x)")}, {"at_x": 20.0}
)


def covariance():
    rough = np.random.default_rng(3).standard_normal((6, 9)) * [[6], [5], [1], [1], [0.5], [0.5]]
    return rough @ rough.T / 9


def polar(states):
    away = states[:, :2] - AT
    return np.column_stack([np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])])


def measured(fakes, z, functions=FUNCTIONS):
    return read_as(
        Measurement(("range", "bearing"), np.array(z), NOISE), functions, fakes.observer({}).cache.frames
    )


def test_the_extended_update_is_that_of_the_textbook(fakes):
    """With the Jacobian of range and bearing by hand."""
    z = np.array([64.0, -0.8])
    after = update_seen(MEAN, covariance(), FIELDS, measured(fakes, z), is_unscented=False)
    (dx, dy), r = MEAN[:2] - AT, np.hypot(*(MEAN[:2] - AT))
    jacobian = np.zeros((2, 6))
    jacobian[:, :2] = [[dx / r, dy / r], [-dy / r**2, dx / r**2]]
    innovation = z - polar(MEAN[None])[0]
    expected = jacobian @ covariance() @ jacobian.T + NOISE
    gain = covariance() @ jacobian.T @ np.linalg.inv(expected)
    np.testing.assert_allclose(after.mean, MEAN + gain @ innovation, rtol=1e-7)
    np.testing.assert_allclose(after.covariance, (np.eye(6) - gain @ jacobian) @ covariance(), atol=1e-7)
    assert after.d2 == pytest.approx(innovation @ np.linalg.inv(expected) @ innovation, rel=1e-7)


def test_the_unscented_update_is_that_of_the_textbook(fakes):
    """Julier's points at +-sqrt(6) sds along the columns of Cholesky's root, weights 1 / 12."""
    z = np.array([64.0, -0.8])
    after = update_seen(MEAN, covariance(), FIELDS, measured(fakes, z), is_unscented=True)
    away = np.sqrt(6) * cholesky(covariance(), lower=True).T
    points = MEAN + np.concatenate([away, -away])
    seen = polar(points)
    centre = seen.mean(axis=0)
    expected = (seen - centre).T @ (seen - centre) / 12 + NOISE
    gain = (points - MEAN).T @ (seen - centre) / 12 @ np.linalg.inv(expected)
    np.testing.assert_allclose(after.mean, MEAN + gain @ (z - centre), rtol=1e-9)
    np.testing.assert_allclose(after.covariance, covariance() - gain @ expected @ gain.T, atol=1e-9)


def test_a_linear_function_is_the_kalman_update(fakes):
    functions = MeasuredAs({"range": parse("2 * x - y + 3"), "bearing": parse("vx")}, {})
    z = np.array([101.0, 2.2])
    observe = np.array([[2.0, -1, 0, 0, 0, 0], [0, 0, 0, 0, 1, 0]])
    expected = observe @ covariance() @ observe.T + NOISE
    gain = covariance() @ observe.T @ np.linalg.inv(expected)
    exact = MEAN + gain @ (z - observe @ MEAN - [3, 0])
    for is_unscented in (False, True):
        one = measured(fakes, z, functions)
        taken = take(MEAN, covariance(), FIELDS, {"radar": one}, 1.0, is_unscented)
        np.testing.assert_allclose(taken.mean, exact, rtol=1e-8)
        np.testing.assert_allclose(taken.covariance, covariance() - gain @ expected @ gain.T, atol=1e-7)


@pytest.mark.parametrize("is_unscented", [False, True])
def test_angles_are_taken_the_shorter_way_round(fakes, is_unscented):
    """A target left of the radar, at +-180 degrees: the same as one turned by 180 degrees, right of it."""
    narrow = np.diag([4.0, 4.0, 1.0, 1.0, 1.0, 1.0])
    left, right = MEAN.copy(), MEAN.copy()
    left[:2], right[:2] = AT + [-50, 1], AT + [50, -1]
    turned = [
        update_seen(mean, narrow, FIELDS, measured(fakes, [50.0, angle]), is_unscented).mean[:2] - AT
        for mean, angle in ((left, -3.1), (right, np.pi - 3.1))
    ]
    np.testing.assert_allclose(turned[0], -turned[1], atol=1e-6)
    hypotheses = Hypotheses(np.array([[AT[0] - 50, AT[1] + 1, 20, 20]]), {})
    away = measurement_message(measured(fakes, [np.hypot(50, 1), -np.pi + 0.01]), hypotheses)[0]
    assert away == pytest.approx(-0.5 * ((0.01 + np.arctan(1 / 50)) / 0.05) ** 2, rel=1e-6)


def test_a_quantity_without_a_value_is_not_used(fakes):
    functions = MeasuredAs({"range": parse("sqrt(x - 1000)"), "bearing": parse("y")}, {})
    one = measured(fakes, [3.0, 45.0], functions)
    taken = take(MEAN, covariance(), FIELDS, {"radar": one}, 0.99)
    np.testing.assert_array_equal(taken.mean, MEAN)
    assert taken.gated == ()
    hypotheses = Hypotheses(MEAN[None, :4], {"vx": np.zeros(1), "vy": np.zeros(1)})
    assert log_message(one, hypotheses, FIELDS)[0] < -1e100
    assert measurement_message(one, hypotheses)[0] < -1e100


def radar(fakes, measuring, z, root, agent):
    """The engine of a net with one agent, which measures range and bearing."""
    cue = measuring.Measurer(
        lambda hypotheses, weights: Measurement(("range", "bearing"), np.array(z), NOISE)
    )
    declarations = {"a": fakes.declare(cue)}
    return make_engine(fakes.graph({"s": root, "a": agent}, declarations), 0, declarations)


@pytest.mark.parametrize(
    ("belief", "error"),
    [
        ({"particles": {"size": 4000}}, 0.6),
        ({"grid": {"cell_px": 1}}, 0.15),
        ({"gaussian": {"filter": "extended"}}, 0.6),
        ({"gaussian": {"filter": "unscented"}}, 0.6),
    ],
    ids=str,
)
def test_every_belief_has_the_posterior_by_enumeration(fakes, measuring, belief, error):
    """Prediction N((50, 40), 8^2) times the density of the reading, summed over places 0.5 px apart."""
    z = [62.0, -1.15]
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 100, 0.5), np.arange(0, 90, 0.5)))
    away = (polar(np.column_stack([x, y])) - z) / [3.0, 0.05]
    weights = np.exp(-0.5 * (((x - 50) ** 2 + (y - 40) ** 2) / 64 + (away**2).sum(axis=1)))
    exact = np.array([x, y]) @ weights / weights.sum()
    agent = {
        "parent": "s",
        "agent": "a",
        "measures": {"range": "hypot(x - 20, y - 90)", "bearing": "atan2(y - 90, x - 20)"},
    }
    engine = radar(fakes, measuring, z, {"belief": belief}, agent)
    found = fakes.play(engine, 1)[-1].state.targets["1"].belief.mean[:2]
    np.testing.assert_allclose(found, exact, atol=error)
