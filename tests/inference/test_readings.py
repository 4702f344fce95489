"""Measurement functions: EKF and UKF against hand-written ones, all beliefs by enumeration."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import cholesky

from bayesnet_track.belief.gaussian.belief import log_message
from bayesnet_track.belief.gaussian.rows import take, update_by
from bayesnet_track.belief.motion.modes import mode_probabilities
from bayesnet_track.engine.step import make_engine
from bayesnet_track.graph.checked import MeasuredAs
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.inference.factors import read_as
from bayesnet_track.inference.gaussian_messages import measurement_message
from bayesnet_track.observation.cue import Hypotheses, Measurement

FIELDS = ("x", "y", "w", "h", "vx", "vy")
MEAN = np.array([70.0, 45.0, 20.0, 20.0, 2.0, -1.0])
AT = np.array([20.0, 90.0])
"""Where the radar stands."""
NOISE = np.diag([3.0, 0.05]) ** 2
MEASURES = {"range": "hypot(x - 20, y - 90)", "bearing": "atan2(y - 90, x - 20)"}
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
    after = update_by(MEAN, covariance(), FIELDS, measured(fakes, z), is_unscented=False)
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
    after = update_by(MEAN, covariance(), FIELDS, measured(fakes, z), is_unscented=True)
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
        update_by(mean, narrow, FIELDS, measured(fakes, [50.0, angle]), is_unscented).mean[:2] - AT
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


def radar(fakes, measuring, z, root, above=None):
    """The engine of a net with one agent, which measures range and bearing; of a latent node `above` it."""
    cue = measuring.Measurer(
        lambda hypotheses, weights: Measurement(("range", "bearing"), np.array(z), NOISE)
    )
    declarations = {"a": fakes.declare(cue)}
    agent = {"parent": "n" if above else "s", "agent": "a", "measures": MEASURES}
    nodes = {"s": root, **({"n": {"parent": "s", **above}} if above else {}), "a": agent}
    return make_engine(fakes.graph(nodes, declarations), 0, declarations)


def places(sd):
    """Places (N, 2) 0.5 px apart around (50, 40), and the weight (N,) of each: N((50, 40), sd^2)."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-20, 120, 0.5), np.arange(-20, 88, 0.5)))
    weights = np.exp(-0.5 * ((x - 50) ** 2 + (y - 40) ** 2) / sd**2)
    return np.column_stack([x, y]), weights / weights.sum()


def read(at, z):
    """(N,) exp(-d^2 / 2) of a reading."""
    return np.exp(-0.5 * (((polar(at) - z) / [3.0, 0.05]) ** 2).sum(axis=1))


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
    at, weights = places(8.0)
    weights = weights * read(at, z)
    engine = radar(fakes, measuring, z, {"belief": belief})
    found = fakes.play(engine, 1)[-1].state.targets["1"].belief.mean[:2]
    np.testing.assert_allclose(found, at.T @ weights / weights.sum(), atol=error)


@pytest.mark.parametrize(
    ("form", "belief", "error"),
    [
        ({}, {"particles": {"size": 4000}}, 0.4),
        ({"draw": "one"}, {"particles": {"size": 4000}}, 0.8),
        ({"draw": "kernel"}, {"particles": {"size": 1000}}, 0.8),
        ({"belief": "gaussian"}, {"particles": {"size": 4000}}, 0.8),
        ({"belief": "gaussian"}, {"gaussian": {"filter": "kalman"}}, 0.8),
        ({"given": "expressions"}, {"particles": {"size": 4000}}, 0.8),
        ({"given": "expressions", "belief": "gaussian"}, {"gaussian": {"filter": "kalman"}}, 0.8),
    ],
    ids=str,
)
def test_of_a_node_below_the_root_it_is_read_as_well(fakes, measuring, form, belief, error):
    """The node's own place is N(root's, 5^2); of the root's E[h | z] = E[E[h | c] | z], c summed over."""
    z = [62.0, -1.15]
    at, weights = places(np.sqrt(89.0))
    weights = weights * read(at, z)
    middle = np.array([50.0, 40.0])
    exact = middle + 64 / 89 * (at.T @ weights / weights.sum() - middle)
    given = {"sd_px": {"x": 5.0, "y": 5.0}}
    if form.get("given"):
        given = {"x": "normal(parent.x, 5)", "y": "normal(parent.y, 5)"}
    latent = {"given": given, **{key: form[key] for key in ("draw",) if key in form}}
    above = {"fuse": {"latent": latent}, **{key: form[key] for key in ("belief",) if key in form}}
    engine = radar(fakes, measuring, z, {"belief": belief}, above)
    found = fakes.play(engine, 1)[-1].state.targets["1"].belief.mean[:2]
    np.testing.assert_allclose(found, exact, atol=error)


@pytest.mark.parametrize("z", [[62.0, -1.15], [86.0, -0.6], [62.0, np.pi - 0.3]], ids=str)
@pytest.mark.parametrize(
    "belief",
    [{"particles": {"size": 8000}}, {"gaussian": {"filter": "unscented"}}],
    ids=["particles", "unscented"],
)
def test_a_reading_weighs_seen_against_hidden(fakes, measuring, belief, z):
    """P(hidden) by enumeration: a reading of what is hidden has any range in the frame, and any bearing."""
    modes = {
        "seen": {"next": {"seen": 0.6, "behind": 0.4}},
        "behind": {"next": {"seen": 0.5, "behind": 0.5}, "hidden": {"mistaken": 0.5, "missed": 0.2}},
    }
    at, weights = places(8.0)
    corners = np.array([[column, row] for column in (0, 60, 120) for row in (0, 50, 100)])
    density = 0.5 / (np.ptp(polar(corners)[:, 0]) * 2 * np.pi)
    near = float(weights @ read(at, z)) / (2 * np.pi * 3.0 * 0.05)
    seen, hidden = 0.6 * (0.8 * near + 0.2 * density), 0.4 * density
    engine = radar(fakes, measuring, z, {"belief": {**belief}, "modes": modes})
    belief_after = fakes.play(engine, 1)[-1].state.targets["1"].belief
    found = mode_probabilities(belief_after, 2)[1]
    assert found == pytest.approx(hidden / (seen + hidden), abs=0.03)
