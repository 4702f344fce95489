"""Small files that are there whole or not at all, whatever happens while they are written."""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from pathlib import Path

from bayesnet_track.journal.writer import output_error

PART = ".part"
"""What the name of a file that is not whole yet ends in."""
CANNOT = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS)
"""What some file systems (of a network, of a container) say of letting the disk have a folder."""


def write_atomically(path: Path, data: bytes) -> None:
    """Write beside `path`, let the disk have it, and give it its name.

    After a crash at any moment the old file is there, or the new one, and perhaps a part that nobody reads.

    Raises:
        OutputError: it cannot be written; the old file is as it was.
    """
    part = path.with_name(path.name + PART)
    try:
        with part.open("wb", buffering=0) as file:
            view, done = memoryview(data), 0
            while done < len(view):
                done += file.write(view[done:]) or 0
            os.fsync(file.fileno())
        part.replace(path)
        sync_directory(path.parent)
    except OSError as error:
        with suppress(OSError):
            part.unlink()
        raise output_error(path, error) from error


def sync_directory(folder: Path) -> None:
    """Let the disk have a folder's entries; where a system cannot, it keeps them in its own time."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in CANNOT:
            raise
    finally:
        os.close(handle)
