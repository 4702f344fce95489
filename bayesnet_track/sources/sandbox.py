"""What a decoding process gives up before it reads a byte of an untrusted file.

Without rights, by the operating system's limits on a process: nothing here needs root. Where the system lacks
a limit (macOS does not hold address spaces down), the others still hold.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

CPU_EXTRA_S = 1
"""Limits of CPU time are whole seconds; a picture gets as much more."""


@dataclass(frozen=True)
class Limits:
    """What decoding may take.

    Attributes:
        memory_bytes: beyond what the libraries took before the first byte was read.
        picture_s: seconds for one picture, on the clock and of CPU time each; for opening, too.
        starting_s: seconds until the process has loaded its libraries.
    """

    memory_bytes: int = 2 << 30
    picture_s: float = 10.0
    starting_s: float = 60.0


def give_up_rights(limits: Limits, files: int | None) -> None:
    """Hold this process down for good; `files` more than are open now may be open at once (None: any).

    With one file there is none to spare while one is read, so that nothing in it can have another file or a
    connection opened.
    """
    import resource

    _limit(resource.RLIMIT_CORE, 0)
    _limit(resource.RLIMIT_FSIZE, 0)
    size = Path("/proc/self/statm")
    taken = int(size.read_text().split()[0]) * resource.getpagesize() if size.exists() else 0
    _limit(resource.RLIMIT_AS, taken + limits.memory_bytes)
    if files is not None:
        lowest = os.open(os.devnull, os.O_RDONLY)
        os.close(lowest)
        _limit(resource.RLIMIT_NOFILE, lowest + files)


def begin_picture(limits: Limits) -> None:
    """From here on, CPU time for one more picture."""
    import resource

    used = resource.getrusage(resource.RUSAGE_SELF)
    allowed = int(used.ru_utime + used.ru_stime + limits.picture_s) + CPU_EXTRA_S
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    if hard == resource.RLIM_INFINITY or allowed <= hard:
        resource.setrlimit(resource.RLIMIT_CPU, (allowed, hard))


def _limit(which: int, value: int) -> None:
    import resource

    _, hard = resource.getrlimit(which)
    allowed = value if hard == resource.RLIM_INFINITY else min(value, hard)
    resource.setrlimit(which, (allowed, allowed))
