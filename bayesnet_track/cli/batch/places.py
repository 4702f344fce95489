"""Where the jobs of a batch run: behind a small protocol, here in processes of this computer."""

from __future__ import annotations

import json
import subprocess
import tempfile
import threading
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Protocol

from bayesnet_track.cli.batch.files import MANY_FILES, explained
from bayesnet_track.cli.batch.jobs import Job
from bayesnet_track.cli.batch.work import Row, failed_row, timed_out_row
from bayesnet_track.observation.child import cut, python, tie

WAIT_S = 0.2
ENDING_S = 5.0
"""Seconds after which a process that was asked to end is ended."""


@dataclass(frozen=True)
class Progress:
    """What is reported of a job.

    Attributes:
        job: the job.
        done: frames done.
        expected: frames to do, or None.
        row: its row, when it is over.
        notice: what of its inputs is not used.
    """

    job: Job
    done: int = 0
    expected: int | None = None
    row: Row | None = None
    notice: str | None = None


class Place(Protocol):
    """Where jobs run."""

    def run(self, jobs: Sequence[Job]) -> Generator[Progress | None, None, None]:
        """Do the jobs; what is reported of them as it comes, each one's row in the end, None when all is
        quiet.

        A job that fails, or whose process dies, has a row that says so. Closing the iterator ends the jobs
        that run; they can be gone on with.
        """


@dataclass(frozen=True)
class Processes:
    """A process for each job, so many at a time: one that dies takes no other with it.

    Attributes:
        at_a_time: how many.
        timeout_s: seconds that a job may take, or None.
    """

    at_a_time: int
    timeout_s: float | None = None

    def run(self, jobs: Sequence[Job]) -> Generator[Progress | None, None, None]:
        """As of a `Place`."""
        reports: SimpleQueue[Progress] = SimpleQueue()
        running: set[subprocess.Popen[str]] = set()
        is_over = threading.Event()
        pool = ThreadPoolExecutor(self.at_a_time)
        try:
            for job in jobs:
                pool.submit(_supervise, job, self.timeout_s, reports, running, is_over)
            left = len(jobs)
            while left:
                try:
                    report = reports.get(timeout=WAIT_S)
                except Empty:
                    yield None
                    continue
                left -= report.row is not None
                yield report
        finally:
            is_over.set()
            for process in tuple(running):
                with suppress(OSError):
                    process.terminate()
            pool.shutdown(cancel_futures=True)


def _supervise(
    job: Job,
    timeout_s: float | None,
    reports: SimpleQueue[Progress],
    running: set[subprocess.Popen[str]],
    is_over: threading.Event,
) -> None:
    """Do a job in a process; its row is reported, whatever happens: the batch waits for it."""
    if is_over.is_set():
        return
    row = failed_row(job, "its supervision ended")
    try:
        reports.put(Progress(job))
        row = _done(job, timeout_s, reports, running, is_over)
    except (OSError, ValueError) as error:
        row = failed_row(job, explained(error))
    except RuntimeError as error:  # no thread can be started
        row = failed_row(job, f"{error}; {MANY_FILES}")
    finally:
        reports.put(Progress(job, row=row))


def _done(
    job: Job,
    timeout_s: float | None,
    reports: SimpleQueue[Progress],
    running: set[subprocess.Popen[str]],
    is_over: threading.Event,
) -> Row:
    pipe = subprocess.PIPE
    held, lifeline = tie()
    command = python("from bayesnet_track.cli.batch.worker import main; sys.exit(main())", held=held)
    files = () if held < 0 else (held,)
    try:
        with (
            tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as complaints,
            subprocess.Popen(
                command, stdin=pipe, stdout=pipe, stderr=complaints, text=True, pass_fds=files
            ) as process,
        ):
            running.add(process)
            if is_over.is_set():  # it was not among those that were ended
                process.terminate()
            late = threading.Event()
            alarm = threading.Timer(timeout_s or 0.0, _end, (process, late))
            alarm.daemon = True
            if timeout_s is not None:
                alarm.start()
            try:
                row = _told(job, process, reports)
                code = process.wait()
            finally:
                alarm.cancel()
                running.discard(process)
            if row is not None:
                return row
            if late.is_set() and timeout_s is not None:
                return timed_out_row(job, timeout_s)
            complaints.seek(0)
            said = complaints.read().strip().splitlines()
            return failed_row(job, f"its process ended with {code}" + (f": {said[-1]}" if said else ""))
    finally:
        cut(held, lifeline)


def _told(job: Job, process: subprocess.Popen[str], reports: SimpleQueue[Progress]) -> Row | None:
    """Give a process its job and report what it says; its row, or None where it ends without one."""
    assert process.stdin is not None and process.stdout is not None
    row: Row | None = None
    with suppress(BrokenPipeError):  # it has ended already: its exit code says how
        process.stdin.write(job.to_json() + "\n")
        process.stdin.close()
    for line in process.stdout:
        what = json.loads(line)
        if "row" in what:
            row = what["row"]
        elif "notice" in what:
            reports.put(Progress(job, notice=what["notice"]))
        else:
            reports.put(Progress(job, what["done"], what["expected"]))
    return row


def _end(process: subprocess.Popen[str], late: threading.Event) -> None:
    """Ask a process to end, and end it where it does not."""
    late.set()
    with suppress(OSError):
        process.terminate()
        try:
            process.wait(ENDING_S)
        except subprocess.TimeoutExpired:
            process.kill()
