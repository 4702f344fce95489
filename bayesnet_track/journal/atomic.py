"""Small files that are there whole or not at all, whatever happens while they are written."""

from __future__ import annotations

from contextlib import closing, suppress
from pathlib import Path

from bayesnet_track.journal import disk
from bayesnet_track.journal.writer import output_error

PART = ".part"
"""What the name of a file that is not whole yet ends in."""


def write_atomically(path: Path, data: bytes, previous: Path | None = None) -> None:
    """Write beside `path`, let the disk have it, and give it its name; the old file gets the name `previous`.

    After a crash at any moment the old file is there, under one of its names, or the new one, and perhaps a
    part that nobody reads.

    Raises:
        OutputError: it cannot be written; the old file is as it was.
    """
    part = path.with_name(path.name + PART)
    try:
        with closing(disk.open_raw(part, "wb")) as file:
            disk.write_whole(file, data)
            disk.sync(file)
        if previous is not None and path.exists():
            disk.replace(path, previous)
        disk.replace(part, path)
        disk.sync_folder(path.parent)
    except OSError as error:
        with suppress(OSError):
            disk.unlink(part)
        raise output_error(path, error) from error
