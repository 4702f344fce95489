"""The manifest: which bytes a finished run left. Writing it is what finishes a run.

It is written after every other output is closed and on the disk, whole or not at all. A run without one is
unfinished, whatever its journal says.

One process at a time writes a run directory; the system releases the lock when that process is gone.

The lock is on an empty file of its own, `.lock`, which is made once and never written, renamed, replaced or
removed: not at the end of a run, not by `resume`, and not by an overwrite, which changes only the files
beside it. So whoever wants to write this folder asks for the same lock.

Let a new run take the place of an earlier one in the same folder, by one rename that decides.

The new run's small files are written into a folder of their own inside the run directory. Renaming that
folder from ``.staged`` to ``.replacing`` decides: before it the earlier run is untouched, after it the new
run counts. What then remains, to remove the earlier run's files and to copy those of the new one into their
place, can be repeated as often as it is broken off. Nothing is open meanwhile, so that it works on Windows,
too, and the run directory itself stays where it is: it may be a mount point, and its parent read-only.

Only the process that holds the directory's lock does any of this.

Write a smoothed run as a run directory, which every command that reads runs can read.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.journal import disk
from bayesnet_track.journal.frame_file import FrameWriter
from bayesnet_track.journal.writer import (
    PART,
    JournalWriter,
    LineFile,
    OutputError,
    Position,
    read_position,
    write_atomically,
    writing,
)
from bayesnet_track.runtime.recording.run_reader import Run
from bayesnet_track.runtime.recording.rundir import FILES, REPLACING, STAGED, RunDirectory, RunDirectoryError
from bayesnet_track.runtime.recording.tracks import (
    CsvWriter,
    MotWriter,
    has_csv,
    has_only_points,
    measured,
    number_columns,
)
from bayesnet_track.runtime.smoothing import SmoothedRun

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


FORMAT = 1

SAME = "inputs"
"""Such an output has the same bytes for the same graph, source, start boxes, seed and library versions."""
VARIES = {"recipe": "machine", "video": "machine", "mp4": "machine", "timings": "clock", "report": "clock"}
"""What the bytes of the others depend on, besides: paths and codecs of the machine, or the clock."""
PASSING = ("checkpoint", "previous", "ahead")
"""Files that a run needs only until it is finished."""
FOREIGN = ".foreign"
"""What the name of a file ends in that something else put in the place of one of the run's own."""


class ManifestError(ValueError):
    """A ``manifest.json`` that was changed, or is of another version."""


@dataclass(frozen=True)
class Manifest:
    """Outputs and result of a finished run.

    Attributes:
        outputs: file, by its key in `rundir.FILES` -> its size and SHA-256.
    """

    outputs: Mapping[str, Position]

    @property
    def result(self) -> str:
        """One SHA-256 for all outputs that equal inputs make equal: compare two runs by it."""
        same = sorted(key for key in self.outputs if _varies(key) == SAME)
        lines = "".join(f"{FILES[key]} {self.outputs[key].sha256}\n" for key in same)
        return hashlib.sha256(lines.encode("ascii")).hexdigest()

    def text(self) -> str:
        """It as JSON; the last entry is the SHA-256 of the others."""
        outputs = {
            FILES[key]: {"size": position.size, "sha256": position.sha256, "varies_with": _varies(key)}
            for key, position in sorted(self.outputs.items(), key=lambda item: FILES[item[0]])
        }
        content: dict[str, Any] = {"manifest": FORMAT, "outputs": outputs, "result": self.result}
        seal = hashlib.sha256(json.dumps(content).encode("ascii")).hexdigest()
        return json.dumps({**content, "seal": seal}, indent=1) + "\n"


def read_manifest(path: Path) -> Manifest | None:
    """The manifest in a file; None where there is none.

    Raises:
        ManifestError: it was changed since it was written, or is of another version.
        OSError: it cannot be read.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    try:
        content = json.loads(data)
        version, keys = content["manifest"], {name: key for key, name in FILES.items()}
        if version != FORMAT:
            raise ManifestError(f"{path}: version {version} of the format; this program reads {FORMAT}")
        outputs = content["outputs"].items()
        manifest = Manifest({keys[name]: Position(entry["size"], entry["sha256"]) for name, entry in outputs})
        is_whole = manifest.text().encode("ascii") == data
    except ManifestError:
        raise
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        is_whole = False
    if not is_whole:
        raise ManifestError(f"{path}: changed since it was written: it vouches for nothing any more")
    return manifest


def finish_run(directory: RunDirectory, written: Mapping[str, Position], small: Mapping[str, bytes]) -> None:
    """Write the manifest, by which the run is finished, and remove what it needed only until then.

    It vouches for what the run wrote. A file of `small` that something else changed or removed meanwhile is
    written again; what stood in its place is kept beside it (`FOREIGN`).

    Args:
        directory: of the run; every file of it is closed.
        written: key -> how far it was written, for the outputs that the disk has.
        small: key -> contents of the small files that were written when the run began.

    Raises:
        OutputError: it cannot be written, an output cannot be read, or, once the run is finished, a file of
            `small` was changed.
    """
    changes = [
        change for key, data in small.items() if (change := _restore(directory.path / FILES[key], data))
    ]
    positions = {key: Position(len(data), hashlib.sha256(data).hexdigest()) for key, data in small.items()}
    # With it the disk has the entries of the folder, too.
    write_atomically(directory.manifest, Manifest({**written, **positions}).text().encode("ascii"))
    tidy(directory)
    if changes:
        raise OutputError("; ".join(changes))


def _restore(path: Path, data: bytes) -> str | None:
    """Write a file again that does not hold `data` any more; what happened to it, in words."""
    with writing(path):
        if path.is_file() and not path.is_symlink() and path.read_bytes() == data:
            return None
        if not path.is_symlink() and not path.exists():
            write_atomically(path, data)
            return f"{path}: it was removed or renamed during the run, which wrote it again"
        foreign = path.with_name(path.name + FOREIGN)
        disk.replace(path, foreign)
        write_atomically(path, data)
    return (
        f"{path}: something else changed it during the run, which wrote its own again; the changed one is "
        f"now {foreign.name}"
    )


def add_output(directory: RunDirectory, key: str) -> None:
    """List an output that was made from a finished run, such as its page; an unfinished run lists none.

    Raises:
        OutputError: the output cannot be read, or the manifest cannot be written.
        RunDirectoryError: another process is writing the run.
        ManifestError: the manifest was changed.
    """
    if not directory.manifest.exists():
        return
    with lock_run(directory):
        manifest = read_manifest(directory.manifest)
        if manifest is not None:
            path = directory.path / FILES[key]
            with writing(path):
                outputs = {**manifest.outputs, key: read_position(path)}
            write_atomically(directory.manifest, Manifest(outputs).text().encode("ascii"))


def tidy(directory: RunDirectory) -> None:
    """Remove what a run needs only until it is finished.

    Raises:
        OutputError: it cannot be removed.
    """
    with writing(directory.path):
        names = {entry.name for entry in directory.path.iterdir()}
        for name in sorted(names & passing()):
            disk.unlink(directory.path / name)
        disk.sync_folder(directory.path)


def passing() -> set[str]:
    """The names of files that a finished run does without."""
    return {FILES[key] for key in PASSING} | {name + PART for name in FILES.values()}


def _varies(key: str) -> str:
    return VARIES.get(key, SAME)


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
    contents = {path.name: path.read_bytes() for path in replacing.iterdir()}
    present = {path.name for path in directory.path.iterdir()}
    run_names = {*FILES.values(), *(name + PART for name in FILES.values())}
    for name in sorted(present & (run_names - contents.keys())):
        disk.unlink(directory.path / name)
    for name, data in sorted(contents.items()):
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


COPIED = ("graph", "recipe", "truth", "inputs", "timings")
"""Files that are the same for the smoothed run."""


def write_smoothed(run: Run, smoothed: SmoothedRun, out: Path, overwrite: bool = False) -> None:
    """Write the smoothed run beside the one that it was made from.

    Raises:
        RunDirectoryError: `out` is the run itself, or holds something else.
        OutputError: a file cannot be written.
    """
    if out.resolve() == run.directory.path.resolve():
        raise RunDirectoryError(f"{out}: the run that is smoothed; give another folder")
    directory = RunDirectory.create(out, overwrite)
    with lock_run(directory):
        settle(directory)
        directory.refuse(overwrite)
        files = {key: (run.directory.path / FILES[key]) for key in COPIED}
        contents = {key: path.read_bytes() for key, path in files.items() if path.is_file()}
        # Empty, a journal makes the folder a run, which may be overwritten.
        replace_run(directory, {"journal": b"", **contents})
        with_csv = run.directory.csv.is_file()
        finish_run(directory, _write_lines(directory, smoothed, run.spec, with_csv), contents)


def _write_lines(
    directory: RunDirectory, smoothed: SmoothedRun, graph: GraphSpec, with_csv: bool
) -> dict[str, Position]:
    has_births = any(plate.birth is not None for plate in graph.targets.values())
    with ExitStack() as files:
        journal = files.enter_context(JournalWriter(directory.journal))
        frames = files.enter_context(FrameWriter(directory.frames))
        points = has_only_points(graph)
        mot = files.enter_context(MotWriter(directory.mot, not has_births, points=points))
        written: dict[str, LineFile] = {"journal": journal, "frames": frames, "mot": mot}
        csv: CsvWriter | None = None
        if with_csv or has_csv(graph):
            csv = CsvWriter(directory.csv, queries=number_columns(graph), points=points)
            written["csv"] = files.enter_context(csv)
        for event in smoothed.events:
            journal.write(event)
        for _, group in groupby(smoothed.metrics, key=lambda line: line.frame):
            lines = list(group)
            columns, tracked = measured(lines)
            frames.write_columns(columns)
            mot.write(tracked)
            if csv is not None:
                csv.write(tracked)
        for file in written.values():
            file.flush()
            file.sync()
        return {key: file.position for key, file in written.items()}
