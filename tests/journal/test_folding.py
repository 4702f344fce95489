"""Runs of agents on call are one line of the log, which other events of the target end."""

from __future__ import annotations

from dataclasses import replace

from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.events.switches import Activated, Scheduled
from bayesnet_track.journal.target_net import Cause
from bayesnet_track.journal.text.sentences import explain
from bayesnet_track.journal.text.story import CallsFolded, describe_life, fold, narrate_all
from bayesnet_track.view.page_tables import event_rows

UD = Cause("ud_px2", 60.0, 81.2, 1, 81.2, 81.2, 1.0)


def ran(frame, gap, overlap=0.9, called=None, target="1"):
    return Scheduled(frame, target, ("net",), "t", overlap, 0.6, gap, frame + gap, frame + 1, called)


RUNS = [ran(1, 2), ran(3, 3), ran(6, 1, 0.41), ran(9, 2), ran(10, 3, called=UD)]


def test_boxes_that_lie_apart_need_a_smaller_agree_than_there_is():
    (line,) = narrate_all([ran(1, 2), ran(3, 1, 0.0)], {}, False)
    assert line.endswith("overlap by 0.00 to 0.90, in 1 of 2 below 0.6")


def test_runs_in_a_row_are_one_line():
    (line,) = narrate_all(RUNS, {"1": "ball"}, True)
    assert line == (
        "frames 1 to 10, ball 1: net on call, ran in 7 of 10; with and without it the boxes overlap by 0.41 "
        "to 0.90, in 1 of 5 below 0.6; 1 time at once, would always have waited at above ≥ 81.2; would have "
        "rested each time at agree ≤ 0.41"
    )


def test_agents_are_named_once_and_rest_by_agreement_only_where_that_is_all():
    pair = replace(RUNS[0], nodes=("net", "flow"))
    (line,) = narrate_all([pair, RUNS[1], replace(RUNS[2], doubt=UD)], {"1": "ball"}, False)
    assert line == (
        "frames 1 to 6: net, flow on call, ran in 3 of 6; with and without them the boxes overlap by 0.41 "
        "to 0.90, in 1 of 3 below 0.6"
    )


def test_all_that_keeps_them_from_resting_is_told():
    doubted = replace(RUNS[2], doubt=UD)
    assert explain(doubted).endswith("would have rested at agree ≤ 0.41 and above ≥ 81.2")
    assert explain(replace(doubted, status="lost")).endswith(
        "; the target is lost → net in every frame; would have rested while not lost, at agree ≤ 0.41 and "
        "above ≥ 81.2"
    )


def test_another_event_of_the_target_ends_a_fold_and_of_another_target_does_not():
    on = Activated(4, "1", "color", "t", None)
    assert [type(one) for one in fold([*RUNS[:2], on, *RUNS[2:]])] == [CallsFolded, Activated, CallsFolded]
    others = Activated(4, "2", "color", "t", None)
    assert [type(one) for one in fold([*RUNS[:2], others, *RUNS[2:]])] == [CallsFolded, Activated]
    assert fold([RUNS[0], on, RUNS[2]]) == [RUNS[0], on, RUNS[2]]


def test_targets_are_told_apart():
    folded = fold([ran(1, 2), ran(1, 2, target="2"), ran(3, 3), ran(3, 3, target="2")])
    assert [one.target for one in folded] == ["1", "2"]


def test_each_sentence():
    assert explain(RUNS[0]) == (
        "frame 1: with and without net the boxes overlap by 0.9 ≥ 0.6 → net again in 2 frames, frame 3; "
        "would have run in the next one at agree > 0.9"
    )
    assert explain(RUNS[2]) == (
        "frame 6: with and without net the boxes overlap by 0.41 < 0.6 → net in every frame; "
        "would have rested at agree ≤ 0.41"
    )
    assert explain(RUNS[4]) == (
        "frame 10: without net UD 81.2 px² > 60 for 1 frame; with and without net the boxes overlap by "
        "0.9 ≥ 0.6 → net at once, not in frame 11, and again in 3 frames, frame 13; "
        "would have waited at above ≥ 81.2"
    )
    assert explain(replace(RUNS[2], overlap=0.9, doubt=UD)) == (
        "frame 6: with and without net the boxes overlap by 0.9 ≥ 0.6; UD 81.2 px² > 60 for 1 frame with net "
        "→ net in every frame; would have rested at above ≥ 81.2"
    )
    assert explain(replace(RUNS[2], overlap=0.9, status="lost")).endswith(
        "≥ 0.6; the target is lost → net in every frame; would have rested while not lost"
    )


def test_the_page_has_one_row_for_them_and_knows_what_would_have_prevented_a_single_one():
    (row,) = event_rows(RUNS)
    assert row["frame"] == 1 and row["sort"] == "note" and "ran in 7 of 10" in row["what"]
    (alone,) = event_rows(RUNS[4:])
    assert alone["unless"] == "would have waited at above ≥ 81.2"
    assert alone["what"] == "net at once, not in frame 11, and again in 3 frames, frame 13"


def test_the_story_of_a_target_has_one_line_for_them_between_two_chapters():
    born = TargetStarted(0, "1", "ball", (1.0, 1.0, 9.0, 9.0), ("net", "color"))
    lines = describe_life([born, *RUNS], [], "1").splitlines()
    assert len(lines) == 3 and lines[1].startswith("frames 1 to 10: net on call, ran in 7 of 10; ")
