"""The live net: decisions are applied purely, and folding them gives the net of any frame."""

from __future__ import annotations

import copy

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.journal.events.faults import Quarantined, Readmitted
from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.events.load import Released, Toggled
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.events.switches import Activated, Deactivated, LocallyAdapted, SelfStopped
from bayesnet_track.journal.net import Net, apply, replay
from bayesnet_track.journal.target_net import Cause, Fault, TargetNet

CAUSE = Cause("ud_px2", 200.0, 212.0, 3, 210.0, 212.0, 1.0)
BOX = (10.0, 20.0, 5.0, 6.0)


def started(frame=0, target="1", active=("a", "b")):
    return TargetStarted(frame, target, "plate", BOX, active)


START = apply(Net(), started())

CHANGES = [
    (Activated(3, "1", "c", "root", CAUSE), {"active": frozenset("abc")}),
    (Deactivated(3, "1", "a", "root", CAUSE, "largest_kl"), {"active": frozenset("b")}),
    (
        SelfStopped(3, "1", "a", CAUSE, 12),
        {"active": frozenset("b"), "rests_until": {"a": 12}, "rest_count": {"a": 1}},
    ),
    (
        Quarantined(3, "1", "a", "raised", 13),
        {"active": frozenset("b"), "quarantined": frozenset("a"), "faults": {"a": Fault(1, 3, 13, True)}},
    ),
    (
        Quarantined(3, "1", "z", "raised", None, 2),
        {"quarantined": frozenset("z"), "faults": {"z": Fault(2, 3, None, False)}},
    ),
    (Readmitted(9, "1", "z", True, 1, 10), {"active": frozenset("abz")}),
    (Toggled(3, "1", "a", False), {"active": frozenset("b"), "by_hand": {"a": False}}),
    (Released(3, "1", "a"), {}),
    (StatusChanged(3, "1", "lost", CAUSE), {"status": "lost"}),
    (LocallyAdapted(3, "1", "a", 1, CAUSE), {}),
]


def as_dict(net):
    return {
        name: (
            *(n.template, n.active, dict(n.rests_until), dict(n.rest_count), n.quarantined, n.status),
            *(dict(n.by_hand), dict(n.faults)),
        )
        for name, n in net.targets.items()
    }


@pytest.mark.parametrize(("decision", "changed"), CHANGES)
def test_what_each_decision_changes_and_nothing_else(decision, changed):
    before = as_dict(START)
    expected = TargetNet(**{"template": "plate", "active": frozenset("ab"), **changed})
    after = apply(START, decision)
    assert as_dict(after) == as_dict(Net({"1": expected}))
    assert as_dict(START) == before


def test_rests_are_counted():
    net = apply(apply(START, SelfStopped(3, "1", "a", CAUSE, 12)), Activated(11, "1", "a", "root", None))
    net = apply(net, SelfStopped(15, "1", "a", CAUSE, 40)).targets["1"]
    assert (dict(net.rest_count), dict(net.rests_until)) == ({"a": 2}, {"a": 40})


def test_other_targets_are_untouched():
    net = apply(apply(START, started(1, "2", ("b",))), Quarantined(3, "1", "a", "raised"))
    assert net.targets["2"] == TargetNet("plate", frozenset("b"))


def test_a_net_cannot_be_written_into():
    with pytest.raises(TypeError):
        START.targets["2"] = START.targets["1"]
    with pytest.raises(AttributeError):
        START.targets["1"].active = frozenset()


def test_a_decision_for_a_target_that_is_not_alive():
    with pytest.raises(KeyError, match="9"):
        apply(START, StatusChanged(3, "9", "lost"))


def test_replay_gives_the_net_that_a_frame_began_with():
    decisions = [
        started(0),
        Deactivated(4, "1", "a", "root", CAUSE, "largest_kl"),
        started(4, "2"),
        Activated(9, "1", "a", "root", CAUSE),
        started(20, "3"),
    ]

    def active(frame):
        return {name: "".join(sorted(net.active)) for name, net in replay(decisions, frame).targets.items()}

    assert active(0) == {"1": "ab"}
    assert active(3) == {"1": "ab"}
    assert active(4) == {"1": "ab", "2": "ab"}  # decided in 4, works from 5; the start counts at once
    assert active(5) == {"1": "b", "2": "ab"}
    assert active(9) == {"1": "b", "2": "ab"}
    assert active(10) == active(19) == {"1": "ab", "2": "ab"}
    assert active(20) == active(1000) == {"1": "ab", "2": "ab", "3": "ab"}
    assert as_dict(replay(decisions)) == as_dict(replay(decisions, 21))
    assert as_dict(replay([])) == {}
    assert as_dict(replay(iter(decisions), 10)) == as_dict(replay(decisions, 10))


@st.composite
def histories(draw):
    """Decisions in the order of their frames, for up to three targets."""
    decisions, frame = [started(0, "1")], 0
    alive = ["1"]
    for _ in range(draw(st.integers(0, 25))):
        frame += draw(st.integers(0, 3))
        target, node = draw(st.sampled_from(alive)), draw(st.sampled_from("abc"))
        kind = draw(st.integers(0, 6))
        if kind == 6 and len(alive) < 3:
            alive.append(str(len(alive) + 1))
            decisions.append(started(frame, alive[-1]))
            continue
        decisions.append(
            [
                Activated(frame, target, node, "root", CAUSE),
                Deactivated(frame, target, node, "root", CAUSE, "largest_kl"),
                SelfStopped(frame, target, node, CAUSE, frame + 5),
                Quarantined(frame, target, node, "raised"),
                StatusChanged(frame, target, "lost", CAUSE),
                LocallyAdapted(frame, target, node, 1, CAUSE),
            ][kind % 6]
        )
    return decisions


@given(histories())
def test_replay_is_the_fold_of_apply_at_every_frame(decisions):
    copies = copy.deepcopy(decisions)
    for frame in range(decisions[-1].frame + 2):
        net = Net()
        for decision in decisions:
            if decision.frame < frame:
                net = apply(net, decision)
        for decision in decisions:
            if decision.frame == frame and isinstance(decision, TargetStarted):
                net = apply(net, decision)
        assert as_dict(replay(decisions, frame)) == as_dict(net)
    assert decisions == copies
