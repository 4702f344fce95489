"""The concentration test as a condition of rules, and what it reads of beliefs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from bayesnet_track.adapt.rule_inputs import Inside, apply_test
from bayesnet_track.graph.spec import Concentrated
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.journal.target_net import Concentration

TEST = {"share": 0.9, "within_box": 0.5, "confidence": 0.95}
SURE, UNSURE = Inside(0.97, 400.0, 10.0), Inside(0.6, 400.0, 10.0)


def net(on_frames=1, off_frames=3):
    adapt = {
        "activate": {"unless": {"concentrated": TEST}, "frames": on_frames},
        "deactivate": {"when": {"concentrated": TEST}, "frames": off_frames},
    }
    nodes = {"root": {"fuse": "product", "adapt": adapt, "lost": {"above": {"ud_px2": 1e9}}}}
    return nodes | {agent: {"parent": "root", "agent": agent} for agent in "ab"}


def windows(*insides):
    return [{0.5: inside} for inside in insides]


@given(st.integers(1, 300), st.floats(0.0, 1.0), st.floats(0.3, 0.99), st.sampled_from([0.8, 0.95, 0.99]))
def test_it_is_the_one_sided_binomial_test(trials, part, share, confidence):
    inside = round(part * trials)
    found = apply_test(
        Concentrated(share=share, confidence=confidence), Inside(inside / trials, trials, 1.0), 1.0
    )
    p_value = stats.binom.sf(inside - 1, trials, share)
    if abs(p_value - (1 - confidence)) > 1e-9:
        assert found.below == (p_value <= 1 - confidence)
    assert found.above != found.below


def test_switching_by_the_test(drive):
    made = drive(net(), [50.0] * 6, insides=windows(SURE, SURE, SURE, SURE, UNSURE, SURE), kl={"b": 1.0})
    (off,), (on,) = made.of(Deactivated), made.of(Activated)
    assert (off.frame, off.node, on.frame, on.node) == (3, "b", 5, "b")
    assert isinstance(off.cause, Concentration) and isinstance(on.cause, Concentration)
    assert on.cause.inside == 0.6 and on.cause.trials == 400.0 and on.cause.radius_px == 10.0
    assert on.cause.vouched == on.cause.turning < 0.6 < on.cause.share == 0.9 <= off.cause.turning
    assert off.cause.frames == 3 and off.cause.ud_px2 == 50.0


def test_few_effective_hypotheses_cannot_vouch_for_much(drive):
    """All of 20 inside: 0.9^20 = 0.12 is no proof; all of 30 inside: 0.042 is."""
    few, enough = Inside(1.0, 20.0, 10.0), Inside(1.0, 30.0, 10.0)
    made = drive(net(), [50.0] * 5, insides=windows(few, few, few, enough, enough), active="a")
    assert made.frames(Activated) == [1] and made.of(Deactivated) == []
    made = drive(net(), [50.0] * 3, insides=windows(enough, enough, enough), kl={"a": 1.0})
    assert made.frames(Deactivated, "a") == [3]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0.5, 1.0), min_size=4, max_size=12))
def test_the_turning_share_is_where_the_rule_would_not_have_fired(drive, shares):
    """Run again with the share at its turning value: the first decision is gone."""
    insides = windows(*(Inside(share, 300.0, 10.0) for share in shares))
    nodes = net(on_frames=2)
    uds, settings_ = [50.0] * len(shares), {"insides": insides, "kl": {"b": 1.0}}
    for kind, active in ((Activated, "a"), (Deactivated, "ab")):
        made = drive(nodes, uds, active=active, **settings_).of(kind)
        if not made:
            continue
        first = made[0]
        turned = net(on_frames=2)
        nudge = first.cause.turning if kind is Activated else first.cause.turning + 1e-9
        for rule, key in (("activate", "unless"), ("deactivate", "when")):
            turned["root"]["adapt"][rule][key] = {"concentrated": {**TEST, "share": min(nudge, 1 - 1e-12)}}
        again = drive(turned, uds, active=active, **settings_)
        assert first.frame not in again.frames(kind)


def test_what_a_particle_belief_holds_inside(weigh, fakes):
    """Two clusters of 0.75 and 0.25; the mode is in the larger one, effective hypotheses by the weights."""
    adapt = {
        "activate": {"unless": {"concentrated": TEST}},
        "deactivate": {"when": {"concentrated": {**TEST, "within_box": 0.3}}},
    }
    nodes = {"root": {"fuse": "product", "adapt": adapt}, "a": {"parent": "root", "agent": "a"}}
    nodes["b"] = {"parent": "root", "agent": "b"}
    boxes = np.array([[10.0, 10, 20, 20], [16, 10, 20, 20], [100, 10, 20, 20], [18, 10, 20, 20]])
    likelihood = np.log([0.5, 0.15, 0.25, 0.1])
    _, measures = weigh(nodes, {"a": lambda *_: likelihood.copy(), "b": lambda *_: np.zeros(4)}, boxes)
    wide, narrow = measures.inside["root", 0.5], measures.inside["root", 0.3]
    assert wide.radius_px == 10.0 and wide.share == pytest.approx(0.75)
    assert narrow.radius_px == 6.0 and narrow.share == pytest.approx(0.65)
    assert wide.trials == pytest.approx(1 / np.sum(np.exp(2 * likelihood)))
    assert set(measures.inside) == {("root", 0.5), ("root", 0.3)}


def test_an_exact_belief_needs_no_test():
    assert apply_test(Concentrated(share=0.9), Inside(0.9, math.inf, 1.0), 1.0).below
    assert apply_test(Concentrated(share=0.9), Inside(0.8999, math.inf, 1.0), 1.0).above


def test_a_cause_has_all_numbers_of_the_test_and_where_it_turns():
    """On at the largest share that was vouched for in the streak, off at the smallest."""
    test = Concentrated(share=0.8, within_box=0.4, confidence=0.99)
    found = apply_test(test, Inside(0.9, 50.0, 12.5), 33.0)
    numbers = {
        "share": 0.8,
        "within_box": 0.4,
        "confidence": 0.99,
        "inside": 0.9,
        "trials": 50.0,
        "vouched": found.value,
        "frames": 3,
        "radius_px": 12.5,
        "ud_px2": 33.0,
    }
    values = (0.7, 0.75, 0.72)
    assert found.cause_above(3, values) == Concentration(**numbers, turning=0.75)
    assert found.cause_below(3, values) == Concentration(**numbers, turning=0.7)
    assert found.value == pytest.approx(stats.beta.ppf(0.01, 45, 6), rel=1e-6)
