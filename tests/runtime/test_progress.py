"""The progress line in its three forms, with the time passed in."""

import io
import json

import pytest

from bayesnet_track.runtime.pace import Progress


def run_of(seconds, rate, **settings):
    """What is written by a run of `rate` frames a second, up to but without the finish; and the progress."""
    stream = io.StringIO()
    progress = Progress(stream, **settings)
    for n in range(int(seconds * rate) + 1):
        progress.update(1000.0 + n / rate, n, ("color", "motion"), 212.4, "tracking")
    return stream, progress


def test_a_terminal_is_redrawn_at_most_ten_times_a_second():
    stream, _ = run_of(3.0, 128, total=1000, is_terminal=True)
    assert 25 <= stream.getvalue().count("\r") <= 30
    assert "\n" not in stream.getvalue()


def test_the_line_says_rate_time_left_agents_ud_and_status():
    stream, progress = run_of(4.0, 50, total=1000, is_terminal=True)
    progress.finish()
    # 800 frames are left at 50 a second.
    assert stream.getvalue().split("\r")[-1].rstrip() == (
        "frame 200/1000 | 50.0 fps | 0:16 left | color, motion | UD 212 px² | tracking"
    )


def test_the_frame_that_compiles_does_not_count():
    progress = Progress(io.StringIO(), 200, is_terminal=True)
    for now, done in ((0.0, 1), (22.0, 2)):
        progress.update(now, done, ("a",), 1.0, "tracking")
    assert progress.rate() is None
    progress.update(22.5, 3, ("a",), 1.0, "tracking")
    assert progress.rate() == 2.0


def test_a_shorter_line_covers_a_longer_one():
    stream = io.StringIO()
    progress = Progress(stream, None, is_terminal=True)
    progress.update(0.0, 1, ("a",), 1.0, "tracking")
    progress.update(1.0, 2, ("a_long_name", "another"), 123456.0, "tracking")
    progress.update(2.0, 3, (), 1.0, "lost")
    _, long, short = stream.getvalue().split("\r")
    assert len(short) == len(long)
    assert short.rstrip() == "frame 3 | 1.0 fps | none | UD 1 px² | lost"


def test_elsewhere_a_plain_line_comes_every_five_seconds():
    stream, _ = run_of(17.0, 8, total=1000, is_terminal=False)
    lines = stream.getvalue().splitlines()
    assert "\r" not in stream.getvalue()
    assert [line.split()[1] for line in lines] == ["40/1000", "80/1000", "120/1000"]


def test_json_lines():
    stream, progress = run_of(5.0, 4, total=100, is_terminal=True, log_json=True)
    progress.finish()
    (line,) = map(json.loads, stream.getvalue().splitlines())  # the last one once, though it was due
    assert line == {
        "progress": 20,
        "total": 100,
        "fps": 4.0,
        "left_s": 20.0,
        "active": ["color", "motion"],
        "ud_px2": 212.4,
        "status": "tracking",
    }


@pytest.mark.parametrize("ud_px2", [float("inf"), float("nan")])
def test_json_lines_hold_no_infinity(ud_px2):
    stream = io.StringIO()
    progress = Progress(stream, None, is_terminal=False, log_json=True)
    progress.update(0.0, 1, (), ud_px2, "lost")
    progress.finish()
    assert json.loads(stream.getvalue())["ud_px2"] is None


def test_the_rate_is_that_of_the_last_five_seconds():
    progress = Progress(io.StringIO(), None, is_terminal=True)
    for n in range(100):
        progress.update(n * 1.0, n, (), 0.0, "tracking")
    for n in range(1, 101):
        progress.update(99.0 + n * 0.1, 99 + n, (), 0.0, "tracking")
    assert progress.rate() == pytest.approx(10.0)


def test_finish_ends_the_line_and_shows_the_last_state():
    stream, progress = run_of(0.05, 100, total=10, is_terminal=True)
    assert stream.getvalue() == ""
    progress.finish()
    assert stream.getvalue().startswith("\rframe 5/10 ")
    assert stream.getvalue().endswith("\n")


def test_finish_without_frames_writes_nothing():
    stream = io.StringIO()
    Progress(stream, 5, is_terminal=True).finish()
    assert stream.getvalue() == ""


def test_hours_are_shown():
    stream, _ = run_of(5.0, 1, total=3727, is_terminal=False)
    assert "1:02:02 left" in stream.getvalue()


def test_a_clock_that_stands_still_gives_no_rate():
    stream = io.StringIO()
    progress = Progress(stream, 9, is_terminal=False)
    progress.update(1.0, 1, (), 0.0, "tracking")
    progress.update(1.0, 2, (), 0.0, "tracking")
    progress.finish()
    assert "| - fps |" in stream.getvalue()
