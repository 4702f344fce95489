"""A target that may reappear elsewhere: what its settings say."""

from __future__ import annotations

from bayesnet_track.graph.settings.jumps import Relocalize


def test_it_is_looked_for_by_the_agents_unless_something_else_is_named():
    assert Relocalize().by.kind == "agents"
    assert Relocalize().by.agents.max_boxes == 400
