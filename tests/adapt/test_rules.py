"""The rules that reconfigure a net, as tables of UD sequences and the decisions they must give."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.rule_inputs import read_level
from bayesnet_track.graph.spec import Level
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.events.switches import Activated, Deactivated, LocallyAdapted, SelfStopped
from bayesnet_track.journal.target_net import Cause, FitCause, TargetNet
from bayesnet_track.journal.text.sentences import explain

NEVER_LOST = {"above": {"ud_px2": 1e9}}


def net(adapt=None, checks=None, lost=NEVER_LOST, agents="ab"):
    nodes = {"root": {"fuse": "product", "lost": lost}}
    if adapt is not None:
        nodes["root"]["adapt"] = adapt
    for agent in agents:
        nodes[agent] = {"parent": "root", "agent": agent}
        if checks and agent in checks:
            nodes[agent]["self_check"] = checks[agent]
    return nodes


def on_off(on=200.0, on_frames=3, off=130.0, off_frames=5, unit="ud_px2", **more):
    return {
        "activate": {"above": {unit: on}, "frames": on_frames, **more.pop("activate", {})},
        "deactivate": {"below": {unit: off}, "frames": off_frames, **more.pop("deactivate", {})},
        **more,
    }


# ------------------------------------------------------------------------------------ activation


def test_rules_switch_the_agents_that_they_name_and_no_other(drive):
    nodes = net(on_off(off_frames=2, agents=["b"]), agents="abc")
    kl = {"a": 9.0, "b": 1.0, "c": 5.0}
    done = drive(nodes, [100, 100, 100, 100, 201, 201, 201], kl=kl)
    assert [(d.frame, d.node) for d in done.of(Deactivated)] == [(2, "b")]
    assert [(d.frame, d.node) for d in done.of(Activated)] == [(7, "b")]
    off = drive(nodes, [201] * 4, active="a")
    assert [d.node for d in off.of(Activated)] == ["b"], "c was off, and is left as it is"


def test_agents_that_rules_do_not_name_count_as_kept(drive):
    nodes = net(on_off(off_frames=1, agents=["b"], keep=2), agents="abc")
    assert drive(nodes, [100] * 4).frames(Deactivated) == [1]
    assert drive(nodes, [100] * 4, active="ab").frames(Deactivated) == []


def test_agents_left_out_go_to_the_rules_further_up(drive):
    part = {
        "fuse": {"latent": {"given": {"sd_px": {"x": 2.0}}}},
        "parent": "root",
        "adapt": on_off(off_frames=1, agents=["b"]),
    }
    nodes = net(on_off(off_frames=1), agents="") | {"part": part}
    nodes |= {name: {"parent": "part", "agent": name} for name in "ab"}
    nodes |= {"c": {"parent": "root", "agent": "c"}}
    by = {d.node: d.governor for d in drive(nodes, [100] * 3, kl={"a": 2.0}).of(Deactivated)}
    assert by == {"a": "root", "b": "part"}


@pytest.mark.parametrize(
    ("uds", "on"),
    [
        ([201, 201, 201], [3]),
        ([201, 201, 200, 201, 201], []),  # 200 is not above 200
        ([201, 201, 201, 100, 201, 201, 201], [3]),  # nothing is left to switch on
        ([100, 300, 300, 300], [4]),
    ],
)
def test_activation_after_its_delay(drive, uds, on):
    assert drive(net(on_off()), uds, active="a").frames(Activated) == on


@pytest.mark.parametrize(
    ("uds", "off"),
    [
        ([129] * 5, [5]),
        ([129] * 4 + [130] + [129] * 4, []),  # 130 is not below 130
        ([129] * 12, [5]),  # one agent is left
        ([300] * 4 + [129] * 5, [9]),
    ],
)
def test_deactivation_after_its_delay(drive, uds, off):
    assert drive(net(on_off()), uds).frames(Deactivated) == off


def test_one_agent_is_dropped_at_a_time_down_to_those_kept(drive):
    uds = [100] * 30
    for keep, expected in ((1, ["c", "b"]), (2, ["c"])):
        made = drive(net(on_off(keep=keep), agents="abc"), uds, kl={"a": 0.1, "b": 0.2, "c": 0.3})
        assert [d.node for d in made.of(Deactivated)] == expected
        assert made.frames(Deactivated) == [5, 10][: len(expected)]  # the delay starts again


def test_a_switch_starts_both_delays_again(drive):
    """On at 3; the low streak that off needs begins after it, although UD was never between the levels."""
    made = drive(net(on_off(off_frames=2)), [100, 300, 300, 300, 100, 100, 100], active="a")
    assert (made.frames(Activated), made.frames(Deactivated)) == ([4], [6])


def test_a_node_switches_on_or_off_but_not_both(drive):
    """Levels in different units may hold at once: switching on comes first, and starts both delays again."""
    adapt = {
        "activate": {"above": {"ud_px2": 50.0}, "frames": 2},
        "deactivate": {"below": {"ud_box": 0.5}, "frames": 2},
    }
    made = drive(net(adapt, agents="abc"), [100.0] * 4, active="ab", kl={"a": 0.1, "b": 0.2, "c": 0.3})
    assert [(type(d), d.frame, d.node) for d in made.decisions] == [
        (Activated, 2, "c"),
        (Deactivated, 4, "c"),
    ]


def test_asymmetric_delays_outlast_a_dip(drive):
    """Full overlap brings UD back to quiet for 4 frames: both stay on."""
    made = drive(net(on_off()), [300] * 3 + [100] * 4 + [300] * 6, active="a", kl={"a": 1.0, "b": 0.0})
    assert made.frames(Activated) == [3] and made.of(Deactivated) == []


@pytest.mark.parametrize(
    ("drop", "dropped", "index"),
    [
        ("largest_kl", "b", {"a": 0.5, "b": 0.9, "c": 0.1}),
        ("min_contribution_per_ms", "c", {"a": 0.75, "b": 0.4, "c": 0.2}),
    ],
)
def test_which_agent_is_dropped(drive, drop, dropped, index):
    made = drive(
        net(on_off(deactivate={"drop": drop}), agents="abc"),
        [100] * 5,
        kl={"a": 0.5, "b": 0.9, "c": 0.1},
        contribution={"a": 0.3, "b": 0.2, "c": 0.8},
        costs={"a": 0.4, "b": 0.5, "c": 4.0},
    )
    (decision,) = made.of(Deactivated)
    assert (decision.node, decision.drop, decision.governor) == (dropped, drop, "root")
    assert decision.index == pytest.approx(index)


def test_all_or_the_most_helpful_is_switched_on(drive):
    uds = [100] * 10 + [300] * 9
    settings_ = {"kl": {"a": 0.0, "b": 1.0, "c": 2.0}, "contribution": {"a": 1.0, "b": 0.7, "c": 0.3}}
    every = drive(net(on_off(), agents="abc"), uds, **settings_)
    assert [(d.frame, d.node, d.helpfulness) for d in every.of(Activated)] == [
        (13, "b", None),
        (13, "c", None),
    ]
    best = drive(net(on_off(activate={"which": "most_helpful"}), agents="abc"), uds, **settings_)
    assert [(d.frame, d.node) for d in best.of(Activated)] == [(13, "b"), (16, "c")]
    assert [d.helpfulness for d in best.of(Activated)] == pytest.approx([0.7, 0.3])


def test_an_agent_never_tried_comes_first(drive):
    made = drive(
        net(on_off(activate={"which": "most_helpful"}), agents="abc"),
        [100] * 5 + [300] * 3,
        active="ab",
        kl={"a": 0.0, "b": 1.0},
        contribution={"b": 9.0},
    )
    assert [(d.node, d.helpfulness) for d in made.of(Activated)] == [("c", None)]


def test_each_inference_node_governs_its_own_agents(drive):
    nodes = {
        "root": {"fuse": "product", "lost": NEVER_LOST, "adapt": on_off()},
        "color": {"parent": "root", "fuse": "pool", "adapt": on_off(on=50.0, off=40.0)},
        "a": "color",
        "b": "color",
        "c": "root",
        "d": "root",
    }
    made = drive(
        nodes, [{"root": 190.0, "color": 60.0}] * 3 + [{"root": 210.0, "color": 45.0}] * 3, active="ac"
    )
    assert [(d.frame, d.node, d.governor) for d in made.of(Activated)] == [
        (3, "b", "color"),
        (6, "d", "root"),
    ]


# ------------------------------------------------------------------------------------ units


def test_levels_relative_to_the_box(drive):
    """0.5 of the area: 200 px^2 of a 400 px^2 box, 100 px^2 when it has shrunk to 200 px^2."""
    made = drive(
        net(on_off(on=0.5, on_frames=2, off=0.1, unit="ud_box")),
        [150] * 4,
        active="a",
        areas=[400.0, 400.0, 200.0, 200.0],
    )
    (decision,) = made.of(Activated)
    assert decision.cause == Cause("ud_box", 0.5, 0.75, 2, 0.75, 150.0, 200.0)
    assert decision.frame == 4


def test_levels_of_the_score_whatever_ud_is(drive):
    """An agent goes after three frames below the one score, and is back at the first above the other."""
    nodes = net(on_off(on=0.2, on_frames=1, off=0.15, off_frames=3, unit="score"))
    nodes["root"]["score"] = {"logistic": {"bias": 1.0, "evidence": 0.5}}
    scores = [0.9, 0.1, 0.14, 0.15, 0.14, 0.12, 0.1, 0.18, 0.2, 0.21, 0.9]
    made = drive(nodes, [1e6, 1.0] * 5 + [1.0], scores=scores)
    (off,), (on,) = made.of(Deactivated), made.of(Activated)
    assert off.cause == Cause("score", 0.15, 0.1, 3, 0.14, 1.0 if off.frame % 2 == 0 else 1e6, 1.0)
    assert (off.frame, on.frame, on.cause.value) == (7, 10, 0.21)
    assert off.describe().startswith("score 0.1 < 0.15 for 3 frames → ")
    assert on.describe().endswith("would have stayed off at activate ≥ 0.21")
    assert drive(nodes, [1.0] * 11).decisions == []


def test_levels_relative_to_the_quiet_level(drive):
    made = drive(
        net(on_off(on=2.0, off=1.25, unit="ud_baseline")), [94] * 12 + [187] * 5 + [189] * 3, active="a"
    )
    (decision,) = made.of(Activated)
    assert decision.frame == 20
    assert decision.cause.unit == "ud_baseline" and decision.cause.scale_px2 == 94.0
    assert decision.cause.value == pytest.approx(189 / 94)


def test_no_rule_fires_while_the_quiet_level_is_unknown(drive):
    made = drive(net(on_off(on=2.0, off=1.25, unit="ud_baseline")), [100] * 6 + [1e6] * 3, active="a")
    assert made.of(Activated) == []
    assert read_level(Level(ud_baseline=2.0), 100.0, 400.0, None) is None
    assert read_level(Level(ud_box=2.0), 100.0, 0.0, None) is None


def test_a_lost_target_is_helped_although_the_quiet_level_of_fewer_agents_is_unknown(drive):
    """With fewer agents it is measured anew, but not while lost: the level of more agents calls for them."""
    rules = net(on_off(on=2.0, off=1.25, unit="ud_baseline"), lost={"above": {"ud_px2": 1e5}, "frames": 3})
    fits = [1.0] * 16 + [0.01] * 12
    made = drive(rules, [100.0] * 16 + [250.0] * 12, fits=fits)
    assert made.frames(Deactivated) == [14] and made.frames(StatusChanged) == [19]
    back = made.of(Activated)[0]
    assert back.frame == 22 and back.cause.unit == "ud_baseline" and back.cause.scale_px2 == 100.0
    narrow = drive(rules, [100.0] * 16 + [150.0] * 12, fits=fits)
    assert narrow.frames(StatusChanged) == [19] and narrow.of(Activated) == []  # 150 is below twice 100


def test_quiet_is_that_of_the_agents_that_stay_on(drive):
    """Two agents have 40 px^2 together and 94 or 130 alone: the first 10 frames alone set the level, and
    neither the lower level of both nor the drop itself makes them oscillate.
    """
    alone = {frozenset("a"): 94.0, frozenset("b"): 130.0}
    made = drive(
        net(on_off(on=1.5, off=1.25, unit="ud_baseline")),
        [lambda active: alone.get(active, 40.0)] * 300,
        kl={"a": 0.1, "b": 0.2},
    )
    assert [(d.frame, d.node) for d in made.of(Deactivated)] == [(14, "b")]
    assert made.of(Activated) == []
    noisy = drive(
        net(on_off(on=1.5, off=1.25, unit="ud_baseline")),
        [lambda active: alone.get(active, 40.0)] * 100
        + [300.0] * 20
        + [lambda active: alone.get(active, 40.0)] * 80,
        kl={"a": 0.1, "b": 0.2},
    )
    assert noisy.frames(Activated) == [103] and noisy.frames(Deactivated) == [14, 125]


def test_what_counts_as_quiet(drive):
    level = lambda uds, **k: drive(net(**k), uds, active="a").memory.level_px2("root", frozenset("a"))  # noqa: E731
    assert level([10] * 9) is None
    assert level([10] * 5 + [30] * 6) == 30
    assert level([10] * 60 + [30] * 26) == 30  # the last 50 count
    assert level([10] * 10 + [500] * 40, adapt=on_off()) == 10  # above activation
    every = drive(
        net(adapt=on_off(off=1.0)), [10] * 12 + [500] * 40
    )  # the same with nobody left to switch on
    assert every.memory.level_px2("root", frozenset(every.nets[-1].active)) == 10
    assert (
        level([10] * 10 + [500] * 40, lost={"above": {"ud_px2": 400}, "frames": 5}) == 10.0
    )  # 4 + 10, then lost


# ------------------------------------------------------------------------------------ self-checks

CHECK = {"above": {"ud_px2": 100.0}, "frames": 4, "rest": 6}


def test_first_a_local_action_then_a_self_stop_then_a_doubling_rest(drive):
    bad = [500.0] * 60
    made = drive(
        net(on_off(on=50.0, on_frames=1, off=1.0), {"a": CHECK}),
        [60.0] * 60,
        agent_uds={"a": bad},
        adaptable="a",
    )
    first = [d for d in made.decisions if d.frame <= 4]
    assert [(type(d), d.frame) for d in first] == [
        (LocallyAdapted, 1),
        (LocallyAdapted, 2),
        (LocallyAdapted, 3),
        (SelfStopped, 4),
    ]
    assert [d.attempt for d in first[:3]] == [1, 2, 3]
    stops, starts = made.of(SelfStopped), made.frames(Activated)
    assert [(d.frame, d.rests_until) for d in stops] == [(4, 11), (14, 27), (30, 55), (58, 107)]
    assert starts == [10, 26, 54]  # works in the first frame it may, the one after the decision
    assert stops[0].cause == Cause("ud_px2", 100.0, 500.0, 4, 500.0, 500.0, 1.0)


def test_without_a_local_action_it_only_stops(drive):
    made = drive(net(checks={"a": CHECK}), [10.0] * 6, agent_uds={"a": [101.0] * 6})
    assert [(type(d), d.frame) for d in made.decisions] == [(SelfStopped, 4)]


def test_a_good_frame_ends_the_episode(drive):
    made = drive(
        net(checks={"a": CHECK}),
        [10.0] * 7,
        agent_uds={"a": [101, 101, 101, 100, 101, 101, 101]},
        adaptable="a",
    )
    assert [d.attempt for d in made.of(LocallyAdapted)] == [1, 2, 3, 1, 2, 3]
    assert made.of(SelfStopped) == []


def test_a_streak_does_not_outlive_a_pause(drive):
    """Off after two bad frames, on again later: the next bad frames count from one."""
    adapt = on_off(on_frames=1, off_frames=2)
    made = drive(
        net(adapt, {"a": {**CHECK, "frames": 3}}),
        [100, 100, 300, 100, 300, 150, 150],
        kl={"a": 1.0},
        agent_uds={"a": [101] * 7},
    )
    assert (made.frames(Deactivated), made.frames(Activated)) == ([2], [3])
    assert made.frames(SelfStopped) == [6]


def test_no_agent_stops_itself_while_the_target_is_lost(drive):
    """What cannot be seen makes every agent unsure; the streak begins again when the target is found."""
    wide, narrow = [2000.0] * 8, [10.0] * 9
    rules = net(checks={"a": CHECK}, lost={"above": {"ud_px2": 1000.0}, "frames": 3})
    made = drive(rules, wide + narrow, agent_uds={"a": [500.0] * 17})
    lost, found = (d.frame for d in made.of(StatusChanged))
    assert (lost, found) == (3, 11)
    assert made.frames(SelfStopped) == [found + CHECK["frames"]]


def test_the_last_active_agent_does_not_stop_itself(drive):
    checks = dict.fromkeys("ab", CHECK)
    made = drive(net(checks=checks), [10.0] * 30, agent_uds=dict.fromkeys("ab", [500.0] * 30))
    assert [(d.frame, d.node) for d in made.of(SelfStopped)] == [(4, "a")]
    later = drive(
        net(on_off(on=50, on_frames=1, off=1), {"a": CHECK}),
        [10.0] * 8 + [60.0] * 4,
        active="a",
        agent_uds={"a": [500.0] * 12},
    )
    assert later.frames(Activated) == [9] and later.frames(SelfStopped) == [10]


def test_one_that_stopped_itself_is_not_dropped_as_well(drive):
    made = drive(
        net(on_off(off_frames=4), {"a": CHECK}, agents="abc"),
        [100.0] * 4,
        agent_uds={"a": [500.0] * 4},
        kl={"a": 9.0, "b": 0.1, "c": 0.2},
    )
    assert [(type(d), d.node) for d in made.decisions] == [(SelfStopped, "a"), (Deactivated, "c")]
    assert "a" not in made.of(Deactivated)[0].index


@pytest.mark.slow
@given(
    frames=st.integers(1, 12),
    rest=st.integers(1, 20),
    on_frames=st.integers(1, 4),
    length=st.integers(1, 400),
)
def test_an_agent_that_is_always_uncertain_does_not_oscillate(drive, frames, rest, on_frames, length):
    """m stops take at least rest (1 + 2 + ... + 2^(m-1)) frames, so m <= log2(T / rest + 1)."""
    check = {"above": {"ud_px2": 100.0}, "frames": frames, "rest": rest}
    made = drive(
        net(on_off(on=50.0, on_frames=on_frames, off=1.0), {"a": check}),
        [60.0] * length,
        agent_uds={"a": [500.0] * length},
    )
    assert len(made.of(Activated)) <= math.log2(length / rest + 1)
    for stop in made.of(SelfStopped):
        back = [n for n in made.frames(Activated, "a") if n > stop.frame]
        assert not back or back[0] + 1 >= stop.rests_until


# ------------------------------------------------------------------------------------ who may come back


def test_resting_and_quarantined_agents_stay_off(drive):
    start = TargetNet("plate", frozenset("a"), rests_until={"b": 8}, quarantined=frozenset("c"))
    made = drive(net(on_off(on_frames=1), agents="abcd"), [300.0] * 30, net=start)
    assert [(d.frame, d.node) for d in made.of(Activated)] == [(1, "d"), (7, "b")]


def test_with_no_agent_active_all_that_may_work_wake(drive):
    start = TargetNet("plate", frozenset(), rests_until={"b": 4}, quarantined=frozenset("c"))
    made = drive(net(agents="abcd"), [10.0] * 8, net=start)
    assert [(d.frame, d.node, d.cause, d.governor) for d in made.of(Activated)] == [
        (1, "a", None, "root"),
        (1, "d", None, "root"),
    ]
    resting = drive(
        net(agents="ab"),
        [10.0] * 8,
        net=TargetNet("plate", frozenset(), rests_until={"a": 6}, quarantined=frozenset("b")),
    )
    assert resting.frames(Activated) == [5]
    dead = drive(
        net(agents="ab"), [10.0] * 8, net=TargetNet("plate", frozenset(), quarantined=frozenset("ab"))
    )
    assert dead.of(Activated) == []


def test_no_level_is_named_for_agents_that_would_have_been_woken(drive):
    nobody = TargetNet("plate", frozenset(), rests_until={"a": 9, "b": 3})
    (woken,) = drive(net(on_off(on_frames=1)), [300.0] * 3, net=nobody).of(Activated)
    assert woken.cause is None
    assert explain(woken) == "frame 2: no agent was active → b on"
    (beside,) = drive(net(on_off(on_frames=1)), [300.0] * 3, active="a").of(Activated)
    assert beside.cause is not None


# ------------------------------------------------------------------------------------ lost and found

LOST = {"above": {"ud_px2": 100.0}, "fit_below": 0.05, "frames": 3}


@pytest.mark.parametrize(
    ("uds", "fits", "changes"),
    [
        ([101] * 3, [1.0] * 3, [(3, "lost")]),
        ([101, 101, 100, 101, 101], [1.0] * 5, []),
        ([10] * 3, [0.04] * 3, [(3, "lost")]),
        ([10] * 3, [0.05] * 3, []),
        ([101, 10, 101], [1.0, 0.01, 1.0], [(3, "lost")]),
        ([101] * 3 + [10] * 3, [1.0] * 6, [(3, "lost"), (6, "tracking")]),
        ([101] * 3 + [10, 10, 101, 10, 10, 10], [1.0] * 9, [(3, "lost"), (9, "tracking")]),
        ([101] * 3 + [10] * 6, [1.0] * 5 + [0.01] + [1.0] * 3, [(3, "lost"), (9, "tracking")]),
    ],
)
def test_lost_and_found_after_their_delay(drive, uds, fits, changes):
    made = drive(net(lost=LOST), uds, fits=fits)
    assert [(d.frame, d.status) for d in made.of(StatusChanged)] == changes


def test_lost_says_why(drive):
    (wide,) = drive(net(lost=LOST), [101, 130, 120]).of(StatusChanged)
    assert wide.cause == Cause("ud_px2", 100.0, 120.0, 3, 101.0, 120.0, 1.0) and wide.reason == ""
    (bad,) = drive(net(lost=LOST), [10] * 3, fits=[0.01, 0.03, 0.02]).of(StatusChanged)
    assert bad.cause == FitCause(0.05, 0.02, 3, 0.03)
    assert explain(bad) == (
        "frame 3: the best hypothesis has a fit of 0.02 (1: perfect) < fit_below 0.05 "
        "for 3 frames → target 1 lost; would not have been lost at fit_below ≤ 0.03"
    )
    (both,) = drive(net(lost=LOST), [500] * 3, fits=[0.01] * 3).of(StatusChanged)
    assert both.cause == FitCause(
        0.05, 0.01, 3, None
    )  # at no level of UD, and of the fit, would it have been kept
    assert explain(both).endswith("; would have been lost by its UD at any fit_below")
    (mixed,) = drive(net(lost=LOST), [10, 500, 400], fits=[0.01, 1.0, 1.0]).of(StatusChanged)
    assert mixed.cause.turning == 400.0
    (nobody,) = drive(
        net(lost=LOST),
        [10] * 3,
        fits=[0.0] * 3,
        net=TargetNet("plate", frozenset(), quarantined=frozenset("ab")),
    ).of(StatusChanged)
    assert nobody.reason == "no agent is active, so the belief is prediction only"


def test_found_says_why(drive):
    gone = TargetNet("plate", frozenset("ab"), status="lost")
    (found,) = drive(net(lost=LOST), [50, 70, 60], net=gone).of(StatusChanged)
    assert found.cause == Cause("ud_px2", 100.0, 60.0, 3, 70.0, 60.0, 1.0)
    assert explain(found) == (
        "frame 3: UD 60 px² ≤ 100 for 3 frames, and the best hypothesis has a fit of 1 "
        "(1: perfect) ≥ fit_below 0.05 → target 1 found again"
    )
    unknown = {**LOST, "above": {"ud_baseline": 3.0}}
    (found,) = drive(net(lost=unknown), [50] * 3, net=gone, fits=[0.5] * 3).of(StatusChanged)
    assert found.cause is None
    assert found.reason == "the best hypothesis has a fit of 0.5 (1: perfect) ≥ fit_below 0.05"


# ------------------------------------------------------------------------------------ turning

UDS = st.lists(st.integers(1, 12).map(float), min_size=8, max_size=25)
LEVELS = st.integers(4, 9).map(float)
UNITS = st.sampled_from(["ud_px2", "ud_box"])


@given(uds=UDS, level=LEVELS, frames=st.integers(1, 4), unit=UNITS, rest=st.integers(0, 12))
@example(uds=[9.0, 10.0, 10.0, 10.0, 10.0], level=8.0, frames=3, unit="ud_px2", rest=6)
def test_activation_turns_at_turning(drive, uds, level, frames, unit, rest):
    def run(at):
        adapt = {"activate": {"above": {unit: at}, "frames": frames}, "deactivate": {"below": {unit: 0.001}}}
        start = TargetNet("plate", frozenset("a"), rests_until={"b": rest})
        return drive(net(adapt), uds, net=start, areas=[2.0] * len(uds))

    made = run(level / 2 if unit == "ud_box" else level)
    if not made.of(Activated):
        return
    (decision,) = made.of(Activated)
    assert run(decision.cause.turning).frames(Activated)[:1] != [decision.frame]
    assert run(math.nextafter(decision.cause.turning, 0)).frames(Activated) == [decision.frame]


@given(uds=UDS, level=LEVELS, frames=st.integers(1, 4), unit=UNITS)
def test_deactivation_turns_at_turning(drive, uds, level, frames, unit):
    def run(at):
        adapt = {"deactivate": {"below": {unit: at}, "frames": frames}}
        return drive(net(adapt), uds, areas=[2.0] * len(uds)).of(Deactivated)

    made = run(level / 2 if unit == "ud_box" else level)
    if not made:
        return
    assert made[0].frame not in [d.frame for d in run(made[0].cause.turning)]
    assert run(math.nextafter(made[0].cause.turning, math.inf))[0].frame == made[0].frame


@pytest.mark.slow
@given(uds=UDS, level=LEVELS, frames=st.integers(1, 4), company=st.integers(1, 20))
def test_a_self_stop_turns_at_turning(drive, uds, level, frames, company):
    """Also when it had to wait for another agent to be there."""

    def run(at):
        check = {"above": {"ud_px2": at}, "frames": frames, "rest": 1000}
        adapt = on_off(on=50.0, on_frames=company, off=0.001)
        made = drive(
            net(adapt, {"a": check}), [60.0] * len(uds), active="a", agent_uds={"a": uds}, adaptable="a"
        )
        return made

    made = run(level)
    for tried in made.of(LocallyAdapted):
        assert tried.cause.turning == uds[tried.frame - 1] and tried.cause.frames == 1
    if not made.of(SelfStopped):
        return
    (stop,) = made.of(SelfStopped)
    assert stop.frame not in run(stop.cause.turning).frames(SelfStopped)
    assert run(math.nextafter(stop.cause.turning, 0)).frames(SelfStopped) == [stop.frame]


@given(data=st.data(), uds=UDS, level=LEVELS, frames=st.integers(1, 4), gone=st.booleans())
def test_a_change_of_status_turns_at_turning(drive, data, uds, level, frames, gone):
    fits = data.draw(st.lists(st.sampled_from([0.01, 1.0]), min_size=len(uds), max_size=len(uds)))
    start = TargetNet("plate", frozenset("ab"), status="lost" if gone else "tracking")

    def run(at):
        lost = {"above": {"ud_px2": at}, "fit_below": 0.05, "frames": frames}
        return drive(net(lost=lost), uds, fits=fits, net=start).of(StatusChanged)

    made = run(level)
    if not made or not isinstance(made[0].cause, Cause):
        return
    first = made[0]
    inside, outside = (0.0, math.inf) if first.status == "lost" else (math.inf, 0.0)
    again = run(math.nextafter(first.cause.turning, outside))
    assert (first.frame, first.status) not in [(d.frame, d.status) for d in again]
    kept = run(math.nextafter(first.cause.turning, inside))[0]
    assert (kept.frame, kept.status) == (first.frame, first.status)


@given(data=st.data(), uds=UDS, frames=st.integers(1, 4))
def test_a_loss_by_fit_turns_at_turning(drive, data, uds, frames):
    some = st.lists(st.sampled_from([0.01, 0.02, 0.04, 1.0]), min_size=len(uds), max_size=len(uds))
    fits = data.draw(some)

    def run(at):
        lost = {"above": {"ud_px2": 8.0}, "fit_below": at, "frames": frames}
        return [d for d in drive(net(lost=lost), uds, fits=fits).of(StatusChanged) if d.status == "lost"]

    made = run(0.05)[:1]
    if not made or not isinstance(made[0].cause, FitCause):
        return
    (first,), turning = made, made[0].cause.turning
    if turning is None:
        assert first.frame in [d.frame for d in run(0.0)]
        return
    assert first.frame not in [d.frame for d in run(turning)]
    assert run(math.nextafter(turning, 1.0))[0].frame == first.frame


@pytest.mark.slow
@given(seed=st.integers(0, 1000))
def test_any_sequence_keeps_the_promises_of_the_rules(drive, seed):
    """At least one agent of each node stays; nobody rests or is out and works; on and off alternate."""
    rng = np.random.default_rng(seed)
    length = 80
    checks = {agent: CHECK for agent in "abc" if rng.random() < 0.5}
    adapt = on_off(
        on_frames=int(rng.integers(1, 4)), off_frames=int(rng.integers(1, 6)), keep=int(rng.integers(1, 3))
    )
    uds = list(np.repeat(rng.choice([50.0, 150.0, 300.0], length // 4), 4))
    agent_uds = {agent: rng.choice([50.0, 500.0], length, p=[0.3, 0.7]) for agent in "abc"}
    made = drive(
        net(adapt, checks, agents="abc"),
        uds,
        agent_uds=agent_uds,
        kl=dict(zip("abc", rng.random(3), strict=True)),
    )
    for frame, live in enumerate(made.nets, 1):
        assert live.active
        assert all(live.rests_until.get(agent, 0) <= frame for agent in live.active)
    for agent in "abc":
        switches = [
            isinstance(d, Activated)
            for d in made.decisions
            if getattr(d, "node", None) == agent and not isinstance(d, LocallyAdapted)
        ]
        assert all(now != after for now, after in pairwise(switches))


def test_memory_is_immutable(drive, fakes):
    before = RuleMemory.empty(fakes.plate(net(on_off()))[0])
    drive(net(on_off()), [300.0] * 3, memory=before)
    assert not (before.counts.any() or before.values.any() or before.nats.any() or before.baselines)
