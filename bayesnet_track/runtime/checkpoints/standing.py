"""How far a run came, told from its folder: begun, broken off, finished."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from bayesnet_track.journal.codec import JournalError, from_json
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.runs import RunEnded
from bayesnet_track.runtime.checkpoints.checkpoint_file import newest_checkpoint
from bayesnet_track.runtime.checkpoints.recipe import Recipe
from bayesnet_track.runtime.recording.manifest import read_manifest
from bayesnet_track.runtime.recording.rundir import RunDirectory

TAIL_BYTES = 1 << 16


@dataclass(frozen=True)
class Standing:
    """How a run stands.

    Attributes:
        is_finished: whether its source was read to its end, and every output is whole on the disk.
        frame: last frame of the checkpoint, from which it can go on; None where it begins anew.
        reason: why it ended, in the words of `RunEnded.reason`; None when nothing in the journal says so.
    """

    is_finished: bool
    frame: int | None = None
    reason: str | None = None


def standing(path: str | PathLike[str]) -> Standing:
    """How the run in a directory stands, by its files alone.

    Raises:
        RecipeError: it is no run that can be done again.
        JournalError: another version wrote it.
        CheckpointError: the checkpoint is damaged or of another version.
        ManifestError: the manifest was changed or is of another version.
    """
    directory = RunDirectory(Path(path))
    if directory.is_replacing:  # nothing of it was tracked yet
        return Standing(False)
    directory.check_version()
    Recipe.read(directory)
    reason = _ending(directory.journal)
    if read_manifest(directory.manifest) is not None:
        return Standing(True, None, reason)
    checkpoint = newest_checkpoint(directory)
    if checkpoint is not None:
        return Standing(False, checkpoint.frame, reason)
    return Standing(False, None, reason)


def _ending(journal: Path) -> str | None:
    """The reason in the journal's last whole line, where that is its end."""
    try:
        with journal.open("rb") as file:
            file.seek(0, 2)
            file.seek(max(0, file.tell() - TAIL_BYTES))
            lines = file.read().split(b"\n")
        last: Event | object = from_json(lines[-2].decode("utf-8")) if len(lines) > 1 else None
    except (OSError, JournalError, UnicodeDecodeError):
        return None
    return last.reason if isinstance(last, RunEnded) else None
