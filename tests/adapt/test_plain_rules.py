"""Nets in which only the status can change: what is remembered in short is what all rules remember."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track.adapt.measures import Measures
from bayesnet_track.adapt.memory import Memory, Quiet
from bayesnet_track.adapt.plain_rules import PlainMemories, Seen, has_plain_rules
from bayesnet_track.adapt.rules import decide
from bayesnet_track.adapt.situation import Situation
from bayesnet_track.journal.net.net import Net, apply
from bayesnet_track.journal.net.target_net import TargetNet

LEVELS = [{"ud_px2": 50.0}, {"ud_box": 0.1}, {"ud_baseline": 2.0}]
FRAMES = st.tuples(st.floats(0, 100), st.floats(0, 1), st.sampled_from([0.0, 0.4, 0.6]))


def remembered(plate, net, measures, memory, hidden=0.0):
    if net.status != "tracking" or not PlainMemories.fits(memory, "root", net.active):
        return None
    numbers = (measures.ud_px2["root"], measures.area_px2, measures.fit, hidden)
    nats = np.array([[measures.contribution[agent] for agent in sorted(net.active)]])
    known = PlainMemories.of(plate, sorted(net.active), [memory])
    after, stays = known.then(plate, Seen(*(np.array([one]) for one in numbers), nats))
    return after.memory(0) if stays[0] else None


def plate_of(fakes, root, agent=None):
    nodes = {name: {"parent": "root", "agent": name, **(agent or {})} for name in "ab"}
    return fakes.plate({"root": {"fuse": "product", **root}, **nodes})[0]


@pytest.mark.parametrize("level", LEVELS)
@settings(max_examples=20)
@given(frames=st.lists(FRAMES, min_size=12, max_size=30))
def test_it_is_what_all_rules_remember(fakes, level, frames):
    """Over runs of good and bad frames; where it answers, nothing was decided."""
    plate = plate_of(fakes, {"lost": {"above": level, "fit_below": 0.3, "frames": 2}})
    assert has_plain_rules(plate)
    live, memory = Net({"1": TargetNet("plate", frozenset("a"))}), Memory()
    for k, (ud, fit, hidden) in enumerate(frames):
        net = live.targets["1"]
        measures = Measures({"root": ud}, {"a": ud}, {"a": 0.0}, {"a": fit}, {}, fit, 400.0)
        found = remembered(plate, net, measures, memory, hidden)
        now = Situation(k, "1", plate, net, measures, {"a": 1.0}, frozenset(), hidden)
        decisions, memory = decide(now, memory)
        assert found is None or (found == memory and not decisions)
        assert found is not None or net.status == "lost" or memory.lost.count > 0
        for decision in decisions:
            live = apply(live, decision)


def test_nets_with_other_rules_are_none(fakes):
    score = {"score": {"logistic": {"bias": 0}}, "lost": {"score_below": 0.5}}
    adapt = {"adapt": {"activate": {"above": {"ud_px2": 9.0}}, "deactivate": {"below": {"ud_px2": 4.0}}}}
    check = {"self_check": {"above": {"ud_px2": 9.0}}}
    assert not has_plain_rules(plate_of(fakes, score))
    assert not has_plain_rules(plate_of(fakes, adapt))
    assert not has_plain_rules(plate_of(fakes, {}, check))
    assert has_plain_rules(plate_of(fakes, {}))


def test_a_memory_that_has_more_than_the_columns_is_left_to_all_rules():
    active, other = frozenset("a"), frozenset("ab")
    assert PlainMemories.fits(Memory(), "root", active)
    assert PlainMemories.fits(Memory(quiet={"root": Quiet({active: (1.0,)})}), "root", active)
    for memory in (
        Memory(missed={"a": 1}),
        Memory(quiet={"part": Quiet()}),
        Memory(quiet={"root": Quiet({active: (1.0,), other: (2.0,)})}),
    ):
        assert not PlainMemories.fits(memory, "root", active)


@given(rows=st.lists(st.lists(st.floats(0, 1e6), min_size=8, max_size=60), min_size=2, max_size=6))
def test_medians_of_many_are_those_of_each(fakes, rows):
    """Also of rows that are taken out, and put together again."""
    plate, active, size = plate_of(fakes, {}), frozenset("a"), min(map(len, rows))
    memories = [Memory(quiet={"root": Quiet({active: tuple(row[: size - 1])})}) for row in rows]
    known = PlainMemories.of(plate, ["a"], memories)
    known = known.take([0]).extended(known.take(range(1, len(rows))))
    ones = np.ones(len(rows))
    last = np.array([row[size - 1] for row in rows])
    after, _ = known.then(plate, Seen(last, ones, ones, ones, ones[:, None]))
    for row, values in enumerate(rows):
        quiet = Quiet({active: tuple(values[:size][-50:])})
        assert after.median(row) == quiet.level_px2(active)
        assert after.memory(row).quiet == {"root": quiet}
