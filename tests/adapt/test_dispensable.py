"""`drop: most_expensive_redundant`: the dearest agent goes without which the belief would stay narrow."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.journal.events.switches import Activated, Deactivated

ADAPT = {
    "activate": {"above": {"ud_px2": 20.0}},
    "deactivate": {"below": {"ud_px2": 18.0}, "frames": 2, "drop": "most_expensive_redundant"},
}
NODES = {
    "root": {"fuse": "product", "ud_fields": ["x", "y"], "adapt": ADAPT},
    "a": "root",
    "b": "root",
    "c": "root",
}


def played(fakes, sds, costs, frames=12):
    """Decisions of agents that see the target at its place with these sds (px), and cost this much (ms)."""
    sees = {name: fakes.gaussian(50.0, 40.0, sd) for name, sd in sds.items()}
    engine, _ = fakes.engine(NODES, sees)
    (compiled,) = engine.plates.values()
    compiled.costs_ms.update(costs)
    return [event for one in fakes.play(engine, frames) for event in one.events]


def test_the_dearest_goes_first_and_the_one_that_is_needed_stays(fakes):
    """Only b is sharp enough alone (UD about 8 px²); without it UD is above the 20 px² that call back."""
    events = played(fakes, {"a": 12.0, "b": 2.0, "c": 9.0}, {"a": 5.0, "b": 50.0, "c": 1.0})
    off = [event for event in events if isinstance(event, Deactivated)]
    assert [event.node for event in off] == ["a", "c"]  # b, the dearest of all, cannot be spared
    assert not [event for event in events if isinstance(event, Activated)]
    assert off[0].drop == "most_expensive_redundant" and set(off[0].index) == {"a", "b", "c"}
    assert off[0].index["a"] < 20 < off[0].index["b"]


def test_none_goes_that_cannot_be_spared(fakes):
    """c sees nothing and can be spared. With a and b UD is about 14 px², with one of them about 26."""
    events = played(fakes, {"a": 4.0, "b": 4.0, "c": 1000.0}, {"a": 5.0, "b": 5.0, "c": 1.0}, 20)
    assert [event.node for event in events if isinstance(event, Deactivated)] == ["c"]


def test_ud_without_an_agent_is_that_of_the_others(fakes):
    """Against the sum over the hypotheses, the belief being the product of the likelihoods."""
    events = played(fakes, {"a": 6.0, "b": 3.0, "c": 9.0}, {"a": 5.0, "b": 1.0, "c": 1.0})
    first = next(event for event in events if isinstance(event, Deactivated))
    for agent, others in {"a": (3.0, 9.0), "b": (6.0, 9.0), "c": (6.0, 3.0)}.items():
        variance = 1.0 / sum(sd**-2.0 for sd in others)
        # 2 sigma^2 about the mean, and the same again about a mode that 500 hypotheses hit by chance at most.
        assert 2 * variance * 0.5 < first.index[agent] < 4 * variance, (agent, np.sqrt(variance))


@pytest.mark.parametrize("part", ["activate", "deactivate"])
def test_it_needs_levels(part):
    test = {"activate": {"unless": "concentrated"}, "deactivate": {"when": "concentrated"}}[part]
    adapt = {
        **ADAPT,
        part: {**test, **({"drop": "most_expensive_redundant"} if part == "deactivate" else {})},
    }
    root = {
        "motion": {"random_walk": {"sd_px": {"x": 1, "y": 1}}},
        "fuse": "product",
        "adapt": adapt,
    }
    agents = {
        "a": {"parent": "root", "agent": "intensity"},
        "b": {"parent": "root", "agent": "color_histogram"},
    }
    with pytest.raises(GraphError, match="most_expensive_redundant asks what UD would be"):
        check_graph({"name": "bad", "targets": {"t": {"nodes": {"root": root, **agents}}}})
