"""Load is shed by what agents say per millisecond, taken back when there is time, and does not flap."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.shedding import CALM, Load, Running, balance
from bayesnet_track.journal.events.load import LateFrame, ParticlesLimited, Shed, SpareTime, TakenBack
from bayesnet_track.journal.net import Net, apply
from bayesnet_track.journal.target_net import TargetNet

ADAPT = {"activate": {"above": {"ud_px2": 200}}, "deactivate": {"below": {"ud_px2": 100}}}


@pytest.fixture
def running(fakes):
    """Three agents of 4, 1 and 1 ms that contribute 0.4, 0.05 and 0.5 nats."""
    plate, _ = fakes.plate(
        {"root": {"fuse": "product", "adapt": ADAPT}, "a": "root", "b": "root", "c": "root"}
    )
    memory = replace(
        RuleMemory.empty(plate), nats=np.array([[4.0, 0.5, 5.0]]), frames=np.full((1, 3), 10, dtype=np.int64)
    )
    net = TargetNet("plate", frozenset("abc"))
    return Running(plate, net, memory, {"a": 4.0, "b": 1.0, "c": 1.0}, 800, 200, 800)


def play(one, timing, load=Load(), stride=1):  # noqa: B008
    """What is decided when so much is told in turn: (frame, input); in the frames between, nothing is."""
    chosen, last = [], None
    for frame, inputs in timing:
        for between in range(frame if last is None else last + stride, frame, stride):
            _, load = balance(between, (), {"1": one}, load)
        last = frame
        decisions, load = balance(frame, inputs, {"1": one}, load)
        net = Net({"1": one.net})
        for decision in decisions:
            net = apply(net, decision)
        one = replace(one, net=net.targets["1"])
        chosen += decisions
    return chosen, one, load


def late(first, count, spent=11.0, budget=10.0):
    return [(frame, (LateFrame(frame, spent, budget),)) for frame in range(first, first + count)]


def early(first, spent, count=1, budget=10.0):
    return [(first + 50 * n, (SpareTime(first + 50 * n, spent, budget, 50),)) for n in range(count)]


def test_the_agent_that_says_least_per_ms_goes_first(running):
    chosen, one, _ = play(running, late(20, 3))
    index = {"a": 0.1, "b": 0.05, "c": 0.5}
    assert chosen == [Shed(22, "1", "b", 11.0, 10.0, 3, 10, 11.0, pytest.approx(index))]
    assert one.net.shed == ("b",) and one.net.active == {"a", "c"}


@pytest.mark.parametrize("stride", [1, 5, 40])
def test_frames_count_that_are_tracked_whatever_their_numbers(running, stride):
    """The numbers of a camera's frames jump where it drops some, and it drops them where frames are late."""
    timing = [(stride * n, (LateFrame(stride * n, 11.0, 10.0),)) for n in range(4)]
    assert [one.frame for one in play(running, timing, stride=stride)[0]] == [2 * stride]


def test_two_late_frames_are_no_reason_and_old_ones_are_forgotten(running):
    assert play(running, late(20, 2))[0] == []
    assert play(running, [*late(20, 2), *late(40, 1)])[0] == []


def test_the_budget_at_which_it_would_have_stayed_is_told(running):
    """At 12 ms only two of the frames were late."""
    timing = [late(20, 1, 14.0)[0], late(21, 1, 12.0)[0], late(22, 1, 13.0)[0]]
    (shed,) = (d for d in play(running, timing)[0] if d.node == "b")
    assert (shed.spent_ms, shed.turning_ms) == (13.0, 12.0)
    stay = [(f, (LateFrame(f, one.spent_ms, 12.0),)) for f, (one,) in timing if one.spent_ms > 12.0]
    assert play(running, stay)[0] == []


def test_as_much_goes_at_once_as_declared_costs_ask_for(running):
    """A frame that takes twice the budget: half of 6 ms has to go, b alone saves 1, so a goes, too."""
    chosen, one, _ = play(running, late(20, 3, 20.0))
    assert [d.node for d in chosen] == ["b", "a"] and one.net.active == {"c"}


def test_what_a_rule_keeps_and_a_person_holds_stays_and_hypotheses_go_instead(running):
    held = replace(running, net=replace(running.net, by_hand={"a": True, "b": True, "c": True}))
    chosen, one, load = play(held, late(20, 3, 20.0))
    assert chosen == [ParticlesLimited(22, "1", 400, 800, 20.0, 10.0)]
    chosen, one, load = play(one, late(23, 9, 50.0), load)
    assert [d.most for d in chosen] == [200]
    assert one.net.most_particles == 200, "never below the least number"


def test_there_is_nothing_left_to_shed(running):
    alone = replace(running, net=TargetNet("plate", frozenset("a")), particles=None)
    assert play(alone, late(20, 9, 50.0))[0] == []


def test_it_comes_back_when_it_fits_hypotheses_first(running):
    net = replace(running.net, active=frozenset("c"), shed=("b", "a"), most_particles=400)
    chosen, _, _ = play(replace(running, net=net), early(100, 2.0, 3))
    assert chosen == [
        ParticlesLimited(100, "1", None, 400, 2.0, 10.0),
        # a costs four times what is on: 2 ms would become 10; b is shed earlier and fits.
        TakenBack(150, "1", "b", 2.0, 4.0, 10.0, 50),
        TakenBack(200, "1", "a", 2.0, 6.0, 10.0, 50),
    ]


def test_it_does_not_come_back_where_it_would_be_late_again(running):
    net = replace(running.net, active=frozenset("bc"), shed=("a",))
    assert play(replace(running, net=net), early(100, 4.0, 40))[0] == []


def test_it_does_not_flap(running):
    """In time without b, late with it, for 20,000 frames: it comes back more and more rarely."""
    one, load, chosen, calm = running, Load(), [], 0
    for frame in range(20_000):
        calm = 0 if "b" in one.net.active else calm + 1
        inputs = ()
        if "b" in one.net.active:
            inputs = (LateFrame(frame, 11.0, 10.0),)
        elif calm % 50 == 0:
            inputs = (SpareTime(frame, 5.0, 10.0, 50),)
        decided, one, load = play(one, [(frame, inputs)], load)
        chosen += decided
    back = [d.frame for d in chosen if isinstance(d, TakenBack)]
    gaps = [b - a for a, b in pairwise(back)]
    assert gaps[0] == pytest.approx(2 * CALM, abs=10) and gaps == sorted(gaps)
    assert len(back) < 20


def test_what_calls_an_expensive_agent_stays_with_it(fakes, running):
    """Without it the agent on call would run in every frame: it goes itself."""
    on_call = {"agents": ["a"], "on_call": {"every": 4, "above": {"ud_px2": 60.0}}}
    plate, _ = fakes.plate({"root": {"fuse": "product", "adapt": on_call}, "a": "root", "b": "root"})
    two = replace(
        running, plate=plate, net=TargetNet("plate", frozenset("ab")), costs_ms={"a": 4.0, "b": 1.0}
    )
    chosen, one, _ = play(two, late(20, 3))
    assert [d.node for d in chosen] == ["a"] and one.net.active == {"b"}
