"""A run is followed to its end: what is said then, and with which exit code."""

from __future__ import annotations

import gc
from argparse import Namespace
from pathlib import Path

import pytest

from bayesnet_track.cli.following import SHOWN_NOTICES, as_sentence, follow_run, say_end, say_next
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.journal.events.runs import FramesMissing
from bayesnet_track.runtime.results import Summary
from bayesnet_track.runtime.stop import StopRequest


@pytest.mark.parametrize(
    ("complete", "reason", "code"), [(True, "end_of_source", 0), (False, "source_truncated", 5)]
)
def test_the_exit_code_tells_whether_all_was_read(capsys, complete, reason, code):
    summary = Summary(12, 1, 0, complete, reason, 2.0, 0.0, 30.0, [FramesMissing(n, 2.0) for n in range(7)])
    options = Namespace(command="run", quiet=False, verbose=False, log_json=False, stop=StopRequest())
    assert follow_run(options, (_ for _ in ()), summary, 12, Path("runs/a")) == code
    said = capsys.readouterr()
    assert (
        "runs/a: 12 frames in 2.0 s (30 frames per second after the first), 1 reconfiguration"
        in said.out + said.err
    )
    assert ("the source is truncated" in said.out + said.err) == (not complete)
    assert f"... and {7 - SHOWN_NOTICES} more" in said.err


@pytest.mark.parametrize("owns_process", [False, True])
def test_only_a_process_of_its_own_keeps_what_is_loaded_from_the_garbage_collector(monkeypatch, owns_process):
    frozen = []
    monkeypatch.setattr(gc, "freeze", lambda: frozen.append(1))
    monkeypatch.setattr(gc, "collect", lambda: None)
    options = Namespace(command="demo", quiet=True, verbose=False, log_json=False, stop=StopRequest())
    options.owns_process = owns_process
    summary = Summary(3, 0, 0, True, "end_of_source", 2.0, 0.0, 30.0, [])
    assert follow_run(options, (None for _ in range(3)), summary, 3, Path("runs/a")) == 0
    assert len(frozen) == owns_process  # once, not in every frame


@pytest.mark.parametrize(
    ("reason", "has_checkpoint", "message"),
    [
        ("end_of_source", False, "next: `bayesnet-track report {out} --open` shows the run in a browser; "),
        (
            "interrupted",
            True,
            "next: `bayesnet-track resume {out}` goes on from here; `bayesnet",
        ),
        ("interrupted", False, "next: `bayesnet-track report {out} --open` shows what there is"),
    ],
)
def test_the_next_useful_command_is_named(capsys, tmp_path, reason, has_checkpoint, message):
    if has_checkpoint:
        (tmp_path / "checkpoint").touch()
    summary = Summary(12, 1, 0, reason == "end_of_source", reason)
    say_next(Namespace(quiet=False, log_json=False, json=False), tmp_path, summary)
    assert capsys.readouterr().err.startswith(message.format(out=tmp_path))
    for option in ("quiet", "log_json", "json"):
        silent = Namespace(**{"quiet": False, "log_json": False, "json": False, option: True})
        say_next(silent, tmp_path, summary)
    assert capsys.readouterr() == ("", "")


def test_an_agent_that_failed_is_reported_at_the_end(capsys):
    failed = Quarantined(1, "1", "glance", "raised ValueError: no", 11)
    summary = Summary(
        12, 1, 9, True, "end_of_source", 2.0, failures={("glance", "raised ValueError: no"): failed}
    )
    say_end(Namespace(command="run", quiet=False), Path("runs/a"), summary)
    assert capsys.readouterr().err.startswith(
        "frame 1: glance failed: raised ValueError: no → paused for 10 "
    )


def test_of_many_targets_the_mean_share_that_is_lost_is_said():
    assert as_sentence(Summary(12, 0, 9, True, most_targets=1)).endswith(", lost in 9 frames")
    many = Summary(12, 0, 9, True, most_targets=18, target_frames=200, lost_target_frames=10)
    assert as_sentence(many).endswith(", on average 5 % of the targets lost (at most 18 at a time)")
