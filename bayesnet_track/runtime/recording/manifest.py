"""The manifest: which bytes a finished run left. Writing it is what finishes a run.

It is written after every other output is closed and on the disk, whole or not at all. A run without one is
unfinished, whatever its journal says.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesnet_track.journal import disk
from bayesnet_track.journal.writer import (
    PART,
    OutputError,
    Position,
    read_position,
    write_atomically,
    writing,
)
from bayesnet_track.runtime.recording.lock import lock_run
from bayesnet_track.runtime.recording.rundir import FILES, RunDirectory

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
    """What a finished run left.

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
            FILES[key]: {"size": at.size, "sha256": at.sha256, "varies_with": _varies(key)}
            for key, at in sorted(self.outputs.items(), key=lambda item: FILES[item[0]])
        }
        held: dict[str, Any] = {"manifest": FORMAT, "outputs": outputs, "result": self.result}
        seal = hashlib.sha256(json.dumps(held).encode("ascii")).hexdigest()
        return json.dumps({**held, "seal": seal}, indent=1) + "\n"


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
        held = json.loads(data)
        version, keys = held["manifest"], {name: key for key, name in FILES.items()}
        if version != FORMAT:
            raise ManifestError(f"{path}: version {version} of the format; this program reads {FORMAT}")
        outputs = held["outputs"].items()
        found = Manifest({keys[name]: Position(one["size"], one["sha256"]) for name, one in outputs})
        is_whole = found.text().encode("ascii") == data
    except ManifestError:
        raise
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        is_whole = False
    if not is_whole:
        raise ManifestError(f"{path}: changed since it was written: it vouches for nothing any more")
    return found


def finish(directory: RunDirectory, written: Mapping[str, Position], own: Mapping[str, bytes]) -> None:
    """Write the manifest, by which the run is finished, and remove what it needed only until then.

    It vouches for what the run wrote. A file of `own` that something else changed or removed meanwhile is
    written again; what stood in its place is kept beside it (`FOREIGN`).

    Args:
        directory: of the run; every file of it is closed.
        written: key -> how far it was written, for the outputs that the disk has.
        own: key -> contents of the small files that were written when the run began.

    Raises:
        OutputError: it cannot be written, an output cannot be read, or, once the run is finished, a file of
            `own` was changed.
    """
    changed = [found for key, data in own.items() if (found := _restore(directory.path / FILES[key], data))]
    positions = {key: Position(len(data), hashlib.sha256(data).hexdigest()) for key, data in own.items()}
    # With it the disk has the entries of the folder, too.
    write_atomically(directory.manifest, Manifest({**written, **positions}).text().encode("ascii"))
    tidy(directory)
    if changed:
        raise OutputError("; ".join(changed))


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
        held = {entry.name for entry in directory.path.iterdir()}
        for name in sorted(held & passing()):
            disk.unlink(directory.path / name)
        disk.sync_folder(directory.path)


def passing() -> set[str]:
    """The names of files that a finished run does without."""
    return {FILES[key] for key in PASSING} | {name + PART for name in FILES.values()}


def _varies(key: str) -> str:
    return VARIES.get(key, SAME)
