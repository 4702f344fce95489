"""The bandit of information per declared millisecond: regret, repetition, and the rules that go by it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.adapt.memory import InformationRate
from bayesnet_track.adapt.rules import expected_per_ms, remembered_per_ms
from bayesnet_track.graph.spec import Information
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.journal.target_net import TargetNet

AGENTS = ("a", "b", "c")
COSTS = {"a": 1.0, "b": 0.5, "c": 4.0}
SETTINGS = Information(memory_frames=200, exploration=0.1)


def play(gains, rounds, settings_=SETTINGS, seed=0):
    """One agent a round, by the bandit: what was chosen; gains(k) -> agent -> mean nats, noise of sd 0.05."""
    rng = np.random.default_rng(seed)
    worth, chosen = InformationRate(), []
    for k in range(rounds):
        index = expected_per_ms(worth, AGENTS, COSTS, settings_)
        best = max(AGENTS, key=lambda agent: index[agent])
        worth = worth.after({best: gains(k)[best] + 0.05 * rng.standard_normal()}, settings_.memory_frames)
        chosen.append(best)
    return chosen


def regret(chosen, gains):
    """Mean loss per round against the best agent of each round, as a share of what that one gives."""
    worth = [{agent: gains(k)[agent] / COSTS[agent] for agent in AGENTS} for k in range(len(chosen))]
    lost = [max(w.values()) - w[c] for w, c in zip(worth, chosen, strict=True)]
    return sum(lost) / sum(max(w.values()) for w in worth)


def test_it_settles_on_the_best_per_millisecond():
    """c gives most and costs most; b gives most per millisecond. Taking turns would lose 48 %."""

    def gains(k):
        return {"a": 0.3, "b": 0.4, "c": 0.6}

    chosen = play(gains, 1000)
    assert regret([AGENTS[k % 3] for k in range(1000)], gains) == pytest.approx(0.479, abs=1e-3)
    assert regret(chosen, gains) < 0.05
    assert set(chosen[:3]) == set(AGENTS)  # each is tried at first


def test_it_follows_a_change():
    """Best by b, then by a: undiscounted means would need as long again as before to turn."""

    def gains(k):
        return {"a": 0.3, "b": 0.4, "c": 0.6} if k < 1000 else {"a": 0.6, "b": 0.05, "c": 0.1}

    chosen = play(gains, 2000)
    assert regret(chosen[1000:], lambda k: gains(k + 1000)) < 0.15
    assert chosen[1500:].count("a") > 0.9 * 500
    stubborn = play(gains, 2000, Information(memory_frames=1_000_000, exploration=0.0))
    assert regret(stubborn[1000:], lambda k: gains(k + 1000)) > regret(
        chosen[1000:], lambda k: gains(k + 1000)
    )


@given(
    st.lists(st.tuples(st.sampled_from(AGENTS), st.floats(0, 5)), min_size=1, max_size=40), st.integers(1, 99)
)
def test_the_mean_is_the_discounted_one(history, memory):
    worth = InformationRate()
    for agent, nats in history:
        worth = worth.after({agent: nats}, memory)
    ages = np.arange(len(history))[::-1]
    for agent in AGENTS:
        weights = np.exp(-ages / memory) * [name == agent for name, _ in history]
        if weights.sum() == 0:
            assert worth.mean(agent) is None and worth.hope(agent, 0.1) == math.inf
        else:
            assert worth.mean(agent) == pytest.approx(weights @ [v for _, v in history] / weights.sum())
            assert worth.hope(agent, 0.0) == worth.mean(agent)
            assert worth.hope(agent, 0.3) >= worth.hope(agent, 0.1) >= worth.mean(agent)
    assert remembered_per_ms(worth, ["a"], COSTS)["a"] == (worth.mean("a") or 0.0)


def test_time_away_raises_hope():
    worth = InformationRate().after({"a": 0.1, "b": 0.1}, 50)
    later = worth
    for _ in range(100):
        later = later.after({"b": 0.1}, 50)
    assert later.mean("a") == pytest.approx(0.1)
    assert later.hope("a", 0.1) > 3 * worth.hope("a", 0.1) > later.hope("b", 0.1)


# ------------------------------------------------------------------------------------ as rules


def net(which="information_per_ms", drop="min_information_per_ms", **more):
    adapt = {
        "activate": {"above": {"ud_px2": 200.0}, "frames": 2, "which": which},
        "deactivate": {"below": {"ud_px2": 100.0}, "frames": 2, "drop": drop},
        "information": {"memory_frames": 50, "exploration": 0.0},
        **more,
    }
    nodes = {"root": {"fuse": "product", "adapt": adapt, "lost": {"above": {"ud_px2": 1e9}}}}
    return nodes | {agent: {"parent": "root", "agent": agent} for agent in AGENTS}


def test_the_least_is_dropped_and_the_most_called_back_one_at_a_time(drive):
    gives = {"a": 0.9, "b": 0.3, "c": 1.0}
    made = drive(net(), [50] * 4 + [300] * 5, contribution=gives, costs=COSTS)
    off = made.of(Deactivated)
    assert [(d.frame, d.node, d.drop) for d in off] == [
        (2, "c", "min_information_per_ms"),
        (4, "b", "min_information_per_ms"),
    ]
    assert off[0].index == pytest.approx({"a": 0.9, "b": 0.6, "c": 0.25})
    on = made.of(Activated)
    assert [(d.frame, d.node) for d in on] == [(6, "b"), (8, "c")]
    assert on[0].expected == pytest.approx({"b": 0.6, "c": 0.25}) and on[0].helpfulness == pytest.approx(0.3)


def test_one_frame_does_not_decide_what_many_say(drive):
    """a gives much but for the frame of the decision; `min_contribution_per_ms` falls for it."""
    gives = {"a": lambda k: 0.0 if k == 9 else 1.0, "b": 0.2, "c": 4.0}
    nodes = net()
    remembered = drive(nodes, [150] * 8 + [50] * 2, contribution=gives, costs=COSTS)
    assert [d.node for d in remembered.of(Deactivated)] == ["b"]
    nodes = net(drop="min_contribution_per_ms")
    momentary = drive(nodes, [150] * 8 + [50] * 2, contribution=gives, costs=COSTS)
    assert [d.node for d in momentary.of(Deactivated)] == ["a"]


def test_an_agent_never_tried_comes_first_and_all_while_lost(drive):
    made = drive(net(), [300] * 2, active="a", contribution={"a": 1.0}, costs=COSTS)
    (decision,) = made.of(Activated)
    assert decision.node == "b" and decision.helpfulness is None
    assert decision.expected == {"b": math.inf, "c": math.inf}
    lost = TargetNet("plate", frozenset("a"), status="lost")
    nodes = net()
    nodes["root"]["lost"] = {"above": {"ud_px2": 10.0}}
    made = drive(nodes, [300] * 2, net=lost, contribution={"a": 1.0}, costs=COSTS)
    assert [(d.node, dict(d.expected)) for d in made.of(Activated)] == [("b", {}), ("c", {})]
