"""An agent that fails stays out for 10 frames, twice as long with each failure in a row, 1280 at most."""

import pytest

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.rule_inputs import Measures, RuleInputs
from bayesnet_track.adapt.rules import MISSED_FRAMES, give_up_on_missing, readmit
from bayesnet_track.adapt.status import next_try, quarantine
from bayesnet_track.journal.events.faults import Readmitted
from bayesnet_track.journal.target_net import Fault, TargetNet

OUT = TargetNet(
    "plate",
    frozenset("c"),
    quarantined=frozenset("ab"),
    faults={"a": Fault(3, 5, 20, True), "c": Fault(1, 1, 11, True)},
)
NOTHING = Measures({}, {}, {}, {}, {}, 0.0, 400.0)


@pytest.fixture
def now(fakes):
    """The situation of a target with agents a, b and c in a frame."""

    def make(frame, net=OUT, missed=None):
        plate, _ = fakes.plate({"root": {"fuse": "product"}, "a": "root", "b": "root", "c": "root"})
        return RuleInputs(frame, "7", plate, net, NOTHING, {}, frozenset(), missed=missed or {})

    return make


def test_waits_double_up_to_a_limit():
    waits, fault, frame = [], None, 100
    for _ in range(10):
        until, times = next_try(frame, fault)
        waits.append(until - frame)
        fault, frame = Fault(times, frame, until, True), until
    assert waits == [10, 20, 40, 80, 160, 320, 640, 1280, 1280, 1280]
    assert times == 10
    assert next_try(50, Fault(5000, 10, 40, True)) == (50 + 1280, 5001)


def test_an_agent_that_worked_ten_times_as_long_as_it_was_out_has_not_failed_in_a_row():
    fault = Fault(2, 100, 120, True)  # out for 20 frames
    assert next_try(319, fault) == (319 + 40, 3)
    assert next_try(320, fault) == (320 + 10, 1)
    assert next_try(320, Fault(2, 100, None, True)) == (330, 1)


def test_the_decision_names_the_agent_and_the_reason():
    one = quarantine(OUT, 25, "7", "a", "raised")
    assert (one.frame, one.target, one.node, one.reason, one.until, one.times) == (
        25,
        "7",
        "a",
        "raised",
        105,
        4,
    )
    two = quarantine(OUT, 25, "7", "b", "hung")
    assert (two.until, two.times) == (35, 1)


def test_it_is_back_in_the_first_frame_after_its_time(now):
    assert readmit(now(18)) == []
    assert readmit(now(19)) == [Readmitted(19, "7", "a", True, 3, 15)]


def test_a_person_has_the_last_word_and_some_never_come_back(now):
    assert readmit(now(19, TargetNet(**{**vars(OUT), "by_hand": {"a": False}})))[0].on is False
    was_off = TargetNet(**{**vars(OUT), "faults": {"a": Fault(1, 5, 15, False)}})
    assert readmit(now(19, was_off))[0].on is False
    for_good = TargetNet(**{**vars(OUT), "faults": {"a": Fault(1, 5, None, True)}})
    assert readmit(now(1000, for_good)) == []


def test_the_order_is_that_of_the_plate(now):
    both = TargetNet(**{**vars(OUT), "faults": {"b": Fault(1, 5, 15, True), "a": Fault(1, 6, 16, True)}})
    assert [one.node for one in readmit(now(40, both))] == ["a", "b"]


def test_three_frames_in_a_row_without_an_answer(now):
    decisions, memory = [], RuleMemory.empty(now(1).plate)

    def count(missed):
        return memory if missed is None else memory.replaced(0, (), missed)

    live = TargetNet("plate", frozenset("abc"))
    for frame in range(1, MISSED_FRAMES):
        memory = count(give_up_on_missing(now(frame, live, {"a": "late"}), memory, decisions))
        assert memory.missed.tolist() == [[frame, 0, 0]] and decisions == []
    memory = count(give_up_on_missing(now(3, live, {"a": "gone", "b": "late"}), memory, decisions))
    assert memory.missed.tolist() == [[0, 1, 0]]
    (one,) = decisions
    assert (one.frame, one.target, one.node, one.until) == (3, "7", "a", 13)
    assert one.reason == "gave no answer in 3 frames in a row, the last time: gone"
    memory = count(give_up_on_missing(now(4, live), memory, decisions))
    assert not memory.missed.any() and len(decisions) == 1
    assert give_up_on_missing(now(5, live), memory, decisions) is None
