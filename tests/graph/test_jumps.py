"""A target that may reappear elsewhere: what its settings need to act on."""

from __future__ import annotations

from bayesnet_track.graph.spec import Relocalize, Sudden


def test_a_fast_move_is_looked_for_only_where_it_is_asked_for():
    assert Relocalize().sudden is None
    assert Relocalize(sudden=Sudden()).sudden.below_fit < 1.0
