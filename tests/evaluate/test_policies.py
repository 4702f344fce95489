"""The search for a policy: the cheapest that holds the target as well, in fewer runs than trying all."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.evaluate.policies import Policy, Trial, candidates, policy_of, search
from bayesnet_track.graph.spec import Adapt

OWN = Policy(100.0, 60.0, None)


def test_candidates_begin_with_the_graph_s_own_and_ask_for_less():
    found = candidates(OWN)
    assert found[0] == OWN and len(set(found)) == len(found)
    assert all(one.deactivate < one.activate and one.activate >= OWN.activate for one in found)
    assert {one.sample_every for one in candidates(Policy(0.07, 0.06, 3))} == {3, 4, 6}


def noisy(costs, losses):
    """Trials of videos that differ much, and alike for all policies."""
    rng = np.random.default_rng(2)
    videos = rng.uniform(0.2, 0.9, 48)
    return lambda policy, video: Trial(videos[video] - losses[policy], costs[policy])


def test_the_cheapest_that_loses_no_accuracy_is_chosen():
    tried = [OWN, *(Policy(100.0 * k, 50.0 * k, None) for k in range(2, 9))]
    costs = {one: 5.0 - 0.4 * k for k, one in enumerate(tried)}
    losses = {one: 0.0 if k < 5 else 0.05 for k, one in enumerate(tried)}
    found = search(tried, 48, noisy(costs, losses))
    assert found.policy == tried[4]
    assert found.trial.cost_ms == pytest.approx(costs[tried[4]]) and found.own.cost_ms == 5.0
    assert found.runs < len(tried) * 48 * 0.7


def test_the_graph_s_own_stays_when_all_others_lose_or_cost_more():
    tried = [OWN, Policy(200.0, 120.0, None), Policy(400.0, 240.0, None)]
    costs = {one: 3.0 - k for k, one in enumerate(tried)}
    assert search(tried, 5, noisy(costs, {OWN: 0.0, tried[1]: 0.1, tried[2]: 0.2})).policy == OWN
    assert search(tried, 5, noisy({one: 3.0 for one in tried}, dict.fromkeys(tried, 0.0))).policy == OWN


def test_a_loss_that_only_chance_hides_is_not_risked():
    """A mean loss of .004 in 20 videos is known to .03 with an sd of .08 a video, and to .004 with .01."""
    cheap, differences = Policy(200.0, 120.0, None), np.random.default_rng(5).normal(0.0, 0.08, 20)
    differences += -0.004 - differences.mean()

    def run(policy, video):
        return Trial(0.6 + (differences[video] if policy == cheap else 0.0), 2.0 if policy == cheap else 3.0)

    assert search([OWN, cheap], 20, run).policy == OWN
    differences /= 8.0
    assert search([OWN, cheap], 20, run).policy == cheap


def test_what_no_policy_can_be_chosen_for_is_said():
    with pytest.raises(ValueError, match="one video; two or more"):
        search([OWN], 1, noisy({OWN: 1.0}, {OWN: 0.0}))
    tested = {"activate": {"unless": {"concentrated": {}}}, "deactivate": {"below": {"ud_px2": 3}}}
    for rules in (None, Adapt(), Adapt.model_validate(tested)):
        with pytest.raises(ValueError, match="levels of UD in the same unit"):
            policy_of(rules)
