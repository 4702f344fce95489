"""Factors: exact against enumeration for every belief, always on, and reported where they make no sense."""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np
import pytest

from bayesnet_track.belief.grid.belief import GridFilter
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.engine.joining import log_prior_factor, log_seen
from bayesnet_track.graph import spec
from bayesnet_track.graph.expressions.evaluate import log_values
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.inference.compile import describe_plan
from bayesnet_track.inference.messages import evaluate, without
from bayesnet_track.journal.events.beliefs import DegenerateBelief
from bayesnet_track.journal.events.faults import FactorFlawed, FlawEnded, MotionFlawed
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.cue import Hypotheses

SIZE = "normal(h, 0.3 * y + 8, 2) * where(x > 40, 1, 0.2)"
WALK = {"random_walk": {"sd_px": {"x": 6, "y": 6}, "sd_log": {"scale": 0.2}}}
START = np.array([50.0, 40.0, 20.0, 20.0])
AGENT = {"parent": "s", "agent": "a"}


def factor(expression, parent="s"):
    return {"parent": parent, "factor": expression}


def plan_of(fakes, nodes, sees=None):
    """A plan with all agents, and an observer for them."""
    sees = {"a": fakes.gaussian(55, 42, 7)} if sees is None else sees
    cues = {name: fakes.Oracle(see) for name, see in sees.items()}
    graph = fakes.graph(nodes, {name: fakes.declare(cue) for name, cue in cues.items()})
    target = graph.targets["plate"]
    return fakes.compile_plan(target, target.agents, cues), partial(fakes.observer, cues)


def boxes_at(xs, y=40.0):
    return np.array([[x, y, 20.0, 20.0] for x in xs])


def asked(fakes, nodes, boxes, sees=None, prior=None):
    """The evidence of hypotheses in these boxes, and the observer."""
    plan, observe = plan_of(fakes, nodes, sees)
    observer = observe()
    prior = LogWeights.uniform(len(boxes)).log if prior is None else prior
    return evaluate(plan, observer, Hypotheses(boxes), prior), observer, plan


def log_of(expression, boxes):
    return log_values(parse(expression), dict(zip("xywh", boxes.T, strict=True)))


@pytest.mark.parametrize(
    "belief", [ParticleFilter(spec.Particles(size=300)), GridFilter(spec.Grid(cell_px=4, cut=0))], ids=type
)
def test_a_posterior_is_prior_times_likelihood_times_factor(fakes, belief):
    plan, observe = plan_of(fakes, {"s": {}, "a": AGENT, "size": factor(SIZE)})
    motion = make_motion(spec.Motion.model_validate(WALK))
    posterior = belief.start(START, motion, observe().stream)
    for index in range(1, 4):
        observer = observe(index=index)
        step = belief.step(posterior, motion, 1.0, partial(evaluate, plan, observer), observer.stream)
        boxes = step.support.boxes
        seen = fakes.gaussian(55, 42, 7)(None, Hypotheses(boxes), None)
        product = np.exp(step.prior.log + seen + log_of(SIZE, boxes))
        weights = step.support.weights.weights
        np.testing.assert_allclose(weights, product / product.sum(), rtol=0, atol=1e-12)
        assert step.log_evidence == pytest.approx(np.log(product.sum()), abs=1e-9)
        posterior = step.posterior


def test_in_a_pool_a_factor_counts_once(fakes):
    nodes = {"s": {"fuse": {"pool": {"a": 3, "b": 1}}}, "a": "s", "b": "s", "f": factor("exp(x / 10)")}
    boxes = boxes_at([30, 50, 70])
    sees = {"a": fakes.gaussian(55, 42, 7), "b": fakes.gaussian(30, 40, 9)}
    evidence, _, _ = asked(fakes, nodes, boxes, sees)
    said = evidence.messages
    expected = 0.75 * said["a"] + 0.25 * said["b"] + boxes[:, 0] / 10
    np.testing.assert_allclose(evidence.log_likelihood, expected, rtol=1e-14)


def test_a_factor_is_always_on_and_no_message_of_an_agent(fakes):
    nodes = {"s": {"fuse": "product"}, "a": "s", "g": {"parent": "s"}, "b": "g", "f": factor("x", "g")}
    boxes = boxes_at([30, 50])
    sees = {"a": fakes.flat(), "b": fakes.flat()}
    plan, observe = plan_of(fakes, nodes, sees)
    evidence = evaluate(plan, observe(), Hypotheses(boxes), np.log([0.5, 0.5]))
    assert set(evidence.messages) == {"a", "b", "g"}
    assert set(evidence.factors) == {"f"}
    left = without(plan, evidence, "b", Hypotheses(boxes), np.log([0.5, 0.5]))
    np.testing.assert_allclose(left["s"], np.log([30, 50]))
    assert "  weigh    f at s: x" in describe_plan(plan)


def test_names_stand_for_state_frame_and_constants(fakes):
    motion = {"constant_velocity": {"sd_px": {"x": 6, "y": 6}}}
    expression = "vx * dt + frame_width / frame_height * pi + y"
    plan, observe = plan_of(fakes, {"s": {"motion": motion}, "a": AGENT, "f": factor(expression)})
    fields = {"vx": np.array([2.0, 3.0]), "vy": np.zeros(2)}
    evidence = evaluate(plan, observe(), Hypotheses(boxes_at([1, 2]), fields), np.log([0.5, 0.5]))
    np.testing.assert_allclose(np.exp(evidence.factors["f"]), fields["vx"] + 1.2 * np.pi + 40)


def test_a_factor_of_a_latent_node_knows_its_parents_state(fakes):
    given = {"sd_px": {"x": 3, "y": 3}}
    nodes = {
        "s": {"fuse": "product"},
        "n": {"parent": "s", "fuse": {"latent": {"given": given}}},
        "a": "n",
        "f": factor("normal(x - parent.x, 2, 1)", "n"),
    }
    boxes = boxes_at([30, 50, 70])
    evidence, _, _ = asked(fakes, nodes, boxes, {"a": fakes.flat()})
    away = evidence.latent["n"].boxes[:, 0] - boxes[:, 0]
    np.testing.assert_allclose(evidence.log_likelihood, -0.5 * (away - 2) ** 2 - 0.5 * np.log(2 * np.pi))


def test_hypotheses_without_a_value_are_impossible(fakes):
    evidence, observer, _ = asked(
        fakes, {"s": {}, "a": AGENT, "f": factor("sqrt(x - 40)")}, boxes_at([30, 50])
    )
    assert evidence.log_likelihood[0] == -np.inf
    assert np.isfinite(evidence.log_likelihood[1])
    flaw = observer.factors.flaws["f"]
    assert (flaw.undefined, flaw.hypotheses, flaw.ignored) == (1, 2, False)


@pytest.mark.parametrize("expression", ["x > 1000", "0 / 0", "-1", "normal(x, 0, -1)"])
def test_a_factor_that_leaves_nothing_possible_is_left_out(fakes, expression):
    boxes = boxes_at([30, 50])
    evidence, observer, _ = asked(fakes, {"s": {}, "a": AGENT, "f": factor(expression)}, boxes)
    np.testing.assert_array_equal(evidence.log_likelihood, evidence.messages["a"])
    assert observer.factors.flaws["f"].ignored
    assert evidence.factors == {}


def test_later_hypotheses_may_all_be_impossible(fakes):
    plan, observe = plan_of(fakes, {"s": {}, "a": AGENT, "f": factor("x < 40")})
    observer, equal = observe(), np.log([0.5, 0.5])
    assert np.isfinite(evaluate(plan, observer, Hypotheses(boxes_at([30, 50])), equal).log_likelihood[0])
    assert np.all(evaluate(plan, observer, Hypotheses(boxes_at([60, 50])), equal).log_likelihood == -np.inf)
    assert observer.factors.flaws == {}


def test_what_is_wrong_with_a_factor_is_written_down_when_it_begins(fakes):
    engine, _ = fakes.engine({"s": {}, "a": AGENT, "f": factor("x > 1000")}, {"a": fakes.flat()})
    outcomes = fakes.play(engine, 3)
    events = [event for outcome in outcomes for event in outcome.events]
    assert [type(event) for event in events if event.frame > 0] == [FactorFlawed]
    assert not [event for event in events if isinstance(event, DegenerateBelief)]
    assert (events[-1].frame, events[-1].node, events[-1].ignored) == (1, "f", True)


def test_and_when_it_ends(fakes):
    motion = {"expressions": {"fields": {"vx": {}}, "drift": {"vx": "vx + dt"}, "sd": {"x": 3, "y": 3}}}
    nodes = {"s": {"motion": motion}, "a": AGENT, "f": factor("vx > 2.5")}
    engine, _ = fakes.engine(nodes, {"a": fakes.flat()})
    events = [event for outcome in fakes.play(engine, 5) for event in outcome.events if event.frame > 0]
    assert [(type(event), event.frame) for event in events] == [(FactorFlawed, 1), (FlawEnded, 3)]
    assert events[-1].what == "f"


def test_a_motion_without_a_value_is_written_down_once(fakes):
    motion = {"expressions": {"drift": {"x": "x + log(40 - y)"}, "sd": {"x": 3, "y": 3}}}
    engine, _ = fakes.engine({"s": {"motion": motion}, "a": AGENT}, {"a": fakes.gaussian(50, 42, 7)})
    events = [event for outcome in fakes.play(engine, 3) for event in outcome.events if event.frame > 0]
    assert [(type(event), event.frame, event.part) for event in events] == [(MotionFlawed, 1, "drift x")]
    assert events[0].undefined == events[0].hypotheses


@pytest.mark.parametrize("belief", ["particles", "grid", "gaussian"])
def test_a_factor_pulls_every_belief(fakes, belief):
    """Kalman's update is exact for a linear Gaussian factor; the others match it."""
    nodes = {"s": {"belief": belief}, "a": AGENT, "f": factor("normal(x, 60, 4)")}
    engine, _ = fakes.engine(nodes, {"a": fakes.flat()})
    mean = fakes.play(engine, 1)[-1].state.targets["1"].belief.mean
    assert mean[0] == pytest.approx(50 + 10 * 64 / (64 + 16), abs=0.5)


@pytest.mark.parametrize("likelihood", ["samples", "sigma_points"])
def test_a_linear_factor_is_the_kalman_update_of_a_gaussian(fakes, likelihood):
    """Two densities in one factor, below a gate that would refuse them as measurements."""
    belief = {"gaussian": {"gate": 0.9, "likelihood": likelihood}}
    written = "normal(x, 0.5 * y + 60, 4) * normal(w - h, 2 * 1.5, 0.7)"
    nodes = {"s": {"belief": belief}, "a": AGENT, "f": factor(written)}
    free, _ = fakes.engine({"s": {"belief": belief}, "a": AGENT}, {"a": fakes.flat()})
    engine, _ = fakes.engine(nodes, {"a": fakes.flat()})
    predicted = fakes.play(free, 1)[-1].state.targets["1"].belief
    outcome = fakes.play(engine, 1)[-1]
    after = outcome.state.targets["1"].belief
    observe = np.array([[1, -0.5, 0, 0], [0, 0, 1, -1]]) @ np.eye(4, len(after.mean))
    noise, wanted = np.diag([16.0, 0.49]), np.array([60.0, 3.0])
    spread = observe @ predicted.covariance @ observe.T + noise
    gain = predicted.covariance @ observe.T @ np.linalg.inv(spread)
    away = wanted - observe @ predicted.mean
    np.testing.assert_allclose(after.mean, predicted.mean + gain @ away, atol=1e-9)
    exact = predicted.covariance - gain @ observe @ predicted.covariance
    np.testing.assert_allclose(after.covariance, exact, atol=1e-9)


@pytest.fixture
def ramp(tmp_path, monkeypatch):
    """A mask as wide as the fakes' frames, brighter to the right: its file and its gray values."""
    gray = np.round(255 * np.exp(-0.5 * ((np.arange(120) - 60.0) / 16) ** 2)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "ramp.png"), np.tile(gray, (100, 1)))
    monkeypatch.chdir(tmp_path)
    return {"parent": "s", "mask": "ramp.png"}, gray


def test_a_mask_is_a_factor_between_four_pixels(fakes, ramp):
    node, gray = ramp
    evidence, _, _ = asked(fakes, {"s": {}, "a": AGENT, "f": node}, boxes_at([30.0, 50.25]))
    expected = [gray[30] / 255, (0.75 * gray[50] + 0.25 * gray[51]) / 255]
    np.testing.assert_allclose(np.exp(evidence.factors["f"]), expected, rtol=1e-12)


@pytest.mark.parametrize("belief", ["particles", "grid", "gaussian"])
def test_a_mask_pulls_every_belief_as_by_enumeration(fakes, ramp, belief):
    """Prediction N(50, 8^2) times the mask, summed over the columns."""
    node, gray = ramp
    columns = np.arange(120.0)
    weights = np.exp(-0.5 * ((columns - 50) / 8) ** 2) * gray
    exact = columns @ weights / weights.sum()
    assert exact == pytest.approx(52, abs=0.05)
    engine, _ = fakes.engine({"s": {"belief": belief}, "a": AGENT, "f": node}, {"a": fakes.flat()})
    mean = fakes.play(engine, 1)[-1].state.targets["1"].belief.mean
    assert mean[0] == pytest.approx(exact, abs=1.0)  # 500 particles: 8 / sqrt(500) = .36


def test_a_black_mask_is_left_out(fakes, ramp):
    cv2.imwrite("ramp.png", np.zeros((100, 120), np.uint8))
    evidence, observer, _ = asked(fakes, {"s": {}, "a": AGENT, "f": ramp[0]}, boxes_at([30, 50]))
    assert observer.factors.flaws["f"].ignored
    assert evidence.factors == {}


def test_rules_see_no_factor(fakes):
    nodes = {"s": {}, "a": AGENT, "f": factor("normal(x, 52, 4)")}
    engine, _ = fakes.engine(nodes, {"a": fakes.flat()})
    metrics = fakes.play(engine, 2)[-1].metrics[0]
    assert "f" not in metrics.kl
    assert "f" not in metrics.active


def test_what_was_seen_is_told_from_the_prior(fakes):
    """Factors of products up to the root are a part of its prior; those in pools and latent nodes are not."""
    nodes = {
        "s": {"fuse": "product"},
        "a": "s",
        "p": {"parent": "s", "fuse": "pool"},
        "b": "p",
        "c": "p",
        "f": factor("exp(x / 10) * (x > 40)"),
        "g": factor("exp(1)", "p"),
    }
    boxes = boxes_at([30, 50, 70])
    sees = {"a": fakes.gaussian(55, 42, 7), "b": fakes.flat(), "c": fakes.flat()}
    evidence, _, plan = asked(fakes, nodes, boxes, sees)
    assert [one.is_prior for one in plan.factors] == [True, True]
    np.testing.assert_allclose(log_prior_factor(plan.factors, evidence), [-np.inf, 6, 8])
    seen = log_seen(plan.factors, evidence)
    np.testing.assert_allclose(seen[1:], evidence.messages["a"][1:])
    assert seen[0] == -np.inf


def test_a_factor_below_a_node_of_a_pool_counts_by_its_weight(fakes):
    nodes = {
        "s": {"fuse": {"pool": {"a": 1, "n": 3}}},
        "a": "s",
        "n": {"parent": "s"},
        "b": "n",
        "f": factor("exp(x / 10)", "n"),
    }
    evidence, _, plan = asked(fakes, nodes, boxes_at([30, 50]), {"a": fakes.flat(), "b": fakes.flat()})
    assert [one.is_prior for one in plan.factors] == [False]
    np.testing.assert_allclose(evidence.log_likelihood, [0.75 * 3, 0.75 * 5])
    np.testing.assert_array_equal(log_prior_factor(plan.factors, evidence), [0, 0])
