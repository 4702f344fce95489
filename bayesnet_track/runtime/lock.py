"""One process at a time writes a run directory; the system lets go of the lock when that one is gone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from bayesnet_track.runtime.rundir import RunDirectory, RunDirectoryError


@contextmanager
def locked(directory: RunDirectory) -> Iterator[None]:
    """Inside it no other process writes the run; without locks of the system or its disk it is not checked.

    Raises:
        RunDirectoryError: another one does so now.
    """
    try:
        from fcntl import LOCK_EX, LOCK_NB, flock
    except ImportError:
        yield
        return
    with directory.recipe.open("rb") as file:
        try:
            flock(file, LOCK_EX | LOCK_NB)
        except BlockingIOError:
            raise RunDirectoryError(
                f"{directory.path}: another process is writing this run; wait for it, or give another folder"
            ) from None
        except OSError:  # a file system without locks
            pass
        yield


def refuse_written(directory: RunDirectory) -> None:
    """Refuse a run that another process writes now, before it is overwritten.

    Raises:
        RunDirectoryError: one does.
    """
    if directory.recipe.is_file():
        with locked(directory):
            pass
