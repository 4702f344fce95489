"""When targets are joined and parted, the law of evidence, spanning trees, and replay from decisions."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.adapt.joins import (
    JoinMemory,
    Level,
    PairMemory,
    Reaches,
    decide_joins,
    spanning_tree,
)
from bayesnet_track.graph.spec import Join
from bayesnet_track.journal.events.joins import Joined, Parted
from bayesnet_track.journal.events.lives import TargetDied, TargetStarted
from bayesnet_track.journal.net import Net, apply, replay

NEAR = Join.model_validate({"exclusion": {}, "when": {"overlap": 0.1, "apart_frames": 3}})
CARRY = Join.model_validate({"between": ["person", "box"], "attachment": {}})


def reach(x, y=50.0, sd=0.0):
    return (x, y, 20.0, 20.0), (sd, sd)


def reaches_of(known):
    boxes, sds = ([one[k] for one in known.values()] for k in (0, 1))
    return Reaches([*known], np.array(boxes).reshape(-1, 4), np.array(sds).reshape(-1, 2))


def born(**kinds):
    return [TargetStarted(0, name, kind, (0, 0, 9, 9), ()) for name, kind in kinds.items()]


def net_of(**kinds):
    net = Net()
    for decision in born(**kinds):
        net = apply(net, decision)
    return net


def uncounted(net, reaches):
    """Pairs of live targets whose beliefs overlap although no join accounts for the pixels of both."""
    overlaps = reaches_of(reaches).overlaps
    pairs = combinations(enumerate(reaches), 2)
    over = {(a, b) for (i, a), (k, b) in pairs if overlaps[i, k] >= NEAR.when.overlap}
    return {frozenset(pair) for pair in over} - {frozenset(pair) for pair in net.joins}


def test_overlap_is_of_the_smaller_reach():
    overlaps = reaches_of(dict(enumerate([reach(50), reach(60), reach(90), reach(50, sd=5.0)]))).overlaps
    assert overlaps[0, 1] == pytest.approx(0.5)
    assert overlaps[0, 2] == 0
    assert overlaps[0, 3] == pytest.approx(1.0), "the smaller one lies wholly inside"
    assert np.array_equal(overlaps, overlaps.T)
    assert reaches_of({}).overlaps.shape == (0, 0)


def test_they_are_joined_at_once_and_parted_after_a_while():
    net, memory, decided = net_of(a="t", b="t"), JoinMemory(), []
    for frame, x in enumerate([200.0, 68.5, 68.0, 69.9, 80.0, 68.0, 80.0, 81.0, 90.0, 90.0], 1):
        decisions, memory = decide_joins(
            frame, (NEAR,), net, reaches_of({"a": reach(50), "b": reach(x)}), memory
        )
        decided += decisions
        for decision in decisions:
            net = apply(net, decision)
    assert decided == [
        Joined(3, "a", "b", ("t", "t"), 0, pytest.approx(0.1), 0.1),
        Parted(9, "a", "b", 0.0, 0.1, 3, 0.0, 6),
    ]
    assert not net.joins and not memory.pairs


def test_kinds_without_a_join_stay_alone_and_the_carrier_comes_first():
    net = net_of(b="box", p="person", q="person")
    reaches = {name: reach(50) for name in net.targets}
    decisions, memory = decide_joins(1, (CARRY,), net, reaches_of(reaches), JoinMemory())
    assert [(one.target, one.other) for one in decisions] == [("p", "b"), ("q", "b")]
    assert memory.pairs["p", "b"].overlap == 1.0


def test_joins_replay_and_end_with_their_targets():
    join = Joined(3, "a", "b", ("t", "t"), 0, 0.2, 0.1)
    decisions = [*born(a="t", b="t"), join, TargetDied(7, "b", "lost", 30, 30, False)]
    assert replay(decisions, until_frame=3).joins == {}
    assert replay(decisions, until_frame=4).joins == {("a", "b"): join}
    assert replay(decisions).joins == {}
    with pytest.raises(KeyError):
        apply(net_of(a="t"), join)
    with pytest.raises(KeyError):
        apply(net_of(a="t", b="t"), Parted(9, "a", "b", 0.0, 0.1, 3, 0.0, 6))


@given(
    st.lists(
        st.lists(st.tuples(st.integers(0, 120), st.integers(0, 60)), min_size=4, max_size=4),
        min_size=1,
        max_size=8,
    )
)
def test_after_every_change_overlapping_targets_are_accounted_for(frames):
    """The law of two-level evidence; and the tree and what is left out of it are all joined pairs."""
    net, memory = net_of(a="t", b="t", c="t", d="t"), JoinMemory()
    for frame, places in enumerate(frames, 1):
        reaches = {name: reach(float(x), float(y)) for name, (x, y) in zip("abcd", places, strict=True)}
        decisions, memory = decide_joins(frame, (NEAR,), net, reaches_of(reaches), memory)
        before = uncounted(net, reaches)
        for decision in decisions:
            net = apply(net, decision)
        assert uncounted(net, reaches) == set()
        assert before == {frozenset((one.target, one.other)) for one in decisions if isinstance(one, Joined)}
        assert memory.pairs.keys() == net.joins.keys()
        tree, rest = spanning_tree({pair: one.overlap for pair, one in memory.pairs.items()})
        assert {*tree, *rest} == set(net.joins)
        groups = {frozenset(group) for group in rest.values()}
        assert all(set(pair) <= set(group) for pair, group in rest.items())
        assert all(sum(set(pair) <= group for pair in tree) == len(group) - 1 for group in groups)


def test_a_ring_opens_where_the_overlap_is_least():
    tree, rest = spanning_tree({("a", "b"): 0.5, ("b", "c"): 0.1, ("c", "a"): 0.4})
    assert set(tree) == {("a", "b"), ("c", "a")}
    assert rest == {("b", "c"): rest["b", "c"]} and sorted(rest["b", "c"]) == ["a", "b", "c"]


def test_a_level_belongs_to_the_agents_that_were_active():
    level = Level(frozenset("a"), -2.0, 0.0).then(frozenset("a"), -4.0, -1.0)
    assert level == Level(frozenset("a"), -3.0, -0.5, 2)
    assert level.then(frozenset("ab"), -9.0, -1.0) == Level(frozenset("ab"), -9.0, -1.0)


def test_what_is_remembered_goes_with_the_target_or_with_its_last_join():
    """Levels belong to live targets, joined or not; all else to those that a pair holds."""
    everyone = "abcd"  # a and b joined, c alone, d gone
    memory = JoinMemory(
        pairs={("a", "b"): PairMemory(), ("a", "d"): PairMemory()},
        levels={name: Level(frozenset(), -1.0, 0.0) for name in everyone},
        carried={name: name for name in everyone},
        centres={name: np.zeros(2) for name in everyone},
        hidden={name: ("a", 3) for name in everyone},
        carriers={name: ("b", 4) for name in everyone},
    )
    net = apply(net_of(a="t", b="t", c="t"), Joined(3, "a", "b", ("t", "t"), 0, 0.2, 0.1))
    reaches = {"a": reach(50), "b": reach(60), "c": reach(300)}
    decisions, kept = decide_joins(5, (NEAR,), net, reaches_of(reaches), memory)
    assert decisions == () and set(kept.pairs) == {("a", "b")}
    assert kept.pairs["a", "b"].overlap == pytest.approx(0.5)
    assert set(kept.levels) == {"a", "b", "c"}
    for part in (kept.carried, kept.centres, kept.hidden, kept.carriers):
        assert set(part) == {"a", "b"}
    assert kept.carried["b"] == "b" and kept.hidden["a"] == ("a", 3) and kept.carriers["a"] == ("b", 4)
