"""Nets in which only the status can change: what is remembered in short is what all rules remember."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track.adapt.measures import Measures
from bayesnet_track.adapt.memory import Memory, Quiet, find_medians
from bayesnet_track.adapt.plain_rules import has_plain_rules, remember_plainly
from bayesnet_track.adapt.rules import decide
from bayesnet_track.adapt.situation import Situation
from bayesnet_track.journal.net.net import Net, apply
from bayesnet_track.journal.net.target_net import TargetNet

LEVELS = [{"ud_px2": 50.0}, {"ud_box": 0.1}, {"ud_baseline": 2.0}]
FRAMES = st.tuples(st.floats(0, 100), st.floats(0, 1), st.sampled_from([0.0, 0.4, 0.6]))


@dataclass(frozen=True)
class One:
    """The measures of one target as those of several."""

    uds: tuple[float, ...]
    areas: tuple[float, ...]
    fits: tuple[float, ...]
    contributions: tuple[dict[str, float], ...]


def remembered(plate, net, measures, memory, hidden=0.0):
    seen = One((measures.ud_px2["root"],), (measures.area_px2,), (measures.fit,), (measures.contribution,))
    (found,) = remember_plainly(plate, [net], seen, [memory], [hidden])
    return found


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


def test_an_agent_that_is_out_or_off_is_left_to_all_rules(fakes):
    plate, measures = plate_of(fakes, {}), Measures({"root": 1.0}, {}, {}, {}, {}, 1.0, 400.0)
    for net in (
        TargetNet("plate", frozenset()),
        TargetNet("plate", frozenset("a"), quarantined=frozenset("b")),
    ):
        assert remembered(plate, net, measures, Memory()) is None
    net = TargetNet("plate", frozenset("a"))
    assert remembered(plate, net, measures, Memory(missed={"a": 1})) is None
    assert remembered(plate, net, measures, Memory()) is not None


@given(rows=st.lists(st.lists(st.floats(0, 1e6), min_size=8, max_size=12), min_size=1, max_size=6))
def test_medians_of_many_are_those_of_each(rows):
    active = frozenset("a")
    each = [Quiet({active: tuple(row)}) for row in rows]
    together = [Quiet({active: tuple(row)}) for row in rows]
    find_medians(together)
    assert [one.level_px2(active) for one in together] == [one.level_px2(active) for one in each]
