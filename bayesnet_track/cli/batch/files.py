"""How many files may be open, and what is said when they are too few."""

from __future__ import annotations

import errno
import os
from pathlib import Path

FILES_EACH, FILES_MORE = 12, 12
"""Files that this process opens for a run, most of them while it is started, and that it needs besides."""

MANY_FILES = "raise the limit on open files (`ulimit -n`), or give fewer --jobs"


def most_runs() -> int | None:
    """How many runs at a time the limit on open files lets be started; None where none is known."""
    if os.name != "posix":
        return None
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY:
        return None
    here = Path("/dev/fd")
    is_open = len(list(here.iterdir())) if here.is_dir() else 16
    return max(0, (soft - is_open - FILES_MORE) // FILES_EACH)


def explained(error: Exception) -> str:
    """An error in words, with a cure where it is the limit on open files."""
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
        return f"{error.strerror}: {MANY_FILES}"
    return str(error)
