"""Factors of pairs: against enumeration of all pairs and triples."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.graph.spec import Join
from bayesnet_track.inference.factors import pair_factor
from bayesnet_track.inference.joint import Edge, Member, joint_marginals
from bayesnet_track.numerics.log_weights import LogWeights

FRAME = {"frame_width": 320.0, "frame_height": 240.0}
SPRING = Join.model_validate({"between": ["s", "t"], "factor": "normal(b.x - a.x, rest, 6)"})


def member(rng, centre, copies):
    """A target on nine places of a line, each `copies` times: more draws of the same discrete belief."""
    x = np.repeat(centre + np.arange(9) * 4.0 - 16.0, copies)
    boxes = np.column_stack([x, np.full((len(x), 1), 50.0), np.full((len(x), 2), 20.0)])
    prior = np.repeat(rng.uniform(0.2, 1.0, 9), copies)
    likelihood = np.repeat(rng.uniform(-5.0, -0.1, 9), copies)
    weights = LogWeights.normalise(np.log(prior))[0]
    states = dict(zip("xywh", boxes.T, strict=True))
    return Member(boxes, weights, likelihood, float(likelihood.mean()), states=states)


def belief(one):
    return one.prior.weights * np.exp(one.log_likelihood)


def marginal_of(one, found):
    weights = one.prior.weights * np.exp(found.log_likelihood)
    return weights / weights.sum()


def places(weights):
    return weights.reshape(9, -1).sum(axis=1) / weights.sum()


def kernel(one, other, rest=40.0):
    gap = other.boxes[None, :, 0] - one.boxes[:, None, 0]
    return np.exp(-0.5 * ((gap - rest) / 6) ** 2)


def keys(pairs):
    return np.array([[ord(speaker[0]), ord(hearer[0])] for speaker, hearer in pairs], np.uint64)


def test_a_spring_between_two_targets():
    rng = np.random.default_rng(3)
    members = {"s": member(rng, 100, 60), "t": member(rng, 150, 60)}
    edge = Edge(("s", "t"), 0.5, pairings=64, factor=pair_factor(SPRING, {"rest": 40.0}, FRAME))
    found, orders = joint_marginals(members, [edge], keys)
    both = belief(members["s"])[:, None] * belief(members["t"]) * kernel(members["s"], members["t"])
    for name, axis in (("s", 1), ("t", 0)):
        exact, own = places(both.sum(axis=axis)), marginal_of(members[name], found[name])
        np.testing.assert_allclose(places(own), exact, atol=0.01)
        assert np.abs(places(belief(members[name])) - exact).max() > 0.05  # the spring matters
        assert set(found[name].hidden.values()) == {0.0}
    assert orders == {("s", "t"): 0.5}


def test_a_chain_of_three_uses_no_evidence_twice():
    rng = np.random.default_rng(4)
    members = {name: member(rng, 100 + 45 * k, 60) for k, name in enumerate("stu")}
    factor = pair_factor(SPRING, {"rest": 40.0}, FRAME)
    edges = [Edge(pair, 0.5, pairings=64, factor=factor) for pair in (("s", "t"), ("t", "u"))]
    found, _ = joint_marginals(members, edges, keys)
    from_s = belief(members["s"]) @ kernel(members["s"], members["t"])
    from_u = kernel(members["t"], members["u"]) @ belief(members["u"])
    exact = places(belief(members["t"]) * from_s * from_u)
    np.testing.assert_allclose(places(marginal_of(members["t"], found["t"])), exact, atol=0.015)


@pytest.mark.parametrize("common", ["1e-300", "1e-200", "exp(400)"])
def test_a_constant_of_all_pairs_changes_nothing_in_a_chain(common):
    """Products of two messages would be 0, or infinite."""
    text = "normal(b.x - a.x, 40, 6)"
    found = []
    for written in (text, f"{common} * {text}"):
        rng = np.random.default_rng(4)
        members = {name: member(rng, 100 + 45 * k, 20) for k, name in enumerate("stu")}
        join = Join.model_validate({"between": ["s", "t"], "factor": written})
        related = pair_factor(join, {}, FRAME)
        edges = [Edge(pair, 0.5, pairings=16, factor=related) for pair in (("s", "t"), ("t", "u"))]
        marginals, _ = joint_marginals(members, edges, keys)
        found.append([marginal_of(members[name], marginals[name]) for name in "stu"])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("text", ["0", "0 / 0", "where(a.x > 1000, 1, 0)"])
def test_a_factor_that_leaves_no_pair_says_nothing(text):
    rng = np.random.default_rng(5)
    members = {"s": member(rng, 100, 60), "t": member(rng, 150, 60)}
    join = Join.model_validate({"between": ["s", "t"], "factor": text})
    edge = Edge(("s", "t"), 0.5, pairings=64, factor=pair_factor(join, {}, FRAME))
    found, _ = joint_marginals(members, [edge], keys)
    own = places(marginal_of(members["s"], found["s"]))
    np.testing.assert_allclose(own, places(belief(members["s"])), atol=0.01)


def test_it_knows_the_frame_and_turns_with_the_edge():
    join = Join.model_validate({"between": ["s", "t"], "factor": "a.x * frame_width + b.y"})
    factor = pair_factor(join, {}, FRAME)
    first, second = {"x": np.array([[2.0, 3.0]])}, {"y": np.array([[1.0], [5.0]])}
    np.testing.assert_allclose(np.exp(factor(first, second)), [[641, 961], [645, 965]])
    turned = Edge(("s", "t"), 0.3, factor=factor).turned
    assert turned.pair == ("t", "s") and turned.first_in_front == 0.7
    np.testing.assert_array_equal(turned.factor(second, first), factor(first, second))
    plain = Join.model_validate({"between": ["s", "t"], "exclusion": {}})
    assert pair_factor(plain, {}, FRAME) is None
    assert Edge(("s", "t"), 0.3).turned.factor is None
