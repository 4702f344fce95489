"""Numbers in sentences tell a value from its level, and lines from elsewhere are checked."""

import pytest

from bayesnet_track.journal import disk
from bayesnet_track.journal.codec import JournalError
from bayesnet_track.journal.events.beliefs import MeasurementGated, Reappeared
from bayesnet_track.journal.events.faults import VerifierFailed
from bayesnet_track.journal.events.lives import TargetDied, TargetStarted
from bayesnet_track.journal.events.statuses import (
    AlarmEnded,
    AlarmRaised,
    AssuranceChanged,
    DistractorSeen,
    DoubtEnded,
    FoundAgain,
    Regained,
    StatusChanged,
)
from bayesnet_track.journal.events.switches import Activated, LocallyAdapted
from bayesnet_track.journal.reader import MOST, check_line
from bayesnet_track.journal.target_net import Cause
from bayesnet_track.journal.text.sentences import explain
from bayesnet_track.journal.text.story import describe_life
from bayesnet_track.journal.text.wording import distinct_texts, plural, round_away


@pytest.mark.parametrize(
    ("value", "level", "texts"),
    [
        (212.4, 200.0, ("212", "200")),
        (200.04, 200.0, ("200.04", "200")),
        (0.00123, 0.5, ("0.00123", "0.5")),
        (5.0, 5.0, ("5", "5")),
    ],
)
def test_a_value_is_told_from_its_level(value, level, texts):
    assert distinct_texts(value, level) == texts


@pytest.mark.parametrize("value", [0.1, 0.123456, 1.0, 2.999, 65.4321])
def test_the_turning_value_lies_on_the_side_where_the_rule_is_silent(value):
    for digits in range(5):
        above, below = (float(round_away(value, digits, up)) for up in (True, False))
        assert below <= value + 1e-8 and above >= value - 1e-8 and above - below <= 10.0**-digits + 1e-9


def test_nouns_are_counted():
    assert [plural(count, "frame") for count in (0, 1, 2, 1.5)] == [
        "0 frames",
        "1 frame",
        "2 frames",
        "1.5 frames",
    ]


BOX = (10.0, 10.0, 4.0, 4.0)


@pytest.mark.parametrize(
    ("event", "what"),
    [
        (TargetStarted(-1, "1", "square", BOX, ()), f"frame: -1 is not an integer from 0 to {MOST}"),
        (TargetStarted(MOST + 1, "1", "square", BOX, ()), "is not an integer"),
        (TargetStarted(0, "1", "square", BOX[:3], ()), "box: .* is not four numbers"),
    ],
)
def test_a_line_that_no_run_writes_is_refused(event, what):
    check_line(TargetStarted(0, "1", "square", BOX, ()))
    with pytest.raises(JournalError, match=what):
        check_line(event)


def test_the_life_of_a_target_is_a_line_a_chapter():
    started = TargetStarted(0, "1", "square", BOX, ("color",))
    other = TargetStarted(3, "2", "square", BOX, ())
    died = TargetDied(40, "1", "lost", 30, 30, False)
    first, second, summary = describe_life([started, other, died], [], "1").splitlines()
    assert "target 1 starts as square" in first and "target 1 ends" in second
    assert summary == "summary: 0 frames, lost in 0; ended"
    with pytest.raises(ValueError, match=r"no target '3' in this run; there are 1, 2"):
        describe_life([started, other], [], "3")


def test_the_life_of_a_target_has_what_explains_its_statuses():
    why = [
        DistractorSeen(*(5, "1", 90.0, 80.0, 1.6, 1.37, 4.0, 0.9, 250)),
        DoubtEnded(9, "1", 0.557, 1.55, 0.5, 244),
        AssuranceChanged(11, "1", False, 0.5, 0.6, 3, 0.05),
        AlarmRaised(12, "1", 21.0, 0.05, 10, 25),
        AlarmEnded(14, "1"),
        FoundAgain(20, "1", 0.82, 0.4, 0.25, 3, 0.53, 15, 31.4),
        Regained(21, "1", 3, 0.675, 0.55, 0.55, 0.573, 0.004, 0.05, 0.0081, 0.024, 0.05, 15),
        Reappeared(*(21, "1", "agents", 9, 0.93, 0.5, 0.1, 0.008, 210.4, 84.2, 95.2, 5120.0, 1024.0)),
        VerifierFailed(22, "1", "texture", "raised ValueError"),
    ]
    started = TargetStarted(0, "1", "square", BOX, ("color",))
    lines = describe_life([started, *why, StatusChanged(23, "1", "lost")], [], "1").splitlines()
    assert lines[1:-2] == [explain(event) for event in why]


def test_what_happened_often_is_counted_in_the_life_of_a_target():
    started = TargetStarted(0, "1", "square", BOX, ("color",))
    gated = [MeasurementGated(frame, "1", "detector", 31.5, 9.2, 0.99, 2, 0.999, 0) for frame in (3, 5)]
    off = Activated(4, "1", "motion", "square", None)
    adapted = LocallyAdapted(8, "1", "hue", 1, Cause("ud_px2", 2500, 2731, 1, 2731, 2731, 1))
    _, condensed, _ = describe_life([started, *gated, off, adapted], [], "1").splitlines()
    assert condensed == (
        "frames 3 to 8: motion on at 4; measurement_gated 2 times; hue adapted itself 1 time"
    )


def test_data_is_written_whole_however_little_the_system_takes():
    class Slow:
        taken = b""

        def write(self, data):
            self.taken += bytes(data[:3])
            return min(len(data), 3)

    file = Slow()
    disk.write_whole(file, b"0123456789")
    assert file.taken == b"0123456789"


def test_a_name_that_is_too_long_is_an_error_and_a_missing_one_is_not(tmp_path):
    assert disk.is_there(tmp_path) and not disk.is_there(tmp_path / "none")
    (tmp_path / "file").touch()
    assert not disk.is_there(tmp_path / "file" / "below")
    with pytest.raises(OSError, match="too long"):
        disk.is_there(tmp_path / ("x" * 300))
