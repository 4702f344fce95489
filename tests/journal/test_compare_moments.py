"""Decisions of two runs are matched by what they change, within some frames."""

from __future__ import annotations

from bayesnet_track.journal.compare import SHIFT, Moment, find_moments
from bayesnet_track.journal.events.lives import TargetDied, TargetStarted


def died(frame, target):
    return TargetDied(frame, target, "lost", 30, 30, False)


def test_equal_ones_agree_late_ones_are_one_moment_and_later_ones_two():
    first = [died(5, "1"), died(9, "2"), died(20, "3")]
    second = [died(5, "1"), died(9 + SHIFT, "2"), died(21 + SHIFT, "3")]
    pairs = [(name, name) for name in "123"]
    agreed, moments = find_moments(first, second, pairs)
    assert agreed == 1
    assert moments == (
        Moment(9, ("2", "2"), "", (first[1],), (second[1],)),
        Moment(20, ("3", "3"), "", (first[2],), ()),
        Moment(21 + SHIFT, ("3", "3"), "", (), (second[2],)),
    )


def test_a_target_that_one_run_does_not_have_stands_alone():
    agreed, moments = find_moments([died(5, "1")], [], [])
    assert agreed == 0 and [(one.pair, one.target) for one in moments] == [(("1", ""), "1")]


def test_the_name_of_a_type_parts_two_runs_only_where_one_has_several_types():
    box = (9.0, 9.0, 4.0, 4.0)
    car, target = (TargetStarted(0, "1", name, box, ("color",)) for name in ("car", "target"))
    assert find_moments([car], [target], [("1", "1")]) == (1, ())
    other = TargetStarted(0, "2", "person", box, ("color",))
    agreed, moments = find_moments([car, other], [target, other], [("1", "1"), ("2", "2")])
    assert agreed == 1 and [one.pair for one in moments] == [("1", "1")]
