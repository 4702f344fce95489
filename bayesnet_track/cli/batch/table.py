"""What a batch shows: how far each job is, and the table of results."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from typing import TextIO

from bayesnet_track.cli.batch.jobs import Job
from bayesnet_track.cli.batch.places import Progress
from bayesnet_track.cli.batch.work import FAILED, ROW, Row


class BatchProgress:
    """On a terminal a table that is drawn anew; elsewhere a line for each job that is over."""

    def __init__(self, stream: TextIO, jobs: Sequence[Job], is_terminal: bool) -> None:
        self._stream, self._redraws, self._all = stream, is_terminal, len(jobs)
        self._running: dict[Job, Progress] = {}
        self._over, self._failed, self._drawn = 0, 0, 0

    def update(self, report: Progress) -> None:
        """Take what is reported of a job, and show it."""
        lines = []
        if report.row is None:
            self._running[report.job] = report
        else:
            self._running.pop(report.job, None)
            self._over += 1
            self._failed += report.row["status"] == FAILED
            lines = [f"{report.job.label}: {result(report.row)}"]
        if self._redraws:
            self._clear()
            running = [f"  {job.label}: {_so_far(one)}" for job, one in self._running.items()]
            failed = f", {self._failed} failed" if self._failed else ""
            state = [f"{self._over} of {self._all} done{failed}", *running]
            self._drawn = len(state)
            lines += state
        self._stream.write("".join(f"{line}\n" for line in lines))
        self._stream.flush()

    def _clear(self) -> None:
        self._stream.write("\x1b[1A\x1b[2K" * self._drawn)


def result(row: Row) -> str:
    """What came of a job, in words."""
    if row["status"] == FAILED:
        return f"failed: {row['reason']}"
    parts = [f"{row['frames']} frames"]
    parts += [f"{name} {row[name]:.3f}" for name in ("auc",) if isinstance(row[name], float)]
    if row["lost_frames"]:
        parts.append(f"lost in {row['lost_frames']}")
    return ", ".join(parts)


def csv_text(rows: Iterable[Row]) -> str:
    """The table as CSV, a row for each job; empty where there is nothing to say."""
    text = io.StringIO()
    writer = csv.DictWriter(text, ROW, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: "" if row[name] is None else row[name] for name in ROW} for row in rows)
    return text.getvalue()


def _so_far(report: Progress) -> str:
    return f"frame {report.done}" + ("" if report.expected is None else f"/{report.expected}")
