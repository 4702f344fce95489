"""However a run ends, nothing of its workers is left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="children are found in /proc"),
]

LEFT_S = 2.0


def children(pid):
    """All descendants of a process."""
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*"):
        with suppress(FileNotFoundError, ProcessLookupError):  # the thread has ended since
            for child in (task / "children").read_text().split():
                found += [int(child), *children(int(child))]
    return found


def is_there(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@pytest.fixture
def run(tmp_path):
    """A run of the command line in worker processes, under way."""
    command = ["demo", "two_squares", "--out", str(tmp_path / "run"), "--executor", "processes"]
    command += ["--agent-timeout", "3"]
    with subprocess.Popen(
        [sys.executable, "-m", "bayesnet_track", *command, "--workers", "2"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    ) as process:
        until = time.monotonic() + 60
        while len(children(process.pid)) < 3 or not (tmp_path / "run" / "tracks.txt").exists():
            assert process.poll() is None, process.stdout.read()
            assert time.monotonic() < until
            time.sleep(0.01)
        yield process
        process.kill()


@pytest.mark.parametrize("way", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_worker_outlives_a_run_that_is_ended(run, way):
    left = children(run.pid)
    shared = set(Path("/dev/shm").glob("*"))
    run.send_signal(way)
    ended = time.monotonic()
    code = run.wait(LEFT_S)
    while any(map(is_there, left)):
        assert time.monotonic() < ended + LEFT_S, [pid for pid in left if is_there(pid)]
        time.sleep(0.01)
    assert code == {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGKILL: -9}[way]
    assert set(Path("/dev/shm").glob("*")) <= shared


@pytest.mark.parametrize("are_all", [False, True])
@pytest.mark.parametrize("way", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_run_whose_agents_hang_ends_as_soon(run, way, are_all):
    """All workers are stopped, so that the frame never ends: neither does the run wait, nor are they left.

    Nor is the process that forks them, where it is stopped, too.
    """
    server = children(run.pid)
    workers = [pid for pid in server if any(pid in children(other) for other in server)]
    assert len(workers) >= 2
    for pid in server if are_all else workers:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(0.5)
    assert run.poll() is None
    run.send_signal(way)
    ended = time.monotonic()
    code = run.wait(LEFT_S)
    while any(map(is_there, server)):
        assert time.monotonic() < ended + LEFT_S, [pid for pid in server if is_there(pid)]
        time.sleep(0.01)
    assert code == {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGKILL: -9}[way]


def test_a_run_goes_on_soon_though_what_forks_its_workers_is_stopped(run):
    """It is given up after the time that an agent has, and another one forks the workers that are missing."""
    all_of_them = children(run.pid)
    (server,) = [pid for pid in all_of_them if children(pid)]
    os.kill(server, signal.SIGSTOP)
    for pid in all_of_them:
        if pid != server:
            os.kill(pid, signal.SIGKILL)
    output = run.communicate(timeout=90)[0].decode()
    assert run.returncode == 0, output
    assert not is_there(server)


def test_no_worker_outlives_a_run_that_comes_to_its_end(run):
    left = children(run.pid)
    output = run.communicate(timeout=60)[0].decode()
    assert run.returncode == 0, output
    assert not any(map(is_there, left))
