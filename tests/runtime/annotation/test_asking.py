"""Which boxes answers give, and what is asked next: with made-up runs instead of a tracker."""

from dataclasses import dataclass

import pytest

from bayesnet_track.runtime.annotation.answers import (
    UNDO,
    Answer,
    AnswerError,
    in_force,
    read_answer,
)
from bayesnet_track.runtime.annotation.asking import Asking, BoxMark, TrackedBox, annotate_video, fuse, iou
from bayesnet_track.runtime.annotation.session import by_target

START = (10.0, 10.0, 20.0, 20.0)


def true_box(frame):
    return (10.0 + 2 * frame, 10.0, 20.0, 20.0)


@dataclass
class MadeUp:
    """Finds the true box for `good` frames from an answer on, then one far away, with little probability."""

    good: int
    sure: float = 0.9
    unsure: float = 0.2
    asked: int = 0

    def at(self, start, box, frame):
        self.asked += 1
        is_good = abs(frame - start) <= self.good
        found = true_box(frame) if is_good else (500.0, 400.0, 20.0, 20.0)
        return TrackedBox(found, self.sure if is_good else self.unsure, (1.0, 2.0), "tracking")


def answered(*answers):
    return by_target(answers)


def box(frame, target="ball 1"):
    return Answer("box", frame, target, true_box(frame))


def test_it_runs_ahead_to_the_first_doubtful_frame_and_says_why():
    done = annotate_video(answered(box(0)), MadeUp(good=7), 100, Asking(0.5, 1))
    (question,) = done.questions
    assert (question.target, question.frame) == ("ball 1", 8)
    assert "0.20 < 0.50" in question.reason and "8 frames after" in question.reason
    marks = done.marks["ball 1"]
    assert [marks[n].how for n in range(9)] == ["given"] + ["tracked"] * 8
    assert max(marks) == 8


def test_patience_waits_for_doubt_that_stays_and_asks_at_the_end_of_the_video():
    runs = MadeUp(good=7)
    assert annotate_video(answered(box(0)), runs, 100, Asking(0.5, 4)).questions[0].frame == 11
    assert annotate_video(answered(box(0)), runs, 10, Asking(0.5, 4)).questions[0].frame == 9


def test_a_box_is_explained_backward_so_that_nobody_is_asked_about_what_lies_between():
    done = annotate_video(answered(box(0), box(12)), MadeUp(good=7), 13, Asking(0.5))
    assert done.questions == ()
    marks = done.marks["ball 1"]
    assert all(iou(marks[n].box, true_box(n)) > 0.99 for n in range(13))
    assert marks[12].how == "given" and marks[9].how == "tracked"


def test_the_last_frame_is_asked_about_since_only_a_run_back_from_it_shows_a_sure_run_that_is_wrong():
    runs = MadeUp(good=7, unsure=0.95)  # it never doubts
    asked = annotate_video(answered(box(0)), runs, 21, Asking(0.8)).questions
    assert [one.frame for one in asked] == [20] and "the last frame" in asked[0].reason
    between = annotate_video(answered(box(0), box(20)), runs, 21, Asking(0.8))
    assert len(between.questions) == 1, "the two runs differ: one of them is wrong"
    assert annotate_video(answered(box(0)), runs, 1, Asking(0.8)).questions == ()


def test_a_gap_that_neither_run_bridges_is_asked_about_in_its_middle():
    done = annotate_video(answered(box(0), box(40)), MadeUp(good=7, unsure=0.05), 41, Asking(0.5))
    (question,) = done.questions
    assert question.frame == 20
    assert "frame 0" in question.reason and "frame 40" in question.reason


def test_what_is_gone_is_gone_until_a_box_says_otherwise():
    done = annotate_video(answered(box(0), Answer("gone", 3, "ball 1"), box(6)), MadeUp(good=50), 9)
    hows = [done.marks["ball 1"][n].how for n in range(9)]
    assert hows == ["given", "tracked", "tracked", "gone", "gone", "gone", "given", "tracked", "tracked"]
    assert done.marks["ball 1"][4].box is None
    last = annotate_video(answered(box(0), Answer("gone", 3, "ball 1")), MadeUp(good=50), 5)
    assert [last.marks["ball 1"][n].how for n in (3, 4)] == ["gone", "gone"] and last.questions == ()


def test_several_targets_are_asked_about_one_by_one():
    done = annotate_video(answered(box(0), box(3, "ball 2")), MadeUp(good=7), 100, Asking(0.5, 1))
    assert [(one.target, one.frame) for one in done.questions] == [("ball 1", 8), ("ball 2", 11)]


def test_two_runs_that_agree_are_surer_than_each_and_two_that_differ_less():
    def found(p, at=START):
        return TrackedBox(at, p, (1.0, 1.0), "tracking")

    far = (300.0, 10.0, 20.0, 20.0)
    line = (50.0, 50.0, 20.0, 20.0)
    assert fuse(3, found(0.8), found(0.7), line).probability == pytest.approx(0.56 / (0.56 + 0.1 * 0.06))
    apart = fuse(3, found(0.9), found(0.4, far), line)
    assert apart.box == START and apart.probability == pytest.approx(0.54 / (0.54 + 0.04 + 0.06))
    unclear = fuse(3, found(0.9), found(0.9, far), line)
    assert unclear == BoxMark(3, line, "interpolated", pytest.approx(0.09 / 0.19))
    moved = (14.0, 10.0, 20.0, 20.0)
    assert fuse(3, found(0.6), found(0.2, moved), line).box[0] == pytest.approx(11.0)
    assert fuse(3, found(0.0), found(0.0), line).how == "tracked"


def test_undo_takes_back_the_newest_and_the_last_answer_of_a_frame_counts():
    first, second, third = box(0), box(5), Answer("gone", 5, "ball 1")
    assert in_force([first, second, UNDO, third]) == (first, third)
    assert in_force([UNDO, first, UNDO, UNDO]) == ()
    assert by_target([second, first, third]) == {"ball 1": (first, third)}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"kind": "maybe"}, "one of box"),
        ({"kind": "gone", "frame": 10, "target": "a"}, "frames 0 to 9"),
        ({"kind": "gone", "frame": True, "target": "a"}, "frames 0 to 9"),
        ({"kind": "gone", "frame": 1, "target": " "}, "needs a name"),
        ({"kind": "gone", "frame": 1, "target": "a\nb"}, "on one line"),
        ({"kind": "box", "frame": 1, "target": "a", "box": [1, 2, 3]}, "four numbers"),
        ({"kind": "box", "frame": 1, "target": "a", "box": [1, 2, 0, 3]}, "above 0"),
        ({"kind": "box", "frame": 1, "target": "a", "box": [1, 2, float("nan"), 3]}, "above 0"),
        ({"kind": "box", "frame": 1, "target": "a", "box": [10**400, 2, 2, 3]}, "numbers of px"),
        ({"kind": "box", "frame": 1, "target": "a", "box": [64, 2, 2, 3]}, "outside of the frame of 64x48"),
    ],
)
def test_an_answer_that_is_none_of_the_video_is_refused(given, said):
    with pytest.raises(AnswerError, match=said):
        read_answer(given, 10, 64, 48)
