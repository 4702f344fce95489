"""Write a smoothed run as a run directory, which every command that reads runs can read."""

from __future__ import annotations

from contextlib import ExitStack
from itertools import groupby
from pathlib import Path

from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.journal.frame_file import FrameWriter
from bayesnet_track.journal.writer import JournalWriter, LineFile, Position
from bayesnet_track.runtime.recording.lock import lock_run
from bayesnet_track.runtime.recording.manifest import finish
from bayesnet_track.runtime.recording.measured import measured
from bayesnet_track.runtime.recording.replace import replace_run, settle
from bayesnet_track.runtime.recording.run_reader import Run
from bayesnet_track.runtime.recording.rundir import FILES, RunDirectory, RunDirectoryError
from bayesnet_track.runtime.recording.tracks import (
    CsvWriter,
    MotWriter,
    has_csv,
    has_only_points,
    number_columns,
)
from bayesnet_track.runtime.smoothing import SmoothedRun

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
        held = {key: path.read_bytes() for key, path in files.items() if path.is_file()}
        # Empty, a journal makes the folder a run, which may be overwritten.
        replace_run(directory, {"journal": b"", **held})
        with_csv = run.directory.csv.is_file()
        finish(directory, _write_lines(directory, smoothed, run.spec, with_csv), held)


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
