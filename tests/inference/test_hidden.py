"""What agents say of a hypothesis that is hidden: the background's likelihood, through products and pools."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.belief.motion.modes import FIELD, make_modes
from bayesnet_track.graph import spec
from bayesnet_track.inference.hidden import Sight, evaluate_modes
from bayesnet_track.inference.messages import evaluate, join_messages, without
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.cue import Hypotheses, Measurement

MODES = make_modes(
    {
        "seen": spec.Mode(mean_frames=30),
        "behind": spec.Mode(mean_frames=10, hidden=spec.Hidden(likelihood=0.02, mistaken=0.2, missed=0.3)),
    }
)
SIGHT = Sight(MODES, 320, 240)
HALF = np.array([0.0, 0.0, 1.0, 1.0])


def hypotheses():
    boxes = np.array([[50.0, 40.0, 20.0, 20.0], [80.0, 40.0, 20.0, 20.0]] * 2)
    return Hypotheses(boxes, {FIELD: HALF})


def asked(fakes, fuse, temperature=1.0):
    """Two agents, joined by `fuse`: the evidence of two visible hypotheses and of the same two hidden."""
    nodes = {
        "s": {"fuse": fuse},
        "a": {"parent": "s", "agent": "a"},
        "b": {"parent": "s", "agent": "b", "temperature": temperature},
    }
    sees = {"a": fakes.gaussian(55, 42, 9), "b": fakes.gaussian(60, 40, 30)}
    cues = {name: fakes.Oracle(see) for name, see in sees.items()}
    graph = fakes.graph(nodes, {name: fakes.declare(cue) for name, cue in cues.items()})
    target = graph.targets["plate"]
    plan = fakes.compile_plan(target, target.agents, cues)
    prior = LogWeights.uniform(4).log
    seen = partial(evaluate, plan, fakes.observer(cues))
    return evaluate_modes(plan, SIGHT, seen, hypotheses(), prior), seen(hypotheses(), prior), plan


@pytest.mark.parametrize(("fuse", "power"), [("product", 2.0), ({"pool": "equal"}, 1.0)])
def test_every_agent_says_the_background_of_what_is_hidden(fakes, fuse, power):
    found, seen, _ = asked(fakes, fuse)
    assert found.log_likelihood[:2] == pytest.approx(seen.log_likelihood[:2])
    assert found.log_likelihood[2:] == pytest.approx(power * np.log(0.02))
    assert found.messages["a"][2:] == pytest.approx(np.log(0.02))
    assert found.messages["a"][:2] == pytest.approx(seen.messages["a"][:2])


def test_the_temperature_holds_for_the_background(fakes):
    found, _, _ = asked(fakes, "product", temperature=4.0)
    assert found.log_likelihood[2:] == pytest.approx(np.log(0.02) * (1 + 1 / 4))


def test_what_is_left_without_an_agent_is_left_of_the_background_too(fakes):
    found, _, plan = asked(fakes, "product")
    rest = without(plan, found, "a", hypotheses(), LogWeights.uniform(4).log)
    assert rest[plan.root][2:] == pytest.approx(np.log(0.02))


@pytest.mark.parametrize("form", ["one", "kernel", "grid"])
def test_a_part_that_can_be_seen_is_joined_as_without_modes_and_a_hidden_one_is_the_background(fakes, form):
    held = {"belief": "grid"} if form == "grid" else {}
    draw = {} if form == "grid" else {"draw": form}
    nodes = {
        "s": {"fuse": "product"},
        "k": {"parent": "s", "fuse": {"latent": {"given": {"sd_px": {"x": 4.0, "y": 4.0}}, **draw}}, **held},
        "a": {"parent": "k", "agent": "a"},
        "b": {"parent": "s", "agent": "b"},
    }
    sees = {"a": fakes.gaussian(55, 42, 9), "b": fakes.gaussian(60, 40, 30)}
    cues = {name: fakes.Oracle(see) for name, see in sees.items()}
    graph = fakes.graph(nodes, {name: fakes.declare(cue) for name, cue in cues.items()})
    target = graph.targets["plate"]
    plan, prior = fakes.compile_plan(target, target.agents, cues), LogWeights.uniform(4).log
    assert any(fusion.own == form for fusion in plan.fusions if fusion.kind == "latent")
    found = evaluate_modes(plan, SIGHT, partial(evaluate, plan, fakes.observer(cues)), hypotheses(), prior)
    at = {"a": found.latent["k"], "b": hypotheses()}
    said = {name: see(None, at[name], None) for name, see in sees.items()}
    visible = join_messages(plan, said, {}, found.latent, hypotheses(), prior).messages
    assert found.log_likelihood[:2] == pytest.approx(visible["s"][:2])
    assert found.messages["k"][:2] == pytest.approx(visible["k"][:2])
    assert found.log_likelihood[2:] == pytest.approx(2 * np.log(0.02))


def plan_of_one():
    step = SimpleNamespace(agent="place", at="s", temperature=1.0)
    fusion = SimpleNamespace(
        node="s",
        kind="product",
        own="one",
        weights=lambda present: {c: 1.0 for c in ("place",) if c in present},
    )
    return SimpleNamespace(
        root="s", observations=(step,), fusions=(fusion,), draws=(), factors=(), view=dict().get
    )


def measured(place):
    """An agent that measures: at `place` with sds of 2 and 3 px, or nowhere."""

    def see(hypotheses, prior_log):
        if place is None:
            return Evidence(np.zeros(4), {"place": np.zeros(4)}, measured={"place": None})
        one = Measurement(("x", "y"), np.array(place), np.diag([4.0, 9.0]), floor=0.05)
        log = -0.5 * np.sum(((hypotheses.boxes[:, :2] - place) / [2.0, 3.0]) ** 2, axis=1)
        return Evidence(log, {"place": log}, {}, {}, {"place": one}, np.zeros(4), {"place": one})

    return see


def test_a_measurement_of_what_is_hidden_lies_anywhere_in_the_frame():
    """p(z | hidden) = .2 / (W H); p(z | seen, x) = .7 N(z; x, R) + .3 .2 / (W H); both times 2 pi |R|^1/2."""
    found = evaluate_modes(
        plan_of_one(), SIGHT, measured([52.0, 41.0]), hypotheses(), LogWeights.uniform(4).log
    )
    scale = 2 * np.pi * np.sqrt(36.0)
    hidden = scale * 0.2 / (320 * 240)
    near = np.exp(-0.5 * ((2 / 2) ** 2 + (1 / 3) ** 2))
    assert np.exp(found.log_likelihood[2:]) == pytest.approx(hidden)
    # The agent's floor of .05 gives way to what is said of misses and mistakes.
    assert np.exp(found.log_likelihood[0]) == pytest.approx(0.7 * near + 0.3 * hidden, rel=1e-3)
    assert np.exp(found.log_likelihood[1]) == pytest.approx(0.3 * hidden, rel=0.01)


def test_an_agent_that_sees_nothing_says_that_the_target_is_probably_hidden():
    found = evaluate_modes(plan_of_one(), SIGHT, measured(None), hypotheses(), LogWeights.uniform(4).log)
    assert np.exp(found.log_likelihood) == pytest.approx([0.3, 0.3, 0.8, 0.8])


@pytest.mark.parametrize("place", [None, [52.0, 41.0]])
def test_without_a_mode_that_hides_the_evidence_stays_as_it_is(place):
    """No agent misses a target that can always be seen: log 0 must not be asked for."""
    sight = Sight(
        make_modes({"slow": spec.Mode(mean_frames=30), "fast": spec.Mode(mean_frames=10)}), 320, 240
    )
    prior = LogWeights.uniform(4).log
    found = evaluate_modes(plan_of_one(), sight, measured(place), hypotheses(), prior)
    expected = measured(place)(hypotheses(), prior)
    assert found.messages.keys() == expected.messages.keys()
    np.testing.assert_array_equal(found.log_likelihood, expected.log_likelihood)
