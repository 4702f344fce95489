"""Ledger of a batch: its finished runs with their rows, a line each, so that none is opened again.

The folder `.batch` below the folder of the runs has a file of lines for each process that works on the batch.
A line holds for the same request, as long as the run's manifest and the files of its start and of its ground
truth are those that were there. A line that is torn, or no longer holds, costs no more than reading the run
itself.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bayesnet_track.cli.batch.jobs import LEDGER, Job
from bayesnet_track.cli.batch.work import FINISHED, ROW, Row
from bayesnet_track.journal.writer import writing
from bayesnet_track.runtime.recording.rundir import FILES
from bayesnet_track.sources.paths import is_file

Mark = list[list[int]]
"""Size and time of the last change, in ns, of the manifest and of each file that is given."""


class Ledger:
    """The finished runs of a batch below a folder.

    Attributes:
        path: the file that is written by this process.

    Raises:
        OSError: a file cannot be read.
    """

    def __init__(self, out: Path, name: str, graph_sha256: str) -> None:
        self.path = out / LEDGER / f"{name}.jsonl"
        self._graph = graph_sha256
        self._lines: dict[str, tuple[Mark, Row]] = {}
        self._is_torn = False
        for path in sorted(self.path.parent.glob("*.jsonl")):
            self._read(path)

    def _read(self, path: Path) -> None:
        data = path.read_bytes()
        self._is_torn |= path == self.path and bool(data) and not data.endswith(b"\n")
        for line in data.splitlines():
            try:
                entry = json.loads(line)
                row: Row = {name: entry["row"][name] for name in ROW}
                self._lines[str(entry["job"])] = entry["mark"], row
            except (ValueError, KeyError, TypeError):
                continue

    def row(self, job: Job) -> Row | None:
        """The row of a run that is finished, and still there as it was; None of every other."""
        entry = self._lines.get(self._key(job))
        if entry is None or entry[0] != _mark(job):
            return None
        return entry[1]

    def add(self, jobs: Sequence[tuple[Job, Row]]) -> None:
        """Note runs that are over, as far as they are finished; raises OutputError."""
        lines = []
        for job, row in jobs:
            mark = _mark(job)
            if row["status"] == FINISHED and mark is not None:
                lines.append(json.dumps({"job": self._key(job), "mark": mark, "row": row}) + "\n")
        if not lines:
            return
        with writing(self.path):
            self.path.parent.mkdir(exist_ok=True)
            with self.path.open("a", encoding="utf-8") as file:
                file.write("\n" * self._is_torn + "".join(lines))
        self._is_torn = False

    def _key(self, job: Job) -> str:
        """What is asked for, wherever it is put, as a SHA-256."""
        asked: dict[str, Any] = {**asdict(job), "out": Path(job.out).name, "graph": self._graph}
        if is_file(job.video.source):
            asked["video"]["source"] = str(Path(job.video.source).absolute())
        asked["cue_files"] = [[file, *(_stat(Path(file)) or ())] for file in job.cue_files]
        return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()


def _mark(job: Job) -> Mark | None:
    """Of the files of a run and of its start and ground truth; None where one is missing."""
    given = [file for file in (job.video.init_from, job.video.truth) if file is not None]
    stats = [_stat(path) for path in (Path(job.out) / FILES["manifest"], *map(Path, given))]
    return None if None in stats else [stat for stat in stats if stat is not None]


def _stat(path: Path) -> list[int] | None:
    try:
        held = path.stat()
    except OSError:
        return None
    return [held.st_size, held.st_mtime_ns]
