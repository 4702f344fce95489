"""What this operating system lacks of what the program uses; tested is Linux x86-64.

Found by what is there, not by the system's name. Nothing heavy is imported: `doctor` asks, too.
"""

from __future__ import annotations

import os
import platform
import socket
import sys
from collections.abc import Iterator
from importlib.util import find_spec

from bayesnet_track.observation.settings import setting, to_caller

TESTED = ("Linux", "x86_64")


def has_workers() -> bool:
    """True if agents can be in processes of their own: forked, with descriptors handed over a socket."""
    return hasattr(os, "fork") and hasattr(socket, "send_fds")


def no_workers() -> str:
    """The reason why there are no worker processes, and what to do."""
    serial = setting("--executor", "serial", "'serial'")
    place = to_caller("no --place AGENT=process", "no agent in places= a process")
    return f"this system cannot start worker processes (it has no fork); take {serial}, and {place}"


def lacking() -> Iterator[str]:
    """Missing parts of the operating system, and what that means, one clause each."""
    if not has_workers():
        yield f"no worker processes ({setting('--executor', 'processes', repr('processes'))})"
    if sys.platform == "darwin":
        yield f"no limit on memory ({to_caller('--agent-memory', 'Limits.memory_mb')} limits nothing)"
    if find_spec("fcntl") is None and find_spec("msvcrt") is None:
        yield "no lock on files (two runs may write one folder)"
    if sys.platform == "win32":
        yield "no SIGTERM (a run that is ended from outside closes no file; `resume` goes on from there)"
    if os.name != "posix":
        yield "no sync of folders (a power cut may lose the newest files)"


def describe_missing() -> str:
    """One sentence for who begins a run here; empty on the system that is tested."""
    here = (platform.system(), platform.machine())
    missing = ", ".join(lacking())
    if here == TESTED and not missing:
        return ""
    name = " ".join(part for part in here if part) or sys.platform
    return f"{name} is not tested ({' '.join(TESTED)} is); missing here: {missing or 'nothing that is known'}"
