"""Compare a run directory with its manifest: whether every output is, byte for byte, what was written."""

from __future__ import annotations

import stat
from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Literal

from bayesnet_track.journal.writer import Position, read_position
from bayesnet_track.runtime.checkpoints.standing import standing
from bayesnet_track.runtime.recording.lock import is_locked
from bayesnet_track.runtime.recording.manifest import Manifest, passing, read_manifest
from bayesnet_track.runtime.recording.rundir import FILES, LOCK, STAGED, RunDirectory

Finding = Literal["ok", "missing", "truncated", "changed", "extra"]
Status = Literal["verified", "changed", "unfinished", "running"]

MADE_LATER = frozenset({"report", FILES["report"]})
"""What `report` may have made before the run was finished, or in a folder of its own."""


@dataclass(frozen=True)
class Verified:
    """What was found.

    Attributes:
        status: ``verified``; ``changed``, see `outputs`; ``unfinished``: there is no manifest yet, and
            `resume` goes on; ``running``: a process writes the run now.
        outputs: name -> what it is, in the order of the manifest, then what is extra.
        result: the manifest's SHA-256 of all outputs that equal inputs make equal; None without a manifest.
    """

    status: Status
    outputs: Mapping[str, Finding] = field(default_factory=dict)
    result: str | None = None


def verify(path: str | PathLike[str]) -> Verified:
    """Compare the run in a directory with its manifest; nothing is changed.

    Raises:
        RecipeError: it is no run.
        JournalError: another version wrote it.
        CheckpointError: it is unfinished, and its checkpoint is damaged.
        ManifestError: the manifest itself was changed, or is of another version.
        OSError: an output cannot be read.
    """
    directory = RunDirectory(Path(path))
    if is_locked(directory):
        return Verified("running")
    if directory.is_replacing:
        return Verified("unfinished")
    directory.check_version()
    manifest = read_manifest(directory.manifest)
    if manifest is None:
        standing(path)  # says where it is no run at all
        return Verified("unfinished")
    outputs = _outputs(directory, manifest)
    is_same = all(finding == "ok" for finding in outputs.values())
    return Verified("verified" if is_same else "changed", outputs, manifest.result)


def _outputs(directory: RunDirectory, manifest: Manifest) -> dict[str, Finding]:
    names = {FILES[key]: place for key, place in manifest.outputs.items()}
    found = {name: _finding(directory.path / name, names[name]) for name in sorted(names)}
    known = {*names, FILES["manifest"], LOCK, STAGED, *passing(), *MADE_LATER}
    others = sorted(entry.name for entry in directory.path.iterdir() if entry.name not in known)
    return {**found, **dict.fromkeys(others, "extra")}


def _finding(path: Path, written: Position) -> Finding:
    try:
        is_file = stat.S_ISREG(path.stat().st_mode)
    except FileNotFoundError:
        return "missing"
    if not is_file:
        return "changed"
    found = read_position(path)
    if found == written:
        return "ok"
    is_cut = found.size < written.size
    return "truncated" if is_cut else "changed"
