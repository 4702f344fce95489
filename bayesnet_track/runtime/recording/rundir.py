"""The run directory: the names of a run's files, and when a folder may become one."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from bayesnet_track.journal import disk
from bayesnet_track.journal.codec import JournalError, check_version
from bayesnet_track.journal.writer import PART
from bayesnet_track.observation.settings import setting

MOST_FIRST_LINE = 1 << 24
"""Bytes of a journal's first line that are looked at."""
LOCK = ".lock"
"""Beside them, and none of them: nothing replaces or removes it."""
STAGED, REPLACING = ".staged", ".replacing"
"""Folders of a run that is about to replace the one beside them; see `runtime.recording.replace`."""


class RunDirectoryError(OSError):
    """A folder that cannot become, or is not, a run directory."""


class RunFile:
    """The path of a file of a run, by its name in the run's folder."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __get__(self, run: RunDirectory, kind: type[RunDirectory] | None = None) -> Path:
        return run.path / self.name


@dataclass(frozen=True)
class RunDirectory:
    """The folder of one run.

    Attributes:
        path: the folder.
    """

    path: Path

    recipe = RunFile("run.json")
    """What was asked for; see `runtime.checkpoints.recipe`."""
    journal = RunFile("journal.jsonl")
    """Events and decisions."""
    frames = RunFile("frames.npy.gz")
    """Metrics of every frame, as columns."""
    beliefs = RunFile("beliefs.jsonl")
    """Beliefs of every frame, where they were kept for smoothing."""
    forecasts = RunFile("forecasts.jsonl")
    """Where targets are expected some frames ahead, where that was asked for."""
    mot = RunFile("tracks.txt")
    """Tracks in MOT's format."""
    csv = RunFile("tracks.csv")
    """Tracks as CSV."""
    cameras = RunFile("cameras.csv")
    """Boxes in the image of each camera, where the graph has several."""
    queries = RunFile("queries.csv")
    """Answers to the queries of the graph, where it has any."""
    timings = RunFile("timings.jsonl")
    """Wall-clock timings: the only file that differs between equal runs."""
    graph = RunFile("graph.yaml")
    """The canonical text of the graph."""
    video = RunFile("video.mkv")
    """The annotated video."""
    mp4 = RunFile("video.mp4")
    """The same, where MP4 was asked for."""
    report = RunFile("report.html")
    """The page of the run."""
    truth = RunFile("truth.txt")
    """Ground truth of a synthetic scene: a corner box a line."""
    inputs = RunFile("inputs.jsonl")
    """What came from outside during the run."""
    ahead = RunFile("inputs_ahead.jsonl")
    """What came from outside for frames that are to be tracked again; see `pending_inputs`."""
    checkpoint = RunFile("checkpoint")
    """Where the run can go on from, while it is not at its end."""
    previous = RunFile("checkpoint.previous")
    """The checkpoint before that, for when it is damaged."""
    manifest = RunFile("manifest.json")
    """What a finished run left; see `runtime.recording.manifest`."""

    @classmethod
    def create(cls, path: Path | str, overwrite: bool = False) -> Self:
        """The folder at `path`, made where there is none; what is in it stays as it is.

        Raises:
            RunDirectoryError: it cannot be made, or see `refuse`.
        """
        run = cls(Path(path))
        try:
            if run.path.exists() and not run.path.is_dir():
                raise RunDirectoryError(f"{run.path}: it is a file; give a folder for the run")
            disk.make_folders(run.path)
            run.refuse(overwrite)
        except OSError as error:
            if isinstance(error, RunDirectoryError):
                raise
            raise RunDirectoryError(f"{run.path}: cannot make the run directory: {error.strerror}") from error
        return run

    @classmethod
    def open(cls, path: Path | str) -> Self:
        """The earlier run at `path`.

        Raises:
            RunDirectoryError: there is no journal in it.
            JournalError: another version wrote it.
        """
        run = cls(Path(path))
        try:
            if run.is_replacing:
                raise RunDirectoryError(
                    f"{run.path}: a new run is replacing the one that was here; if it was broken off, "
                    f"`bayesnet-track resume {run.path}` goes on with it"
                )
            is_there = disk.is_there(run.path)
            if not run.journal.is_file():
                fault = f"no {FILES['journal']} in it" if is_there else "no such folder"
                folder = run.path if is_there else run.path.parent
                raise RunDirectoryError(f"{run.path}: not a run directory: {fault}{_runs_in(folder)}")
        except OSError as error:  # a name that is too long
            if isinstance(error, RunDirectoryError):
                raise
            raise RunDirectoryError(f"{run.path}: not a run directory: {error.strerror}") from error
        run.check_version()
        return run

    def check_version(self) -> None:
        """Refuse a run of another version by the first line of its journal, where that can be read.

        Raises:
            JournalError: names the version.
        """
        try:
            with self.journal.open("rb") as file:
                first = json.loads(file.readline(MOST_FIRST_LINE))
            if isinstance(first, dict) and first.get("event") == "run_started":
                check_version(first)
        except JournalError as error:
            raise JournalError(f"{self.path}: {error}") from None
        except (OSError, ValueError, RecursionError):
            return  # whoever reads it says what is wrong

    def refuse(self, overwrite: bool) -> None:
        """Refuse a folder that holds something else than a run, and without `overwrite` one that holds a run.

        Raises:
            RunDirectoryError: it does.
            OSError: it cannot be read.
        """
        names = {entry.name for entry in self.path.iterdir()} - {LOCK, STAGED}
        names -= {name + PART for name in FILES.values()}
        if not names:
            return
        if names.isdisjoint(MARKS):
            raise RunDirectoryError(
                f"{self.path}: the folder is not empty and not a run; give a new or an empty folder"
            )
        if not overwrite:
            raise RunDirectoryError(
                f"{self.path}: a run is there already; give another folder, or overwrite it "
                f"({setting('--overwrite')})"
            )

    def clear(self) -> None:
        """Remove the files of a run (`FILES`), and parts of them; nothing else.

        Raises:
            RunDirectoryError: one cannot be removed.
        """
        # The manifest and the checkpoint go first: they must not outlive what they stand for. The journal
        # goes last: a half-cleared folder still counts as a run.
        order = [name + PART for name in FILES.values()]
        order += [FILES[key] for key in ("manifest", "checkpoint", "previous", "recipe")]
        order += [name for name in FILES.values() if name not in (*order, FILES["journal"])]
        try:
            names = {entry.name for entry in self.path.iterdir()}
            for name in (*order, FILES["journal"]):
                if name in names:
                    disk.unlink(self.path / name)
        except OSError as error:
            raise RunDirectoryError(f"{self.path}: cannot clear it: {error}") from error

    def write_text(self, path: Path, text: str) -> None:
        """Write one of the run's small files as UTF-8 with plain newlines.

        Raises:
            RunDirectoryError: it cannot be written.
        """
        try:
            with closing(disk.open_raw(path, "wb")) as file:
                disk.write_whole(file, text.encode("utf-8"))
                disk.sync(file)
        except OSError as error:
            raise RunDirectoryError(f"{path}: cannot write: {error.strerror}") from error

    @property
    def lock(self) -> Path:
        """The file that is locked while a process writes the run; see `runtime.recording.lock`."""
        return self.path / LOCK

    @property
    def is_replacing(self) -> bool:
        """True if a new run is taking the place of an earlier one here; see `runtime.recording.replace`."""
        return (self.path / REPLACING).is_dir()

    @property
    def holds_run(self) -> bool:
        """True if a run is here, in whatever state."""
        return any((self.path / name).exists() for name in MARKS)


FILES = {key: file.name for key, file in vars(RunDirectory).items() if isinstance(file, RunFile)}
"""Key of each file of a run -> its name."""
MARKS = (FILES["recipe"], FILES["journal"], REPLACING)
"""A folder that holds one of them is a run."""


def _runs_in(folder: Path) -> str:
    """The runs that a folder holds, for a message."""
    names = sorted(journal.parent.name for journal in folder.glob(f"*/{FILES['journal']}"))
    remainder = f" and {len(names) - 5} more" if len(names) > 5 else ""
    return f"; runs in {folder}: {', '.join(names[:5])}{remainder}" if names else ""
