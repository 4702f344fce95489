"""One process at a time writes a run directory; the system releases the lock when that process is gone.

The lock is on an empty file of its own, `.lock`, which is made once and never written, renamed, replaced or
removed: not at the end of a run, not by `resume`, and not by an overwrite, which changes only the files
beside it. So whoever wants to write this folder asks for the same lock.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager

from bayesnet_track.runtime.recording.rundir import RunDirectory, RunDirectoryError

TAKEN = (errno.EAGAIN, errno.EACCES, errno.EDEADLK)
"""What systems answer when another process has the lock."""
AT_BYTE = 1 << 30
"""Windows locks a range of bytes, which may lie behind the end of the file."""


@contextmanager
def lock_run(directory: RunDirectory) -> Iterator[None]:
    """Inside it no other process writes the run.

    Some disks, of a network for example, have no locks: there it is not checked.

    Raises:
        RunDirectoryError: another process has the lock, or the folder cannot be written.
    """
    try:
        handle = os.open(directory.lock, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise RunDirectoryError(
            f"{directory.path}: cannot make the run directory: {error.strerror}"
        ) from error
    try:
        _take(handle, directory)
        yield
    finally:
        os.close(handle)


def is_locked(directory: RunDirectory) -> bool:
    """True if another process writes the run now; changes nothing."""
    if not directory.lock.is_file():
        return False
    try:
        with lock_run(directory):
            return False
    except RunDirectoryError:
        return os.access(directory.lock, os.W_OK)


def _take(handle: int, directory: RunDirectory) -> None:
    try:
        _lock(handle)
    except OSError as error:
        if error.errno not in TAKEN:  # a file system without locks
            return
        raise RunDirectoryError(
            f"{directory.path}: another process is writing this run; wait for it, or give another folder"
        ) from None


def _lock(handle: int) -> None:
    try:
        import fcntl
    except ImportError:
        try:
            import msvcrt
        except ImportError:  # `runtime.stop` says so at the start of a run
            return
        os.lseek(handle, AT_BYTE, os.SEEK_SET)
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
    else:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
