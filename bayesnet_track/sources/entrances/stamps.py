"""Whether files changed while they were read: told from their inode, size and time, without reading them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

Stamp = tuple[int, int, int]
"""Inode, size in bytes, and time of the last change of the contents in ns."""


def stamps(paths: Iterable[Path]) -> dict[Path, Stamp]:
    """Of each file that is there.

    >>> stamps([Path("nowhere.csv")])
    {}
    """
    found = {}
    for path in paths:
        with suppress(OSError):
            held = path.stat()
            found[path] = (held.st_ino, held.st_size, held.st_mtime_ns)
    return found


def changed_since(before: Mapping[Path, Stamp]) -> list[Path]:
    """The files that are others now; one that was removed was read, or its reader says what is missing."""
    now = stamps(before)
    return [path for path, stamp in before.items() if now.get(path, stamp) != stamp]
