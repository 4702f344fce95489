"""Let a new run take the place of an earlier one in the same folder, by one rename that decides.

The new run's small files are written into a folder of their own inside the run directory. Renaming that
folder from ``.staged`` to ``.replacing`` decides: before it the earlier run is untouched, after it the new
run counts. What then remains, to remove the earlier run's files and to copy those of the new one into their
place, can be repeated as often as it is broken off. Nothing is open meanwhile, so that it works on Windows,
too, and the run directory itself stays where it is: it may be a mount point, and its parent read-only.

Only the process that holds the directory's lock does any of this.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

from bayesnet_track.journal import disk
from bayesnet_track.journal.writer import PART, write_atomically, writing
from bayesnet_track.runtime.recording.lock import lock_run
from bayesnet_track.runtime.recording.rundir import FILES, REPLACING, STAGED, RunDirectory


def replace_run(directory: RunDirectory, files: Mapping[str, bytes]) -> None:
    """Replace the run in a directory by a new one that has so far only these `files`, by key in `FILES`.

    Raises:
        OutputError: it cannot be done. The earlier run is untouched, or the next start completes this.
    """
    settle(directory)
    staged = directory.path / STAGED
    with writing(staged):
        disk.make_folder(staged)
        for key, data in files.items():
            with closing(disk.open_raw(staged / FILES[key], "wb")) as file:
                disk.write_whole(file, data)
                disk.sync(file)
        disk.sync_folder(staged)
        disk.replace(staged, directory.path / REPLACING)
        disk.sync_folder(directory.path)
    settle(directory)


def settle(directory: RunDirectory) -> None:
    """Complete a replacement that was decided, and remove what is left of one that was not.

    Raises:
        OutputError: it cannot be done; the next start tries again.
    """
    with writing(directory.path):
        if (directory.path / REPLACING).is_dir():
            _complete(directory)
        _remove(directory.path / STAGED)


def settle_broken(directory: RunDirectory) -> None:
    """Complete a replacement that its process left behind; takes the lock only if there is one.

    Raises:
        RunDirectoryError: the process is still there.
        OutputError: it cannot be done.
    """
    if directory.is_replacing:
        with lock_run(directory):
            settle(directory)


def _complete(directory: RunDirectory) -> None:
    """Make the run directory that of the new run; repeated from its start, it ends the same."""
    replacing = directory.path / REPLACING
    new = {path.name: path.read_bytes() for path in replacing.iterdir()}
    held = {path.name for path in directory.path.iterdir()}
    own = {*FILES.values(), *(name + PART for name in FILES.values())}
    for name in sorted(held & (own - new.keys())):
        disk.unlink(directory.path / name)
    for name, data in sorted(new.items()):
        write_atomically(directory.path / name, data)
    # With an empty journal the folder counts as a run.
    disk.open_raw(directory.journal, "wb").close()
    disk.sync_folder(directory.path)
    disk.replace(replacing, directory.path / STAGED)
    disk.sync_folder(directory.path)


def _remove(folder: Path) -> None:
    if folder.is_dir():
        for path in sorted(folder.iterdir()):
            disk.unlink(path)
        disk.remove_folder(folder)
