"""On other systems it is said at the start what is missing, and what needs it is refused there, not later."""

import os
import platform
import subprocess
import sys

import pytest

from bayesnet_track import track
from bayesnet_track.cli import doctor
from bayesnet_track.cli import main as commands
from bayesnet_track.cli.main import main
from bayesnet_track.runtime import stop
from bayesnet_track.runtime.executors import PlacingError
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

ABSENT = {"win32": ("fcntl", "resource"), "darwin": ("msvcrt",), "linux": ("msvcrt",)}


@pytest.fixture
def on(monkeypatch):
    """Make this system look like another one, as far as the program asks."""

    def become(name, words, machine):
        monkeypatch.setattr(sys, "platform", name)
        monkeypatch.setattr(platform, "system", lambda: words)
        monkeypatch.setattr(platform, "machine", lambda: machine)
        monkeypatch.setattr(stop, "find_spec", lambda module: None if module in ABSENT[name] else module)
        if name == "win32":
            monkeypatch.setattr(stop, "os", type("os", (), {"name": "nt"}))

    return become


def test_on_the_tested_system_nothing_is_said(on):
    on("linux", "Linux", "x86_64")
    assert stop.describe_missing() == ""
    on("linux", "Linux", "aarch64")
    assert stop.describe_missing() == (
        "Linux aarch64 is not tested (Linux x86_64 is); missing here: nothing that is known"
    )


def test_windows_lacks_workers_and_signals(on):
    on("win32", "Windows", "AMD64")
    said = stop.describe_missing()
    assert said.startswith("Windows AMD64 is not tested (Linux x86_64 is); missing here: no worker processes")
    for missing in ("executor='processes'", "SIGTERM", "sync of folders"):
        assert missing in said
    assert "two runs" not in said or sys.platform != "win32", "msvcrt locks there"


def test_a_mac_lacks_the_limit_on_memory_alone(on):
    on("darwin", "Darwin", "arm64")
    assert (
        "missing here: no limit on memory (" in stop.describe_missing()
        and "worker" not in stop.describe_missing()
    )


@pytest.mark.parametrize(("quiet", "times"), [("", 1), ("--quiet", 0)])
def test_a_run_says_so_at_the_start_and_doctor_too(on, monkeypatch, capsys, quiet, times):
    on("darwin", "Darwin", "arm64")
    monkeypatch.setattr(commands, "COMMANDS", dict.fromkeys(commands.COMMANDS, lambda options: 0))
    assert main(["demo", *quiet.split()]) == 0
    assert capsys.readouterr().err.count("Darwin arm64 is not tested") == times
    assert main(["list"]) == 0 and capsys.readouterr().err == ""
    found = list(doctor.check_system())
    assert [one.level for one in found] == ["note"] and "no limit on memory" in found[0].text


def test_worker_processes_are_refused_at_the_start_where_there_are_none(on, tmp_path, capsys):
    on("win32", "Windows", "AMD64")
    line = ["demo", "--quiet", "--executor", "processes", "--out", str(tmp_path / "run")]
    assert main(line) == 2
    assert "this system cannot start worker processes" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
    scene = make_scene("two_squares")
    source = SceneSource(scene, "scene:two_squares", 2)
    with pytest.raises(PlacingError, match="cannot start worker processes"):
        next(track("two_squares", source, scene.start_box, executor="processes"))


WITHOUT_UNIX = """
import builtins, importlib, os, pkgutil, select, signal, socket, sys
import av, cv2, numba, numpy, packaging.requirements, pydantic, shtab, yaml
import asyncio, http.server, multiprocessing.pool, subprocess, tempfile, webbrowser, zipfile
for module in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[module] = None
for name in ("fork", "memfd_create", "preadv", "sched_getaffinity", "waitpid", "O_ASYNC", "WNOHANG"):
    if hasattr(os, name):
        delattr(os, name)
for name in ("SIGKILL", "SIGIO", "SIGXCPU", "SIGHUP", "SIGALRM", "SIGUSR1", "SIGCHLD", "pthread_kill"):
    if hasattr(signal, name):
        delattr(signal, name)
for where, name in ((select, "poll"), (socket, "AF_UNIX"), (socket, "send_fds"), (socket, "recv_fds")):
    if hasattr(where, name):
        delattr(where, name)
def pair():  # what Python does where the system has no pairs of sockets
    with socket.create_server(("127.0.0.1", 0)) as server:
        return socket.create_connection(server.getsockname()), server.accept()[0]
socket.socketpair = pair
import bayesnet_track, bayesnet_track.cues
for package in (bayesnet_track, bayesnet_track.cues):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
from bayesnet_track.cli.main import main
sys.exit(main(["demo", "--end", "3", "--quiet", "--out", sys.argv[1]]))
"""


@pytest.mark.slow
def test_every_module_is_imported_and_a_run_ends_well_without_what_only_unix_has(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_UNIX, str(tmp_path / "run")],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONWARNINGS": "ignore"},
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "journal.jsonl").is_file()
