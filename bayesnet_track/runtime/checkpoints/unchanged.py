"""What must be as it was for a run to go on: its source, its outputs, the libraries and the machine."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.journal.events.runs import MachineChanged
from bayesnet_track.journal.reader import Notice
from bayesnet_track.journal.writer import read_position
from bayesnet_track.observation.cue import ENTRY_POINT_GROUP
from bayesnet_track.observation.cue_files import GivenCue, file_of, own_cues
from bayesnet_track.observation.plugins import given
from bayesnet_track.observation.settings import setting
from bayesnet_track.runtime.checkpoints.checkpoint_file import Checkpoint
from bayesnet_track.runtime.checkpoints.origins import describe_machine, name_differences, versions
from bayesnet_track.runtime.checkpoints.recipe import Recipe
from bayesnet_track.runtime.recording.rundir import FILES, RunDirectory
from bayesnet_track.runtime.results import FrameSource


class ResumeError(ValueError):
    """A run that cannot go on: it, its source or this program is another than it was."""


def check_plain(directory: RunDirectory) -> None:
    """Refuse files that are links or no files: what is written here must not end up elsewhere.

    Raises:
        ResumeError: names the file.
    """
    for name in FILES.values():
        path = directory.path / name
        if path.is_symlink() or (path.exists() and not path.is_file()):
            raise ResumeError(f"{path}: it is a link or no plain file; put the file itself there")


def check_same(recipe: Recipe, source: FrameSource | None, motion: MotionModel | None) -> None:
    """Refuse another version, another source, other files; raises ResumeError, OSError, SourceError."""
    if recipe.own_motion and motion is None:
        raise ResumeError("it was tracked with a motion model of one's own: give it again, in Python")
    if recipe.origin.only_once is not None:
        if source is None:
            raise ResumeError(f"it cannot go on: {recipe.origin.only_once}")
        if recipe.has_video:
            raise ResumeError(f"its video cannot be drawn again: {recipe.origin.only_once}")
    given = [file.changes for file in (recipe.detections, recipe.inputs) if file is not None]
    _refuse_changes([recipe.origin.changes, *given] if source is None else given)


def check_files(recipe: Recipe) -> None:
    """Refuse masks and model files that are gone or are not those of the run; raises ResumeError."""
    _refuse_changes([file.changes for file in (*recipe.masks.values(), *recipe.models.values())])


def _refuse_changes(asked: Iterable[Callable[[], Iterable[str]]]) -> None:
    try:
        changes = [change for find in asked for change in find()]
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
    own = {**given(ENTRY_POINT_GROUP), **own_cues(cues)}
    for name, was in recipe.cue_files.items():
        file = None if name not in own else file_of(own[name])
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
    missing = [name for name in recipe.own_cues if name not in own]
    if missing:
        raise ResumeError(
            f"it was tracked with the cue {missing[0]!r} of a program of one's own: give it again, in Python "
            "(cues=)"
        )


def permit_move(
    recipe: Recipe, checkpoint: Checkpoint | None, is_allowed: bool, say: Notice
) -> tuple[MachineChanged, ...]:
    """What to write down where the run goes on elsewhere; raises ResumeError where that is not allowed."""
    if checkpoint is None:
        changes = name_differences(recipe.versions, versions())
    else:
        changes = name_differences(checkpoint.machine, describe_machine())
    if not changes:
        return ()
    what = "; ".join(changes)
    if not is_allowed:
        raise ResumeError(
            "it was computed on another machine or with other libraries, which give other last digits: "
            f"{what}; {setting('--allow-other-machine')} goes on all the same, and the result equals no "
            "unbroken run's"
        )
    say(f"it goes on although the machine or libraries differ: {what}")
    return () if checkpoint is None else (MachineChanged(checkpoint.frame + 1, changes),)


def check_outputs(directory: RunDirectory, checkpoint: Checkpoint, say: Notice) -> None:
    """Refuse outputs whose bytes up to the checkpoint are not those that were written.

    Raises:
        ResumeError: names the file.
    """
    for key, place in checkpoint.written.positions.items():
        path = directory.path / FILES[key]
        try:
            found = read_position(path, place.size)
            size = path.stat().st_size
        except OSError as error:
            raise ResumeError(f"{path}: {error.strerror}") from error
        if found.size < place.size:
            raise ResumeError(f"{path}: cut off: {found.size} bytes of {place.size} are left")
        if found != place:
            raise ResumeError(
                f"{path}: changed since it was written: its first {place.size} bytes are others"
            )
        if size > place.size and not _ends_with_newline(path):
            say(f"{path}: the last line is torn and was dropped")


def _ends_with_newline(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, 2)
        return file.read(1) == b"\n"
