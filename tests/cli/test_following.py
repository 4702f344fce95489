"""A run is followed to its end: what is said then, and with which exit code."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

import pytest

from bayesnet_track.cli.following import SHOWN_NOTICES, follow
from bayesnet_track.journal.events.sources import FramesMissing
from bayesnet_track.runtime.results import Summary
from bayesnet_track.runtime.stop import StopRequest


@pytest.mark.parametrize(
    ("complete", "reason", "code"), [(True, "end_of_source", 0), (False, "source_truncated", 5)]
)
def test_the_exit_code_tells_whether_all_was_read(capsys, complete, reason, code):
    summary = Summary(12, 1, 0, complete, reason, 2.0, 0.0, [FramesMissing(n, 2.0) for n in range(7)])
    options = Namespace(quiet=True, log_json=False, stop=StopRequest())
    assert follow(options, (_ for _ in ()), summary, 12, Path("runs/a")) == code
    said = capsys.readouterr()
    assert "runs/a: 12 frames in 2.0 s (6 per second), 1 reconfiguration" in said.out + said.err
    assert ("the source is truncated" in said.out + said.err) == (not complete)
    assert f"... and {7 - SHOWN_NOTICES} more" in said.err
