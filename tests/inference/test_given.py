"""Latent states by expressions: draws and densities against SciPy, messages against quadrature."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, stats

from bayesnet_track.belief.contract import BOX_FIELDS
from bayesnet_track.belief.gaussian.rows import take
from bayesnet_track.graph.checked import Conditional
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.inference.factors import draw_given, linearise_given, log_given
from bayesnet_track.inference.parts import nominal_boxes
from bayesnet_track.journal.events.faults import FlawEnded, MotionFlawed
from bayesnet_track.observation.cue import Hypotheses, Measurement

PARENT = np.array([50.0, 40.0, 20.0, 30.0])


def written(**fields):
    constants = fields.pop("constants", {})
    return Conditional({name: parse(text, draws=True) for name, text in fields.items()}, constants)


def parents(size=4000):
    return Hypotheses(np.tile(PARENT, (size, 1)))


@pytest.mark.parametrize(
    ("text", "exact"),
    [
        ("normal(parent.x + 3, 0.2 * parent.w)", stats.norm(53, 4)),
        ("laplace(parent.x, 5)", stats.laplace(50, 5)),
        ("student_t(parent.x, 2, 3)", stats.t(3, 50, 2)),
        ("uniform(parent.x - 4, parent.x + offset)", stats.uniform(46, 10)),
        ("logistic(parent.x, 3)", stats.logistic(50, 3)),
        ("lognormal(log(parent.x), 0.1)", stats.lognorm(0.1, scale=50)),
        ("gamma(parent.x, 2)", stats.gamma(50, scale=2)),
        ("exponential(parent.x)", stats.expon(scale=50)),
        ("truncated_normal(parent.x, 5, parent.x + 3, parent.x + 9)", stats.truncnorm(0.6, 1.8, 50, 5)),
    ],
)
def test_draws_and_densities_are_those_of_the_distribution(text, exact):
    given = written(x=text, constants={"offset": 6.0})
    boxes = draw_given(given, parents(), np.random.default_rng(5))
    assert stats.kstest(boxes[:, 0], exact.cdf).pvalue > 1e-4
    np.testing.assert_array_equal(boxes[:, 1:], parents().boxes[:, 1:])
    np.testing.assert_allclose(log_given(given, parents(1), boxes[:50]), exact.logpdf(boxes[:50, :1]).T)
    assert draw_given(given, parents(1), None)[0, 0] == pytest.approx(exact.median())


def test_a_field_may_depend_on_those_before_it():
    """y | x and w | x, y: the density is the product, as the chain rule says."""
    given = written(x="normal(parent.x, 5)", y="normal(parent.y + 2 * (x - parent.x), 1)", w="y / 4")
    boxes = draw_given(given, parents(), np.random.default_rng(6))
    covariance = np.cov(boxes[:, :2].T)
    exact = np.array([[25.0, 50.0], [50.0, 101.0]])
    np.testing.assert_allclose(covariance, exact, rtol=5 * np.sqrt(2 / 4000))
    np.testing.assert_allclose(boxes[:, 2], boxes[:, 1] / 4)
    expected = stats.multivariate_normal(PARENT[:2], exact).logpdf(boxes[:9, :2])
    np.testing.assert_allclose(log_given(given, parents(1), boxes[:9])[0], expected)


def test_what_is_not_drawn_agrees_or_is_impossible():
    given = written(x="normal(parent.x, 5)", w="parent.h / 2")
    above = Hypotheses(np.array([PARENT, PARENT + [0, 0, 0, 4]]))
    own = draw_given(given, above, np.random.default_rng(1))
    assert np.isfinite(log_given(given, above, own)).tolist() == [[True, False], [False, True]]


TURNS = {"expressions": {"fields": {"turn": {"sd": 1}}, "sd": {"x": 1, "y": 1, "turn": 0.1}}}


@pytest.mark.parametrize("by", ["place", "angle"])
@pytest.mark.parametrize(("draw", "size", "error"), [("one", 40_000, 0.02), ("kernel", 600, 0.05)])
def test_messages_are_the_integral(asked, fakes, draw, size, error, by):
    """Two places or angles of the parent; Laplace around them; an agent that sees the child at 56."""
    places, beta = np.array([50.0, 62.0]), np.array([0.7, 0.3])
    boxes = np.repeat([[x if by == "place" else 50, 40.0, 20.0, 20.0] for x in places], size // 2, axis=0)
    log = np.repeat(np.log(beta / (size // 2)), size // 2)
    given = {"x": "laplace(parent.x, 4)" if by == "place" else "laplace(parent.x + 12 * cos(parent.turn), 4)"}
    latent = {"parent": "s", "fuse": {"latent": {"given": given, "draw": draw}}}
    fields = {} if by == "place" else {"turn": np.repeat([np.pi / 2, 0.0], size // 2)}
    nodes = {"s": {"motion": TURNS} if fields else {}, "n": latent, "a": "n"}
    _, evidence = asked(nodes, {"a": fakes.gaussian(56, 40, 3)}, boxes, beta=log, fields=fields)
    cells = np.linspace(-50, 160, 40_001)
    likelihood = np.exp(-0.5 * ((cells - 56) / 3) ** 2)
    exact = [integrate.trapezoid(stats.laplace(x, 4).pdf(cells) * likelihood, cells) for x in places]
    said = np.exp(evidence.log_likelihood).reshape(2, -1).mean(axis=1)
    np.testing.assert_allclose(said, exact, atol=error)


def test_where_a_distribution_is_none_the_field_is_the_parents():
    given, flawed = written(x="normal(parent.x, parent.y - 40)", y="normal(parent.y, 0 / 0)"), {}
    above = Hypotheses(np.array([PARENT, PARENT + [0, 9, 0, 0]]))
    boxes = draw_given(given, above, np.random.default_rng(2), flawed)
    np.testing.assert_array_equal(boxes[:, 1], above.boxes[:, 1])
    assert boxes[0, 0] == 50
    assert boxes[1, 0] != 50
    assert {name: (one.states, one.asked) for name, one in flawed.items()} == {"x": (1, 2), "y": (2, 2)}


def test_it_is_written_down_when_it_begins_and_ends(fakes):
    given = {"x": "normal(parent.x, sqrt(parent.x - 1000))"}
    nodes = {"s": {}, "n": {"parent": "s", "fuse": {"latent": {"given": given}}}, "a": "n"}
    engine, _ = fakes.engine(nodes, {"a": fakes.gaussian(50, 42, 7)})
    events = [event for outcome in fakes.play(engine, 3) for event in outcome.events if event.frame > 0]
    assert [(type(event), event.part) for event in events] == [(MotionFlawed, "given n.x")]
    assert "these have the value of the node above" in events[0].describe()
    assert FlawEnded(9, "1", "given n.x").what == "given n.x"


def test_agents_below_learn_at_the_median(fakes):
    given = {
        "x": "laplace(parent.x + parent.w / 4, 5)",
        "y": "uniform(parent.y, parent.y + 8)",
        "h": "parent.h / 2",
    }
    nodes = {"s": {}, "n": {"parent": "s", "fuse": {"latent": {"given": given}}}, "a": "n"}
    target = fakes.graph(nodes, {"a": fakes.declare(fakes.Oracle(fakes.flat()))}).targets["plate"]
    np.testing.assert_allclose(nominal_boxes(target, PARENT, {})["n"], [55, 44, 20, 15])


# ------------------------------------------------------------------------------------ as a Gaussian

SHEARED = {
    "x": "normal(parent.x + 3, 6)",
    "y": "normal(parent.y - 0.39 * parent.h + 0.5 * (x - parent.x), 4)",
    "w": "0.44 * parent.w",
    "h": "normal(0.22 * parent.h, 0.5)",
}
SLOPES = np.array([[1.0, 0, 0, 0], [0, 1, 0, -0.39], [0, 0, 0.44, 0], [0, 0, 0, 0.22]])
NOISE = np.array([[36.0, 18, 0, 0], [18, 9 + 16, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0.25]])


def crowd(n, seed=3):
    spread = np.array([15.0, 15.0, 4.0, 6.0])
    return PARENT + np.random.default_rng(seed).standard_normal((n, 4)) * spread


def test_a_distribution_is_linearised_by_its_slopes():
    own, slopes, noise = linearise_given(written(**SHEARED), PARENT)
    np.testing.assert_allclose(own, [53, 40 - 11.7 + 1.5, 8.8, 6.6])
    np.testing.assert_allclose(slopes, SLOPES, atol=1e-9)
    np.testing.assert_allclose(noise, NOISE, atol=1e-8)
    curved = written(x="normal(sqrt(parent.x * parent.w), 0.1 * parent.h)", y="normal(0 / 0, 1)")
    own, slopes, noise = linearise_given(curved, PARENT)
    np.testing.assert_allclose(own[:2], [np.sqrt(1000), 40])
    np.testing.assert_allclose(slopes[0], [20 / 2 / np.sqrt(1000), 0, 50 / 2 / np.sqrt(1000), 0], rtol=1e-6)
    np.testing.assert_allclose(noise, np.diag([9.0, 0, 0, 0]))


def gaussian_nodes(given):
    latent = {"parent": "s", "belief": "gaussian", "fuse": {"latent": {"given": given}}}
    return {"s": {}, "n": latent, "m": "n"}


@pytest.mark.parametrize("fields", [("x", "y"), ("x", "y", "w", "h"), ("y",)])
def test_a_gaussian_message_is_the_closed_form(asked, measuring, fields):
    """integral of N(c; A h + b, Q) exp(-d(c)^2 / 2) dc = N(z; B h + b, B Q B' + R), for every h of 400."""
    columns, error = [BOX_FIELDS.index(name) for name in fields], np.diag([9.0, 4, 1, 1][: len(fields)])
    seen = np.array([56.0, 33.0, 9.5, 6.0])[columns]
    boxes = crowd(400)
    one = Measurement(fields, seen, error)
    sees = {"m": measuring.Measurer(lambda *_: one)}
    _, evidence = asked(gaussian_nodes(SHEARED), sees, boxes)
    expected = stats.multivariate_normal(seen, NOISE[np.ix_(columns, columns)] + error)
    middle = np.array([53, 40 - 11.7 + 1.5, 8.8, 6.6]) - SLOPES @ PARENT
    exact = expected.logpdf((boxes @ SLOPES.T + middle)[:, columns])
    apart = evidence.messages["n"] - exact
    np.testing.assert_allclose(apart, apart[0], atol=1e-4)


def test_a_gaussian_belief_is_that_of_the_joint_gaussian(asked, measuring):
    """Root and latent state in one Gaussian, conditioned on a measurement of the latent one."""
    spread, error, seen = np.diag([225.0, 225, 16, 36]), np.diag([9.0, 4.0]), np.array([56.0, 33.0])
    one = Measurement(("x", "y"), seen, error)
    sees = {"m": measuring.Measurer(lambda *_: one)}
    _, evidence = asked(gaussian_nodes(SHEARED), sees, crowd(400))
    after = take(PARENT, spread, BOX_FIELDS, evidence.gaussians, 1 - 1e-9)
    looks = SLOPES[:2]
    gain = spread @ looks.T @ np.linalg.inv(looks @ spread @ looks.T + NOISE[:2, :2] + error)
    predicted = np.array([53, 40 - 11.7 + 1.5])
    np.testing.assert_allclose(after.mean, PARENT + gain @ (seen - predicted), atol=1e-3)
    np.testing.assert_allclose(after.covariance, spread - gain @ looks @ spread, atol=1e-2)


def test_a_gaussian_message_is_about_every_field_that_the_part_depends_on(asked, measuring):
    """A hand 30 px from a shoulder: near angle 0 its y is 30 times the angle, to first order."""
    given = {"x": "normal(parent.x + 30 * cos(parent.turn), 1)", "y": "parent.y + 30 * sin(parent.turn)"}
    nodes = gaussian_nodes(given) | {"s": {"motion": TURNS, "belief": "gaussian"}}
    draws = np.random.default_rng(4).standard_normal((400, 2)) * [3.0, 0.01]
    boxes, turns = np.tile(PARENT, (400, 1)), draws[:, 1] - draws[:, 1].mean()
    boxes[:, 0] += draws[:, 0]
    sees = {"m": measuring.place(84.0, 43.0)}
    _, evidence = asked(nodes, sees, boxes, fields={"turn": turns})
    ((_, message),) = evidence.gaussians.items()
    assert message.fields == ("x", "turn")
    np.testing.assert_allclose(message.mean, [54, 0.1], atol=1e-2)
    np.testing.assert_allclose(np.diag(message.covariance), [9 + 1, 9 / 900], rtol=1e-3)


def test_what_does_not_depend_on_the_parent_says_nothing_of_it(asked, measuring):
    sees = {"m": measuring.place(56.0, 33.0)}
    _, evidence = asked(gaussian_nodes({"x": "normal(70, 5)", "y": "normal(30, 5)"}), sees, crowd(50))
    assert not evidence.gaussians
    np.testing.assert_allclose(evidence.log_likelihood, evidence.log_likelihood[0])
