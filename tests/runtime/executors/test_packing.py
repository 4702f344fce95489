"""Agents share workers so that none has much more to do than the others."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.runtime.executors.worker_pool import busiest, repack, spread_agents

costs = st.dictionaries(st.text("abcdef", min_size=1, max_size=3), st.floats(0.001, 1.0), max_size=8)


@given(costs, st.integers(1, 4))
def test_everyone_is_in_one_place_and_nobody_waits_for_more_than_the_bound_of_the_rule(costs, workers):
    packing = spread_agents(costs, workers)
    assert sorted(agent for own in packing for agent in own) == sorted(costs)
    # Graham: the longest processing time first is at most 4/3 of the best, which is at least this.
    least = max([sum(costs.values()) / workers, *costs.values()])
    assert busiest(costs, packing) <= 4 / 3 * max(least, two_must_share(costs, workers)) + 1e-12


def two_must_share(costs, workers):
    dearest = sorted(costs.values(), reverse=True)
    return dearest[workers - 1] + dearest[workers] if len(dearest) > workers else 0.0


def test_agents_move_only_when_it_is_worth_it():
    assert repack({"a": 1.0, "b": 1.0}, [{"a", "b"}, set()]) == [{"a"}, {"b"}]
    assert repack({"a": 1.0, "b": 0.9, "c": 0.1}, [{"a", "c"}, {"b"}]) is None
    assert repack({"a": 1e-5, "b": 1e-5}, [{"a", "b"}, set()]) is None
