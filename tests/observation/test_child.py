"""Python processes that are started here import what this one imports, and end when this one ends."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from bayesnet_track.cli.batch import places
from bayesnet_track.cli.batch.jobs import BatchVideo, Job
from bayesnet_track.observation.child import cut, end_with, python, tie
from bayesnet_track.runtime.executors.workers import ForkServer

TOLD = "import json, sys; print(json.dumps(sys.path))"
posix = pytest.mark.skipif(os.name != "posix", reason="nothing of the kind is known elsewhere")


def started_by(monkeypatch, start):
    """The command lines that `start` would run in processes."""
    lines = []

    def refuse(command, **settings):
        lines.append(list(command))
        raise OSError("not started")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    with suppress(OSError):
        start()
    return lines


@posix
@pytest.mark.parametrize("kind", ["fork_server", "batch"])
def test_every_process_looks_in_no_folder_but_those_of_this_one(monkeypatch, tmp_path, kind):
    """The first lines of each process, run in a folder of decoys, say where it imports from."""
    job = Job("g", BatchVideo("v", "v"), 0, str(tmp_path))
    start = {
        "fork_server": lambda: ForkServer(0, 0, 1.0),
        "batch": lambda: list(places.Processes(1).run([job])),
    }
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path / "of this run only")])
    (command,) = started_by(monkeypatch, start[kind])
    assert command[0] == sys.executable and "-P" in command and "-m" not in command
    code = command[command.index("-c") + 1]
    first, second, *_ = code.splitlines()
    assert first == f"import sys; sys.path[:] = {sys.path!a}" and "die_with" in second


def test_a_child_has_the_path_of_its_parent_and_no_other(tmp_path):
    """Also where the environment names another one, and the working directory holds a library's name."""
    (tmp_path / "json.py").write_text("raise SystemExit('the decoy ran')")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "elsewhere")}
    done = subprocess.run(python(TOLD), cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout) == sys.path


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere one that is stopped stays")
def test_a_process_that_was_stopped_before_it_asked_is_tied_by_its_parent():
    held, lifeline = tie()
    with subprocess.Popen(["sleep", "60"], pass_fds=(held,)) as child:
        child.send_signal(signal.SIGSTOP)
        assert end_with(child.pid, held)
        cut(held, lifeline)
        assert child.wait(20) == -signal.SIGKILL


@posix
def test_it_is_known_that_the_other_end_was_closed_before():
    held, lifeline = tie()
    cut(lifeline)
    assert not end_with(os.getpid(), held)
    cut(held)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere one that is stopped stays")
@pytest.mark.parametrize("is_stopped", [False, True])
def test_a_child_that_is_tied_ends_though_it_is_stopped(is_stopped):
    held, lifeline = tie()
    command = python("import os, time; os.write(1, b'.'); time.sleep(60)", descriptor=held)
    with subprocess.Popen(command, stdout=subprocess.PIPE, pass_fds=(held,)) as child:
        cut(held)
        assert child.stdout.read(1) == b"."
        if is_stopped:
            child.send_signal(signal.SIGSTOP)
            assert os.waitid(os.P_PID, child.pid, os.WSTOPPED | os.WNOWAIT)
        cut(lifeline)
        assert child.wait(10.0) == -signal.SIGKILL


def is_tied(pid, lifeline):
    """Whether the process has asked for a signal when this end of its `tie` closes."""
    pipe = Path(f"/proc/self/fd/{lifeline}").readlink()
    for held in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed meanwhile
            flags = (
                held.readlink() == pipe and (held.parents[1] / "fdinfo" / held.name).read_text().split()[3]
            )
            if flags and int(flags, 8) & os.O_ASYNC:
                return True
    return False


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere one that is stopped stays")
def test_a_fork_server_that_is_stopped_is_given_up_within_its_patience():
    """Not after a minute for each question; and a worker of the next one ends though it is stopped."""
    frames = os.open(os.devnull, os.O_RDONLY)
    fork_server = ForkServer(frames, 0, 3.0)
    try:
        channel, lifeline, pid = fork_server.worker()
        stopped = fork_server._process.pid
        os.kill(stopped, signal.SIGSTOP)
        began = time.monotonic()
        channel.close()
        cut(lifeline)
        assert fork_server.ended(pid) is None
        assert time.monotonic() - began < 20.0
        channel, lifeline, pid = fork_server.worker()
        assert fork_server._process.pid != stopped
        assert time.monotonic() - began < 40.0
        poll = select.poll()
        poll.register(channel, select.POLLIN)
        while not is_tied(
            pid, lifeline
        ):  # a worker that is only just forked has not asked for the signal yet
            assert time.monotonic() - began < 60.0
        os.kill(pid, signal.SIGSTOP)
        cut(lifeline)
        assert poll.poll(10e3) and channel.recv(1) == b""
    finally:
        channel.close()
        fork_server.close()
        os.close(frames)
