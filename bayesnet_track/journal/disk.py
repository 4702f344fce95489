"""Every operation by which outputs change on the disk, in one place.

Callers write ``disk.replace(...)``, never ``from ... import replace``: a test that simulates crashes or power
cuts puts its own functions in this module.
"""

from __future__ import annotations

import errno
import os
import stat
from contextlib import suppress
from io import FileIO
from pathlib import Path

CANNOT = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS)
"""What devices answer to a sync and, for a folder, some file systems (of a network, of a container)."""


def is_there(path: Path) -> bool:
    """True if something has that name.

    Raises:
        OSError: nothing can have it, for example because it is too long. `Path.exists` raises this only
            before Python 3.14.
    """
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def open_raw(path: Path, mode: str) -> FileIO:
    """Open `path` without a buffer: ``wb`` or ``w+b`` for a new file, ``r+b`` to continue one."""
    return FileIO(str(path), mode)


def write_whole(file: FileIO, data: bytes | memoryview) -> None:
    """Write all of `data`, however often the system takes only a part."""
    view, written = memoryview(data), 0
    while written < len(view):
        written += file.write(view[written:]) or 0


class LostFileError(OSError):
    """A file that is being written, and that something else removed, renamed, replaced or changed."""


def check_held(file: FileIO, path: Path, size: int) -> None:
    """Refuse to go on with an open file whose name is gone or another's, or that has not `size` bytes.

    What was written to a removed file is lost without any error of the system. A device or a pipe is not
    checked.

    Raises:
        LostFileError: says what happened to it.
        OSError: the system cannot say.
    """
    opened = os.fstat(file.fileno())
    if not stat.S_ISREG(opened.st_mode):
        return
    try:
        named = path.stat()
    except FileNotFoundError:
        raise LostFileError("it was removed or renamed while it was being written") from None
    if not os.path.samestat(opened, named):
        raise LostFileError("another file has taken its place while it was being written")
    if opened.st_size != size:
        raise LostFileError(
            f"something else changed it while it was being written: it has {opened.st_size} bytes, not {size}"
        )


def sync(file: FileIO) -> None:
    """Wait until the disk has what was written to `file`; a device or a pipe is on none."""
    _fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Wait until the disk has a folder's entries; some systems cannot, and keep them in their own time."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        _fsync(handle)
    finally:
        os.close(handle)


def _fsync(handle: int) -> None:
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in CANNOT:
            raise


def replace(source: Path, target: Path) -> None:
    """Rename a file or a folder; a file replaces what has the name `target`."""
    source.replace(target)


def unlink(path: Path) -> None:
    """Remove a file, if it is there."""
    path.unlink(missing_ok=True)


def make_folder(path: Path) -> None:
    """Make a folder that is not there yet."""
    path.mkdir()


def make_folders(path: Path) -> None:
    """Make a folder and those above it where they are missing, and wait until the disk has them."""
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    for folder in reversed(missing):
        with suppress(FileExistsError):  # another process made it meanwhile
            make_folder(folder)
        with suppress(PermissionError):  # where entries may be added, but not be read
            sync_folder(folder.parent)


def remove_folder(path: Path) -> None:
    """Remove an empty folder."""
    path.rmdir()
