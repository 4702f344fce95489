"""Results of a batch: progress, the table that is whole at any moment, and the ledger of finished runs

The folder `.batch` below the folder of the runs has a file of lines for each process that works on the batch.
A line holds for the same request, as long as the run's manifest and the files of its start and of its ground
truth are those that were there. A line that is torn, or no longer holds, costs no more than reading the run
itself.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import time
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self, TextIO

from bayesnet_track.cli.batch.jobs import LEDGER, BatchError, Job
from bayesnet_track.cli.batch.places import JobProgress
from bayesnet_track.cli.batch.work import FINISHED, ROW, Row
from bayesnet_track.journal.text.wording import plural
from bayesnet_track.journal.writer import write_atomically, writing
from bayesnet_track.runtime.recording.rundir import FILES
from bayesnet_track.sources.paths import is_file
from bayesnet_track.view.svg import element, xml_text

Mark = list[list[int]]
"""Size and time of the last change, in ns, of the manifest and of each file that is given."""


class Ledger:
    """The finished runs of a batch below a folder.

    Attributes:
        path: the file that is written by this process.

    Raises:
        OSError: a file cannot be read.
    """

    def __init__(self, folder: Path, name: str, graph_sha256: str) -> None:
        self.path = folder / LEDGER / f"{name}.jsonl"
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
        """SHA-256 of the request, wherever its run is put."""
        request: dict[str, Any] = {**asdict(job), "out": Path(job.out).name, "graph": self._graph}
        if is_file(job.video.source):
            request["video"]["source"] = str(Path(job.video.source).absolute())
        request["cue_files"] = [[file, *(_stat(Path(file)) or ())] for file in job.cue_files]
        return hashlib.sha256(json.dumps(request, sort_keys=True).encode()).hexdigest()


def _mark(job: Job) -> Mark | None:
    """Of the files of a run and of its start and ground truth; None where one is missing."""
    files = [file for file in (job.video.init_from, job.video.truth) if file is not None]
    stats = [_stat(path) for path in (Path(job.out) / FILES["manifest"], *map(Path, files))]
    return None if None in stats else [stat for stat in stats if stat is not None]


def _stat(path: Path) -> list[int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return [status.st_size, status.st_mtime_ns]


LAST = 20
"""Jobs over which it is measured how long one takes."""

QUIET_S = 60.0
"""Seconds without progress after which that is said."""


class BatchProgress:
    """On a terminal a table that is drawn anew; elsewhere a line for each job that is over."""

    def __init__(self, stream: TextIO, jobs: Sequence[Job], is_terminal: bool, over: int = 0) -> None:
        """Of `jobs`, besides which `over` were finished before."""
        self._stream, self._redraws, self._all = stream, is_terminal, len(jobs) + over
        self._running: dict[Job, JobProgress] = {}
        self._over, self._failed, self._drawn = over, 0, 0
        self._ends = deque([time.monotonic()], LAST + 1)

    def update(self, report: JobProgress) -> None:
        """Take what is reported of a job, and show it."""
        lines = []
        if report.notice is not None:
            lines = [f"{report.job.label}: {report.notice}"]
        elif report.row is None:
            self._running[report.job] = report
        else:
            self._running.pop(report.job, None)
            self._over += 1
            self._failed += report.row["status"] != FINISHED
            self._ends.append(time.monotonic())
            end = "" if self._redraws else f" ({self._state()})"
            lines = [f"{report.job.label}: {result(report.row)}{end}"]
        if self._redraws:
            self._clear()
            running = [f"  {job.label}: {_so_far(progress)}" for job, progress in self._running.items()]
            state = [self._state(), *running]
            self._drawn = len(state)
            lines += state
        self._write(lines)

    def note(self, text: str) -> None:
        """Show a line that stays."""
        if self._redraws:
            self._clear()
            self._drawn = 0
        self._write([text])

    def _state(self) -> str:
        failed = f", {self._failed} failed" if self._failed else ""
        todo = self._all - self._over
        each_s = (self._ends[-1] - self._ends[0]) / max(len(self._ends) - 1, 1)
        remaining = f", {clock(todo * each_s)} left" if todo and len(self._ends) > 1 else ""
        return f"{self._over} of {self._all}{failed}{remaining}"

    def _write(self, lines: Iterable[str]) -> None:
        self._stream.write("".join(f"{line}\n" for line in lines))
        self._stream.flush()

    def _clear(self) -> None:
        self._stream.write("\x1b[1A\x1b[2K" * self._drawn)


class Silence:
    """Time of the last report of each job; says once of each silence that it lasts."""

    def __init__(self, time_s: float) -> None:
        self._heard: dict[Job, tuple[float, JobProgress]] = {}
        self._last = time_s
        self._said: set[Job | None] = set()

    def hear(self, report: JobProgress | None, time_s: float) -> list[str]:
        """Take a report, or that there was none; sentences about jobs not heard of for long."""
        if report is not None:
            self._last = time_s
            self._said -= {report.job, None}
            self._heard[report.job] = time_s, report
            if report.row is not None:
                del self._heard[report.job]
        sentences = []
        for job, (moment, progress) in self._heard.items():
            if time_s - moment >= QUIET_S and job not in self._said:
                self._said.add(job)
                sentences.append(f"{job.label}: no progress for {time_s - moment:.0f} s, {_so_far(progress)}")
        if not self._heard and time_s - self._last >= QUIET_S and None not in self._said:
            self._said.add(None)
            sentences.append(f"no run has been heard of for {time_s - self._last:.0f} s")
        return sentences


def clock(seconds: float) -> str:
    """Seconds as minutes or hours.

    >>> clock(80.2), clock(3 * 3600 + 62)
    ('1:20', '3:01:02')
    """
    minutes, remainder = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{remainder:02}" if hours else f"{minutes}:{remainder:02}"


def result(row: Row) -> str:
    """The outcome of a job, in words."""
    if row["status"] != FINISHED:
        return f"{row['status']}: {row['reason']}"
    parts = [f"{row['frames']} frames"]
    parts += [f"{name} {row[name]:.3f}" for name in ("auc",) if isinstance(row[name], float)]
    if row["lost_frames"]:
        parts.append(f"lost in {row['lost_frames']}")
    return ", ".join(parts)


MEANS = tuple(name for name in ROW if name not in ("video", "seed", "status", "reason"))
"""Columns of which a mean can be taken."""


def csv_text(rows: Iterable[Row]) -> str:
    """The table as CSV, a row for each job; empty where there is nothing to say."""
    text = io.StringIO()
    writer = csv.DictWriter(text, ROW, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: "" if row[name] is None else row[name] for name in ROW} for row in rows)
    return text.getvalue()


def read_table(path: Path) -> dict[tuple[str, str], Row]:
    """The rows of an earlier batch by video and seed, as texts; none where there is no table.

    Raises:
        BatchError: the file is no table of a batch, and is not to be written over.
        OSError: it cannot be read.
    """
    if not path.exists():
        return {}
    cure = "move it, or give another --out"
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            if reader.fieldnames and not {"video", "seed", "status"} <= set(reader.fieldnames):
                raise BatchError(f"{path}: not a table of results; {cure}")
            rows: list[Row] = [{name: row.get(name) or "" for name in ROW} for row in reader]
    except (csv.Error, UnicodeDecodeError) as error:
        raise BatchError(f"{path}: not a table of results ({error}); {cure}") from None
    return {(str(row["video"]), str(row["seed"])): row for row in rows}


def _so_far(report: JobProgress) -> str:
    return f"frame {report.done}" + ("" if report.expected is None else f"/{report.expected}")


EVERY_S, SHARE = 1.0, 20
"""Seconds after which the table is written again while it grows, or so many times what that takes."""


class BatchTable:
    """The rows of a batch, and the file of its table: written anew while it grows, and when it is left.

    Rows that are there from before stay until there is another for the same video and seed. What is finished
    is noted in the ledger at once, so that a batch that is killed loses no row.

    Raises:
        BatchError: the file is no table of a batch.
        OSError: it cannot be read.
    """

    def __init__(self, path: Path, jobs: Sequence[Job], ledger: Ledger | None = None) -> None:
        self._path, self._jobs, self._ledger = path, jobs, ledger
        self._earlier = read_table(path)
        self._rows: dict[Job, Row] = {}
        self._due, self._is_changed = time.monotonic() + EVERY_S, False
        for job in jobs if ledger is not None else ():
            row = None if ledger is None else ledger.row(job)
            if row is not None:
                self._rows[job], self._is_changed = row, True

    @property
    def todo(self) -> list[Job]:
        """The jobs without a row, the largest first."""
        return _by_size([job for job in self._jobs if job not in self._rows])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._is_changed or not self._path.exists():
            self._write()

    def add(self, report: JobProgress | None) -> None:
        """Take the row of a job that is over."""
        if report is not None and report.row is not None:
            self._rows[report.job], self._is_changed = report.row, True
            if self._ledger is not None:
                self._ledger.add([(report.job, report.row)])
        if self._is_changed and time.monotonic() >= self._due:
            self._write()

    def rows(self) -> list[Row]:
        """The rows of the jobs that are over, in the order of the jobs."""
        return [self._rows[job] for job in self._jobs if job in self._rows]

    def mean(self) -> Row:
        """The mean of each measure over the finished runs that have it; empty where none has.

        Fewer than all runs can have a measure: an AUC needs ground truth.
        """
        finished = [row for row in self.rows() if row["status"] == FINISHED]
        columns = {name: [row[name] for row in finished] for name in MEANS}
        numbers = {
            name: [float(value) for value in values if value not in (None, "")]
            for name, values in columns.items()
        }
        return {name: round(sum(values) / len(values), 6) for name, values in numbers.items() if values}

    def write_overview(self, heading: str) -> Path:
        """Write the page beside the table, under its own name; raises OutputError."""
        path = self._path.with_name(self._path.name.replace("results", "overview")).with_suffix(".html")
        runs = [(Path(job.out).name, self._rows[job]) for job in self._jobs if job in self._rows]
        page = overview(heading, runs, self.mean(), self._path.name)
        write_atomically(path, page.encode("utf-8", "replace"))
        return path

    @property
    def expected(self) -> int:
        """Number of the jobs."""
        return len(self._jobs)

    def _write(self) -> None:
        """First the jobs of this batch in their order, then what else there is from before."""
        began = time.monotonic()
        table: dict[tuple[str, str], Row] = {}
        for job in self._jobs:
            key = job.video.name, str(job.seed)
            row = self._rows.get(job) or self._earlier.get(key)
            if row is not None:
                table[key] = row
        earlier_rows = {key: row for key, row in self._earlier.items() if key not in table}
        write_atomically(self._path, csv_text((table | earlier_rows).values()).encode("utf-8"))
        spent = time.monotonic() - began
        self._due, self._is_changed = time.monotonic() + max(EVERY_S, SHARE * spent), False


def _by_size(jobs: Sequence[Job]) -> list[Job]:
    """The jobs, those with the largest source first: the last ones to end are then the shortest.

    The size is that of the files in bytes, as what a video takes is known only when it is decoded. Of a
    folder it is the number of its entries times the size of one; of what cannot be looked at it is 0.
    """
    sizes: dict[str, int] = {}
    for job in jobs:
        if job.video.source not in sizes:
            sizes[job.video.source] = _bytes(job.video.source)
    return sorted(jobs, key=lambda job: -sizes[job.video.source])


def _bytes(source: str) -> int:
    try:
        path = Path(source)
        if not path.is_dir():
            return path.stat().st_size
        entries = list(os.scandir(path))
        return len(entries) * entries[0].stat().st_size if entries else 0
    except OSError:
        return 0


LISTED = 2000
"""Runs that the page lists; a browser takes seconds for more."""


def overview(heading: str, runs: Sequence[tuple[str, Row]], mean: Row, table: str) -> str:
    """One HTML file about the runs of a batch; all text is escaped, nothing is loaded or run.

    Runs that are not finished come first, then those of the lowest mean score. Columns in which no run has a
    value are left out.

    Args:
        heading: its title.
        runs: folder and row of each run, as in the table of results.
        mean: of each measure over the finished runs.
        table: name of the table of results, beside which the page is.
    """
    from bayesnet_track.view.compare_page import static_page

    rows = [row for _, row in runs]
    columns = [name for name in (rows[0] if rows else {}) if any(row[name] not in (None, "") for row in rows)]
    listed = sorted(runs, key=lambda run: _order(run[1]))[:LISTED]
    failed = sum(row["status"] != "finished" for row in rows)
    count = plural(len(rows), "run") + (f", {failed} not finished" if failed else "")
    surplus = len(runs) - len(listed)
    mean_line = _line(columns, mean | {"video": "mean of finished runs"}, "th") if mean else ""
    parts = [
        f"<header><h1>{xml_text(heading)}</h1><p>{xml_text(count)}; all in ",
        element("a", xml_text(table), href=table),
        "</p></header><section>",
        '<div class="wide"><table><thead><tr>',
        *(element("th", xml_text(name.replace("_", " ")), scope="col") for name in columns),
        f"</tr>{mean_line}</thead><tbody>",
        *(_line(columns, row, "td", folder) for folder, row in listed),
        "</tbody></table></div>",
        f'<p class="soft">{surplus} more, of higher scores, are in the table alone.</p>' if surplus else "",
        "</section>",
    ]
    return static_page(heading, parts)


def _order(row: Row) -> tuple[bool, float]:
    score = row["score_mean"]
    return row["status"] == "finished", float(score) if score not in (None, "") else 0.0


def _line(columns: Sequence[str], row: Row, cell: str, folder: str | None = None) -> str:
    texts = []
    for name in columns:
        value = row.get(name)
        text = xml_text("" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value))
        is_link = name == "video" and folder is not None
        texts.append(element("a", text, href=f"./{folder}/") if is_link else text)
    return f"<tr>{''.join(element(cell, text) for text in texts)}</tr>"
