"""UD, KL, contribution and strength against their definitions, on weighed hypotheses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

NODES = {"root": {"fuse": "product"}, **dict.fromkeys("abc", "root")}
LATENT = {"latent": {"given": {"sd_px": {"x": 6.0, "y": 6.0}}, "draw": "one"}}


def boxes_of(n, seed=0, sd=20.0):
    rng = np.random.default_rng(seed)
    size = rng.uniform(10.0, 30.0, (n, 2))
    return np.hstack([rng.normal(50.0, sd, (n, 2)), size])


def values(log):
    """A likelihood given hypothesis by hypothesis."""
    return lambda planes, hypotheses, reference: np.asarray(log, dtype=np.float64)


def normalised(weights):
    return weights / weights.sum()


def kl(f, g):
    alive = f > 0
    return float(np.sum(f[alive] * np.log(f[alive] / g[alive])))


def random_case(seed, n=40):
    rng = np.random.default_rng(seed)
    return boxes_of(n, seed), np.log(rng.dirichlet(np.full(n, 0.5))), rng.uniform(-4.0, 0.0, (3, n))


def test_ud_is_the_trace_plus_the_squared_bias_of_the_map(weigh):
    boxes, beta, tables = random_case(1)
    step, measures = weigh(NODES, dict(zip("abc", map(values, tables), strict=True)), boxes, beta, best=7)
    w = step.posterior.weights.weights
    mean = w @ boxes
    trace = w @ np.sum((boxes - mean) ** 2, axis=1)
    assert measures.ud_px2["root"] == pytest.approx(trace + np.sum((mean - boxes[7]) ** 2), rel=1e-12)


def test_two_equal_modes_30_px_off(weigh):
    boxes = np.array([[20.0, 0.0, 5.0, 5.0], [80.0, 0.0, 5.0, 5.0]])
    _, measures = weigh({"root": {}, "a": "root"}, {"a": values([0.0, 0.0])}, boxes)
    assert measures.ud_px2["root"] == pytest.approx(1800.0)  # the trace alone is 900


def test_ud_counts_the_fields_that_the_node_names(weigh):
    boxes, beta, tables = random_case(2)
    sees = dict(zip("abc", map(values, tables), strict=True))
    nodes = {**NODES, "root": {"fuse": "product", "ud_fields": ["y", "w"]}}
    step, measures = weigh(nodes, sees, boxes, beta, best=3)
    expected = step.posterior.weights.weights @ np.sum((boxes - boxes[3])[:, [1, 2]] ** 2, axis=1)
    assert measures.ud_px2["root"] == pytest.approx(expected, rel=1e-12)


def test_an_agents_ud_is_about_its_own_maximum_likelihood_hypothesis(weigh):
    boxes, beta, tables = random_case(3)
    _, measures = weigh(NODES, dict(zip("abc", map(values, tables), strict=True)), boxes, beta)
    for agent, log in zip("abc", tables, strict=True):
        alone = normalised(np.exp(beta + log))
        expected = alone @ np.sum((boxes - boxes[np.argmax(log)]) ** 2, axis=1)
        assert measures.agent_ud_px2[agent] == pytest.approx(expected, rel=1e-12)
    assert np.argmax(tables[0]) != np.argmax(beta + tables[0])  # so that the two hypotheses differ here


def test_kl_contribution_and_strength_by_enumeration_with_prior_weights(weigh):
    boxes, beta, tables = random_case(4)
    _, measures = weigh(NODES, dict(zip("abc", map(values, tables), strict=True)), boxes, beta)
    prior, likelihood = np.exp(beta), dict(zip("abc", np.exp(tables), strict=True))
    belief = normalised(prior * likelihood["a"] * likelihood["b"] * likelihood["c"])
    for agent, others in (("a", "bc"), ("b", "ac"), ("c", "ab")):
        alone = normalised(prior * likelihood[agent])
        rest = normalised(prior * likelihood[others[0]] * likelihood[others[1]])
        assert measures.kl[agent] == pytest.approx(kl(belief, alone), rel=1e-9)
        assert measures.contribution[agent] == pytest.approx(kl(belief, rest), rel=1e-9)
        assert measures.strength[agent] == pytest.approx(kl(alone, prior), rel=1e-9)
        without_beta = kl(belief, normalised(likelihood[agent]))
        assert abs(measures.kl[agent] - without_beta) > 0.1 * measures.kl[agent]
    assert set(measures.strength) == set("abc")


def test_a_single_agent_has_no_kl_and_contributes_all(weigh):
    boxes, beta, tables = random_case(5)
    step, measures = weigh(
        NODES, {"a": values(tables[0])} | dict.fromkeys("bc", values(tables[1])), boxes, beta, "a"
    )
    assert measures.kl == {"a": pytest.approx(0.0, abs=1e-12)}
    belief = step.posterior.weights.weights
    assert measures.contribution["a"] == pytest.approx(
        kl(belief, np.exp(beta) / np.exp(beta).sum()), rel=1e-9
    )


def test_duplicates_score_alike(weigh):
    boxes, beta, tables = random_case(6)
    _, measures = weigh(
        NODES, {"a": values(tables[0]), "b": values(tables[0]), "c": values(tables[1])}, boxes, beta
    )
    for index in (measures.kl, measures.contribution, measures.strength, measures.agent_ud_px2):
        assert index["a"] == index["b"] != index["c"]


@given(seed=st.integers(0, 10_000), shift=st.floats(-30.0, 0.0))
def test_a_constant_factor_changes_nothing_but_the_fit(weigh, seed, shift):
    boxes, beta, tables = random_case(seed)
    sees = dict(zip("abc", map(values, tables), strict=True))
    _, before = weigh(NODES, sees, boxes, beta)
    _, after = weigh(NODES, sees | {"b": values(tables[1] + shift)}, boxes, beta)
    for name in ("ud_px2", "agent_ud_px2", "kl", "contribution", "strength"):
        assert getattr(after, name) == pytest.approx(getattr(before, name), rel=1e-8, abs=1e-9), name
    assert after.fit == pytest.approx(before.fit * np.exp(shift / 3), rel=1e-9)


def test_fit_is_the_best_geometric_mean(weigh):
    boxes = boxes_of(3)
    sees = {
        "a": values(np.log([0.9, 0.4, 0.1])),
        "b": values(np.log([0.1, 0.4, 0.8])),
        "c": values([0.0] * 3),
    }
    _, measures = weigh(NODES, sees, boxes, active="ab")
    assert measures.fit == pytest.approx(0.4)
    _, nobody = weigh(NODES, sees, boxes, active="")
    assert nobody.fit == 0.0
    assert nobody.ud_px2.keys() == {"root"} and not nobody.kl and not nobody.agent_ud_px2


def test_an_agent_is_measured_at_its_governor(weigh):
    """Below a pool with rules of its own, KL and contribution are those of the pool's belief."""
    adapt = {"deactivate": {"below": {"ud_px2": 10.0}}}
    nodes = {
        "root": {"fuse": "product"},
        "color": {"parent": "root", "fuse": "pool", "adapt": adapt},
        "a": "color", "b": "color", "c": "root",
    }  # fmt: skip
    boxes, beta, tables = random_case(8)
    _, measures = weigh(nodes, dict(zip("abc", map(values, tables), strict=True)), boxes, beta)
    prior = np.exp(beta)
    color = normalised(prior * np.exp(0.5 * (tables[0] + tables[1])))
    alone = normalised(prior * np.exp(tables[0]))
    assert measures.kl["a"] == pytest.approx(kl(color, alone), rel=1e-9)
    assert measures.contribution["a"] == pytest.approx(
        kl(color, normalised(prior * np.exp(tables[1]))), rel=1e-9
    )
    assert measures.ud_px2["color"] == pytest.approx(
        color @ np.sum((boxes - boxes[np.argmax(color)]) ** 2, axis=1), rel=1e-9
    )
    assert measures.strength["color"] == pytest.approx(kl(color, normalised(prior)), rel=1e-9)


def test_a_node_without_an_active_agent_believes_what_its_parent_does(weigh):
    nodes = {
        "root": {"fuse": "product"},
        "color": {"parent": "root", "fuse": "pool", "ud_fields": ["x"]},
        "hue": {"parent": "color", "fuse": "pool"},
        "a": "color", "b": "hue", "c": "root",
    }  # fmt: skip
    boxes, beta, tables = random_case(9)
    sees = dict(zip("abc", map(values, tables), strict=True))
    step, nobody = weigh(nodes, sees, boxes, beta, "c", best=4)
    assert nobody.ud_px2["hue"] == nobody.ud_px2["root"]
    belief = step.posterior.weights.weights
    assert nobody.ud_px2["color"] == pytest.approx(belief @ (boxes - boxes[4])[:, 0] ** 2, rel=1e-12)
    _, one = weigh(nodes, sees, boxes, beta, "ac")
    color = normalised(np.exp(beta + tables[0]))
    best = boxes[np.argmax(color)]
    assert one.ud_px2["hue"] == pytest.approx(color @ np.sum((boxes - best) ** 2, axis=1), rel=1e-9)


def test_agents_of_a_latent_node_are_measured_on_its_own_hypotheses(weigh, fakes):
    nodes = {"root": {}, "part": {"parent": "root", "fuse": LATENT}, "a": "part"}
    boxes = boxes_of(200)
    step, measures = weigh(nodes, {"a": fakes.gaussian(50.0, 50.0, 10.0)}, boxes)
    own = step.evidence.latent["part"].boxes
    log = step.evidence.messages["a"]
    weights = normalised(np.exp(log))
    about = own[np.argmax(log)]
    expected = weights @ np.sum((own - about) ** 2, axis=1)
    assert measures.agent_ud_px2["a"] == pytest.approx(expected, rel=1e-9)
    assert measures.ud_px2["part"] == pytest.approx(expected, rel=1e-9)
    assert measures.ud_px2["root"] != pytest.approx(expected, rel=1e-3)


def test_evidence_that_rules_everything_out_still_gives_numbers(weigh):
    sees = {"a": values([0.0, -np.inf]), "b": values([-np.inf, 0.0]), "c": values([-1e308, -1e308])}
    step, measures = weigh(NODES, sees, boxes_of(2))
    assert step.degenerate is not None and measures.fit == 0.0
    assert not any(np.isnan(v) for v in [*measures.kl.values(), *measures.contribution.values()])
    assert np.isfinite(measures.ud_px2["root"])
