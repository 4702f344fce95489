"""The table of results as a file, which is whole at any moment and loses no row of an earlier batch."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Self

from bayesnet_track.cli.batch.jobs import Job
from bayesnet_track.cli.batch.places import Progress
from bayesnet_track.cli.batch.table import csv_text, read_table
from bayesnet_track.cli.batch.work import Row
from bayesnet_track.journal.writer import write_atomically

EVERY_S = 1.0
"""Seconds after which the table is written again while it grows."""


class Results:
    """The rows of a batch, and the file of its table: written anew while it grows, and when it is left.

    Rows that are there from before stay until there is another for the same video and seed.

    Raises:
        BatchError: the file is no table of a batch.
        OSError: it cannot be read.
    """

    def __init__(self, path: Path, jobs: Sequence[Job]) -> None:
        self._path, self._jobs = path, jobs
        self._earlier = read_table(path)
        self._rows: dict[Job, Row] = {}
        self._written, self._is_changed = time.monotonic(), False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._is_changed or not self._path.exists():
            self._write()

    def add(self, report: Progress | None) -> None:
        """Take the row of a job that is over."""
        if report is not None and report.row is not None:
            self._rows[report.job], self._is_changed = report.row, True
        if self._is_changed and time.monotonic() >= self._written + EVERY_S:
            self._write()

    def rows(self) -> list[Row]:
        """The rows of the jobs that are over, in the order of the jobs."""
        return [self._rows[job] for job in self._jobs if job in self._rows]

    def _write(self) -> None:
        """First the jobs of this batch in their order, then what else there is from before."""
        table: dict[tuple[str, str], Row] = {}
        for job in self._jobs:
            key = job.video.name, str(job.seed)
            row = self._rows.get(job) or self._earlier.get(key)
            table |= {} if row is None else {key: row}
        others = {key: row for key, row in self._earlier.items() if key not in table}
        write_atomically(self._path, csv_text((table | others).values()).encode("utf-8"))
        self._written, self._is_changed = time.monotonic(), False
