"""State of a run's folder before it goes on: how far it came, its pending inputs, what has changed.

``inputs.jsonl`` is cut off at the checkpoint. Until the run has come past them again, the lines behind it are
in a file of their own: else they would be gone when it is broken off a second time.

Compare a run directory with its manifest: whether every output is, byte for byte, what was written.
"""

from __future__ import annotations

import stat
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Literal

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.journal.codec import JournalError, from_json
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.runs import RunEnded
from bayesnet_track.journal.reader import Notice
from bayesnet_track.journal.writer import Position, read_position
from bayesnet_track.observation.cue import ENTRY_POINT_GROUP
from bayesnet_track.observation.cue_files import GivenCue, file_of, own_cues
from bayesnet_track.observation.plugins import given
from bayesnet_track.observation.settings import setting
from bayesnet_track.runtime.checkpoints.checkpoint import Checkpoint, newest_checkpoint
from bayesnet_track.runtime.checkpoints.recipe import Recipe
from bayesnet_track.runtime.recording.manifest import Manifest, is_locked, passing, read_manifest
from bayesnet_track.runtime.recording.rundir import FILES, LOCK, STAGED, RunDirectory
from bayesnet_track.runtime.recording.tracks import MOST_BOXES, crowd_boxes
from bayesnet_track.runtime.results import FrameSource

TAIL_BYTES = 1 << 16


@dataclass(frozen=True)
class RunStanding:
    """Progress of a run.

    Attributes:
        is_finished: whether its source was read to its end, and every output is whole on the disk.
        frame: last frame of the checkpoint, from which it can go on; None where it begins anew.
        reason: why it ended, in the words of `RunEnded.reason`; None when nothing in the journal says so.
    """

    is_finished: bool
    frame: int | None = None
    reason: str | None = None


def standing(path: str | PathLike[str]) -> RunStanding:
    """Progress of the run in a directory, by its files alone.

    Raises:
        RecipeError: it is no run that can be done again.
        JournalError: another version wrote it.
        CheckpointError: the checkpoint is damaged or of another version.
        ManifestError: the manifest was changed or is of another version.
    """
    directory = RunDirectory(Path(path))
    if directory.is_replacing:  # nothing of it was tracked yet
        return RunStanding(False)
    directory.check_version()
    Recipe.read(directory)
    reason = _ending(directory.journal)
    if read_manifest(directory.manifest) is not None:
        return RunStanding(True, None, reason)
    checkpoint = newest_checkpoint(directory)
    if checkpoint is not None:
        return RunStanding(False, checkpoint.frame, reason)
    return RunStanding(False, None, reason)


def _ending(journal: Path) -> str | None:
    """The reason in the journal's last whole line, where that is its end."""
    try:
        with journal.open("rb") as file:
            file.seek(0, 2)
            file.seek(max(0, file.tell() - TAIL_BYTES))
            lines = file.read().split(b"\n")
        event: Event | object = from_json(lines[-2].decode("utf-8")) if len(lines) > 1 else None
    except (OSError, JournalError, UnicodeDecodeError):
        return None
    return event.reason if isinstance(event, RunEnded) else None


class ResumeError(ValueError):
    """A run that cannot go on: it, its source or this program is another than it was."""


def check_same(
    recipe: Recipe, source: FrameSource | None, motion: MotionModel | None, at_hosts: bool
) -> None:
    """Refuse another version, another source, other files; raises ResumeError, OSError, SourceError.

    What a source `at_hosts` is, they say when it is opened.
    """
    if recipe.own_motion and motion is None:
        raise ResumeError("it was tracked with a motion model of one's own: give it again, in Python")
    if recipe.origin.only_once is not None:
        if source is None:
            raise ResumeError(f"it cannot go on: {recipe.origin.only_once}")
        if recipe.has_video:
            raise ResumeError(f"its video cannot be drawn again: {recipe.origin.only_once}")
    files = (*recipe.detection_files.values(), recipe.inputs)
    changes = [file.changes for file in files if file is not None]
    _refuse_changes([recipe.origin.changes, *changes] if source is None and not at_hosts else changes)


def check_files(recipe: Recipe) -> None:
    """Refuse files of the graph that are gone or are not those of the run; raises ResumeError."""
    files = (*recipe.masks.values(), *recipe.calibrations.values(), *recipe.models.values())
    _refuse_changes([file.changes for file in files])


def _refuse_changes(finders: Iterable[Callable[[], Iterable[str]]]) -> None:
    try:
        changes = [change for find in finders for change in find()]
    except OSError as error:
        raise ResumeError(
            f"{error.filename}: it reads this file, and it cannot be read: {error.strerror}"
        ) from error
    if changes:
        raise ResumeError(f"what it reads is not what it was: {'; '.join(changes)}")


def check_cues(recipe: Recipe, cues: Iterable[GivenCue]) -> None:
    """Refuse cues of one's own that are not those of the run, or that are not given again.

    What the run directory names is data, and may come from elsewhere: no code is run for that alone.

    Raises:
        ResumeError: names the cue and the file.
        CueError: a file of `cues` cannot be loaded.
    """
    available = {**given(ENTRY_POINT_GROUP), **own_cues(cues)}
    for name, was in recipe.cue_files.items():
        file = None if name not in available else file_of(available[name])
        if file is None:
            raise ResumeError(
                f"its cue {name!r} is the code in {was.path} (SHA-256 {was.sha256[:12]}), which is run only "
                f"when it is named: {setting('--cue-file', was.path, repr([was.path]))}"
            )
        if file.sha256 != was.sha256:
            raise ResumeError(
                f"{file.path}: SHA-256 {file.sha256[:12]}; its cue {name!r} was {was.path} with "
                f"{was.sha256[:12]}: give that file as it was"
            )
    missing = [name for name in recipe.own_cues if name not in available]
    if missing:
        raise ResumeError(
            f"it was tracked with the cue {missing[0]!r} of a program of one's own: give it again, in Python "
            "(cues=)"
        )


def check_outputs(directory: RunDirectory, checkpoint: Checkpoint, say: Notice) -> None:
    """Refuse outputs whose bytes up to the checkpoint are not those that were written.

    Raises:
        ResumeError: names the file.
    """
    for key, place in checkpoint.written.positions.items():
        path = directory.path / FILES[key]
        if key == "mot" and _leaves_out_mot(directory):
            continue
        try:
            actual = read_position(path, place.size)
            size = path.stat().st_size
        except OSError as error:
            raise ResumeError(f"{path}: {error.strerror}") from error
        if actual.size < place.size:
            raise ResumeError(f"{path}: cut off: {actual.size} bytes of {place.size} are left")
        if actual != place:
            raise ResumeError(
                f"{path}: changed since it was written: its first {place.size} bytes are others"
            )
        if size > place.size and not _ends_with_newline(path):
            say(f"{path}: the last line is torn and was dropped")


def _leaves_out_mot(directory: RunDirectory) -> bool:
    """True if a run has no ``tracks.txt`` since it has more than `MOST_BOXES`, and nobody removed it."""
    if directory.mot.exists() or not directory.frames.is_file():
        return False
    return crowd_boxes(directory.frames) > MOST_BOXES


def _ends_with_newline(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, 2)
        return file.read(1) == b"\n"


Finding = Literal["ok", "missing", "truncated", "changed", "extra"]
Status = Literal["verified", "changed", "unfinished", "running"]

MADE_LATER = frozenset({"report", FILES["report"]})
"""What `report` may have made before the run was finished, or in a folder of its own."""


@dataclass(frozen=True)
class Verified:
    """Findings about a run's files.

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
    findings = {name: _finding(directory.path / name, names[name]) for name in sorted(names)}
    expected = {*names, FILES["manifest"], LOCK, STAGED, *passing(), *MADE_LATER}
    extras = sorted(entry.name for entry in directory.path.iterdir() if entry.name not in expected)
    return {**findings, **dict.fromkeys(extras, "extra")}


def _finding(path: Path, written: Position) -> Finding:
    try:
        is_file = stat.S_ISREG(path.stat().st_mode)
    except FileNotFoundError:
        return "missing"
    if not is_file:
        return "changed"
    actual = read_position(path)
    if actual == written:
        return "ok"
    is_cut = actual.size < written.size
    return "truncated" if is_cut else "changed"
