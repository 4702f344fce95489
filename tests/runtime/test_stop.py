"""Stopping by signals: between two frames, with valid files and the shell's exit code."""

import signal
import subprocess
import sys
import threading
import time

import pytest

from bayesnet_track.journal.events import RunEnded
from bayesnet_track.journal.reader import read_events, read_metrics
from bayesnet_track.runtime.rundir import RunDirectory
from bayesnet_track.runtime.stop import SIGNALS, StopRequest, Terminated, terminable


def handlers():
    return [signal.getsignal(number) for number in SIGNALS]


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_is_noted_and_the_second_acts(number):
    arrived = []
    before = signal.signal(number, lambda *_: arrived.append(number))
    try:
        with StopRequest() as stop:
            assert (stop.signal, stop.exit_code) == (None, 0)
            signal.raise_signal(number)
            assert (stop.signal, stop.exit_code) == (number, 128 + number)
            assert arrived == []
            signal.raise_signal(number)
            assert arrived == [number]
    finally:
        signal.signal(number, before)


@pytest.mark.parametrize("number", SIGNALS)
def test_without_patience_the_first_one_acts(number):
    with pytest.raises(KeyboardInterrupt) as ended, terminable(), StopRequest(is_patient=False) as stop:
        signal.raise_signal(number)
    assert (type(ended.value) is Terminated) == (number == signal.SIGTERM)
    assert stop.exit_code == 128 + number


def test_handlers_are_put_back():
    before = handlers()
    with StopRequest(), terminable():
        assert handlers() != before
    assert handlers() == before
    with pytest.raises(RuntimeError), terminable(), StopRequest():
        raise RuntimeError
    assert handlers() == before


def test_sigterm_ends_what_is_terminable():
    with pytest.raises(Terminated), terminable():
        signal.raise_signal(signal.SIGTERM)


def test_an_ignored_signal_stays_ignored():
    """A shell starts what runs in the background so that Ctrl-C does not reach it."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with StopRequest() as stop:
            signal.raise_signal(signal.SIGINT)
            assert stop.signal is None
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_another_thread_handles_no_signals():
    before, seen = handlers(), []

    def work():
        with StopRequest() as stop, terminable():
            seen.append((handlers(), stop.signal))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [(before, None)]


# ------------------------------------------------------------------------------------ a running process


def started(out, *more):
    """A demo that has tracked at least ten frames."""
    line = [sys.executable, "-m", "bayesnet_track", "demo", "--out", str(out), *more]
    process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not (out / "tracks.txt").exists() or (out / "tracks.txt").read_bytes().count(b"\n") < 10:
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.005)
    return process


def check(out, notice=pytest.fail):
    """The number of frames that were measured; every file must be valid and tell of the same frames."""
    directory = RunDirectory.open(out)
    frames = [metrics.frame for metrics in read_metrics(directory.frames, notice)]
    assert frames == list(range(len(frames)))
    for path, more in ((directory.mot, 0), (directory.csv, 1), (directory.timings, 0)):
        lines = path.read_bytes().split(b"\n")
        assert abs(len(lines) - 1 - more - len(frames)) <= 1
    return len(frames)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_a_run_in_order(tmp_path, number, code):
    out = tmp_path / "run"
    process = started(out)
    process.send_signal(number)
    said, complained = process.communicate(timeout=60)
    assert process.returncode == code
    assert "Traceback" not in complained
    assert said.endswith(", interrupted\n") and said.count("\n") == 1
    frames = check(out)
    assert 10 <= frames < 200
    assert list(read_events(out / "journal.jsonl", pytest.fail))[-1] == RunEnded(
        frames, 200, False, "interrupted"
    )


def test_a_killed_run_leaves_files_that_can_be_read(tmp_path):
    from bayesnet_track.cli import main

    out = tmp_path / "run"
    process = started(out)
    process.kill()
    process.communicate()
    frames = check(out, notice=lambda _: None)
    assert frames >= 10
    events = list(read_events(out / "journal.jsonl", lambda _: None))
    assert not any(isinstance(event, RunEnded) for event in events)
    assert main(["log", str(out)]) == 0
    # The truth is written when a demo ends; any file serves.
    truth = tmp_path / "truth.txt"
    truth.write_text("1,2,3,4\n" * 200)
    assert main(["score", str(out), "--truth", str(truth)]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("wait_ms", range(0, 1500, 75))
def test_a_signal_at_any_time(tmp_path, wait_ms):
    """One of the two exit codes, or death by the signal before any code of ours ran."""
    number, code = ((signal.SIGINT, 130), (signal.SIGTERM, 143))[wait_ms // 75 % 2]
    line = [sys.executable, "-m", "bayesnet_track", "demo", "--out", str(tmp_path / "run")]
    process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    time.sleep(wait_ms / 1000)
    process.send_signal(number)
    complained = process.communicate(timeout=60)[1]  # a hang, not a measure of speed
    assert process.returncode in (code, -number)
    journal = tmp_path / "run/journal.jsonl"
    if journal.exists() and journal.stat().st_size:
        assert "Traceback" not in complained
        check(tmp_path / "run")
