"""The page of a long run: fewer rows, but no peak and no decision is missing; counts are of all frames."""

from dataclasses import replace

import numpy as np
import pytest

from bayesnet_track.journal.events.runs import RunStarted
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.view import page_tables
from bayesnet_track.view.page_data import run_data

STARTED = RunStarted(1, "g", "0" * 64, 0, "video.mp4", 64, 48, True, 3, 0.04)


@pytest.fixture
def long_run(metrics, monkeypatch):
    """400 frames of two targets with a peak of UD each, of which a page may hold about 80 rows."""
    monkeypatch.setattr(page_tables, "MOST_ROWS", 80)
    lines = [
        replace(
            metrics,
            frame=frame,
            target=target,
            ud_px2=500.0 if frame == peak else 10.0 + frame % 3,
            status="lost" if 203 <= frame < 303 else "tracking",
            active=("color", "motion") if frame < 100 else ("color",),
            cloud=(),
        )
        for frame in range(400)
        for target, peak in (("1", 77), ("2", 333))
    ]
    return [STARTED, StatusChanged(203, "1", "lost", None, "made up")], lines


def test_a_long_run_keeps_peaks_decisions_and_exact_counts(long_run):
    header, columns = run_data(*long_run)
    about = header["thinned"]
    assert (about["of"], about["frames"], about["step"], about["decisions"]) == (800, 400, 20, 1)
    assert about["rows"] == len(columns["0/frame"]) + len(columns["1/frame"]) <= 100
    for number, peak in ((0, 77), (1, 333)):
        frames = columns[f"{number}/frame"]
        assert {0, 20, 380, 399, peak} <= {*frames.tolist()} and (np.diff(frames) > 0).all()
        assert columns[f"{number}/ud_px2"][frames == peak] == 500.0
        assert columns[f"{number}/status"][frames == 220] == 2
        counted = header["targets"][number]["counted"]
        assert counted == {
            "frames": 400,
            "lost": 100,
            "uncertain": 0,
            "active": {"color": 400, "motion": 100},
        }
    assert 203 in columns["0/frame"] and 203 not in columns["1/frame"]


def test_a_run_that_fits_is_shown_whole(long_run, monkeypatch):
    monkeypatch.setattr(page_tables, "MOST_ROWS", 800)
    header, columns = run_data(*long_run)
    assert header["thinned"] is None and len(columns["0/frame"]) == 400
    assert "counted" not in header["targets"][0]


def test_where_nearly_every_row_has_a_decision_some_of_them_are_shown(long_run):
    events, lines = long_run
    changes = [StatusChanged(line.frame, line.target, "lost", None, "made up") for line in lines]
    header, _ = run_data([events[0], *changes], lines)
    assert header["thinned"]["decisions"] == 40 and header["thinned"]["rows"] <= 120
