"""The run directory: the names of a run's files, and when a folder may become one."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from bayesnet_track.journal import disk
from bayesnet_track.journal.atomic import PART

FILES = {
    "recipe": "run.json",
    "journal": "journal.jsonl",
    "frames": "frames.jsonl",
    "beliefs": "beliefs.jsonl",
    "forecasts": "forecasts.jsonl",
    "mot": "tracks.txt",
    "csv": "tracks.csv",
    "timings": "timings.jsonl",
    "graph": "graph.yaml",
    "video": "video.mkv",
    "mp4": "video.mp4",
    "report": "report.html",
    "truth": "truth.txt",
    "inputs": "inputs.jsonl",
    "ahead": "inputs_ahead.jsonl",
    "checkpoint": "checkpoint",
    "previous": "checkpoint.previous",
    "manifest": "manifest.json",
}
LOCK = ".lock"
"""Beside them, and none of them: nothing replaces or removes it."""
STAGED, REPLACING = ".staged", ".replacing"
"""Folders of a run that is about to replace the one beside them; see `runtime.recording.replace`."""
MARKS = (FILES["recipe"], FILES["journal"], REPLACING)
"""A folder that holds one of them is a run."""


class RunDirectoryError(OSError):
    """A folder that cannot become, or is not, a run directory."""


@dataclass(frozen=True)
class RunDirectory:
    """The folder of one run.

    Attributes:
        path: the folder.
    """

    path: Path

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
        """
        run = cls(Path(path))
        try:
            if run.is_replacing:
                raise RunDirectoryError(
                    f"{run.path}: a new run is replacing the one that was here; if it was broken off, "
                    f"`bayesnet-track resume {run.path}` goes on with it"
                )
            if not run.journal.is_file():
                what = "no such folder" if not run.path.exists() else f"no {FILES['journal']} in it"
                raise RunDirectoryError(f"{run.path}: not a run directory: {what}")
        except OSError as error:  # a name that is too long
            if isinstance(error, RunDirectoryError):
                raise
            raise RunDirectoryError(f"{run.path}: not a run directory: {error.strerror}") from error
        return run

    def refuse(self, overwrite: bool) -> None:
        """Refuse a folder that holds something else than a run, and without `overwrite` one that holds a run.

        Raises:
            RunDirectoryError: it does.
            OSError: it cannot be read.
        """
        held = {entry.name for entry in self.path.iterdir()} - {LOCK, STAGED}
        held -= {name + PART for name in FILES.values()}
        if not held:
            return
        if held.isdisjoint(MARKS):
            raise RunDirectoryError(
                f"{self.path}: the folder is not empty and not a run; give a new or an empty folder"
            )
        if not overwrite:
            raise RunDirectoryError(
                f"{self.path}: a run is there already; give another folder, or overwrite it "
                "(--overwrite, overwrite=True)"
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
            held = {entry.name for entry in self.path.iterdir()}
            for name in (*order, FILES["journal"]):
                if name in held:
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
    def recipe(self) -> Path:
        """What was asked for; see `runtime.checkpoints.recipe`."""
        return self.path / FILES["recipe"]

    @property
    def journal(self) -> Path:
        """Events and decisions."""
        return self.path / FILES["journal"]

    @property
    def frames(self) -> Path:
        """Metrics of every frame."""
        return self.path / FILES["frames"]

    @property
    def forecasts(self) -> Path:
        """Where targets are expected some frames ahead, where that was asked for."""
        return self.path / FILES["forecasts"]

    @property
    def beliefs(self) -> Path:
        """Beliefs of every frame, where they were kept for smoothing."""
        return self.path / FILES["beliefs"]

    @property
    def mot(self) -> Path:
        """Tracks in MOT's format."""
        return self.path / FILES["mot"]

    @property
    def csv(self) -> Path:
        """Tracks as CSV."""
        return self.path / FILES["csv"]

    @property
    def timings(self) -> Path:
        """Wall-clock timings: the only file that differs between equal runs."""
        return self.path / FILES["timings"]

    @property
    def graph(self) -> Path:
        """The canonical text of the graph."""
        return self.path / FILES["graph"]

    @property
    def video(self) -> Path:
        """The annotated video."""
        return self.path / FILES["video"]

    @property
    def mp4(self) -> Path:
        """The same, where MP4 was asked for."""
        return self.path / FILES["mp4"]

    @property
    def report(self) -> Path:
        """The page of the run."""
        return self.path / FILES["report"]

    @property
    def truth(self) -> Path:
        """Ground truth of a synthetic scene: a corner box a line."""
        return self.path / FILES["truth"]

    @property
    def checkpoint(self) -> Path:
        """Where the run can go on from, while it is not at its end."""
        return self.path / FILES["checkpoint"]

    @property
    def previous(self) -> Path:
        """The checkpoint before that, for when it is damaged."""
        return self.path / FILES["previous"]

    @property
    def is_replacing(self) -> bool:
        """Whether a new run is taking the place of an earlier one here; see `runtime.recording.replace`."""
        return (self.path / REPLACING).is_dir()

    @property
    def holds_run(self) -> bool:
        """Whether a run is here, in whatever state."""
        return any((self.path / name).exists() for name in MARKS)

    @property
    def manifest(self) -> Path:
        """What a finished run left; see `runtime.recording.manifest`."""
        return self.path / FILES["manifest"]

    @property
    def inputs(self) -> Path:
        """What came from outside during the run."""
        return self.path / FILES["inputs"]

    @property
    def ahead(self) -> Path:
        """What came from outside for frames that are to be tracked again; see `pending_inputs`."""
        return self.path / FILES["ahead"]
