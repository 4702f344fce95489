"""Places where the jobs of a batch run: what each has, and processes of this computer."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import tempfile
import threading
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Protocol

from bayesnet_track.cli.batch.jobs import Job
from bayesnet_track.cli.batch.work import FINISHED, Row, failed_row, timed_out_row
from bayesnet_track.observation.child import cut, python, tie
from bayesnet_track.runtime.executors.workers import PlacingError

FILES_EACH, FILES_MORE = 12, 12
"""Files that this process opens for a run, most of them while it is started, and that it needs besides."""

MANY_FILES = "raise the limit on open files (`ulimit -n`), or give fewer --jobs"


def most_runs() -> int | None:
    """The number of runs at a time that the limit on open files allows; None where no limit is known."""
    if os.name != "posix":
        return None
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY:
        return None
    descriptors = Path("/dev/fd")
    is_open = len(list(descriptors.iterdir())) if descriptors.is_dir() else 16
    return max(0, (soft - is_open - FILES_MORE) // FILES_EACH)


@dataclass(frozen=True)
class Needs:
    """Amounts of a computer that a run is counted with; it is not held to them.

    Attributes:
        cpus: processors.
        memory: bytes, or None.
    """

    cpus: int = 1
    memory: int | None = None

    def fitting(self, cpus: int, memory: int | None) -> int:
        """Number of runs that fit at a time.

        >>> Needs(2, 3 << 30).fitting(16, 16 << 30)
        5
        """
        by_memory = cpus if self.memory is None or memory is None else memory // self.memory
        return min(cpus // self.cpus, by_memory)

    def fitting_here(self) -> int:
        """The same of this computer; raises PlacingError where none fits."""
        room = _processors(), _memory()
        self.check(*room)
        return self.fitting(*room)

    def check(self, cpus: int, memory: int | None) -> None:
        """Refuse what does not fit once; raises PlacingError."""
        if self.fitting(cpus, memory) < 1:
            size = "" if memory is None else f" and {memory / (1 << 30):.1f} GiB"
            memory_text = "" if self.memory is None else f" and {self.memory / (1 << 30):.1f} GiB (--memory)"
            raise PlacingError(
                f"a run is to have {self.cpus} processors (--cpus){memory_text}, and there are {cpus}{size}; "
                "give less"
            )


def _memory() -> int | None:
    """Bytes that processes of this computer, or of its container, may use; None where it does not say."""
    sizes = []
    with suppress(ValueError, OSError, AttributeError):
        sizes.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    with suppress(ValueError, OSError):
        sizes.append(int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return min(sizes, default=None)


def _processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _error_text(error: Exception) -> str:
    """An error in words, with a cure where it is the limit on open files."""
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
        return f"{error.strerror}: {MANY_FILES}"
    return str(error)


WAIT_S = 0.2
MOST_JOBS = 100
"""Jobs after which a process is renewed."""
ENDING_S = 5.0
"""Seconds after which a process that was asked to end is ended."""


@dataclass(frozen=True)
class JobProgress:
    """A report of a job.

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


class JobPlace(Protocol):
    """A place where jobs run."""

    def run(self, jobs: Sequence[Job]) -> Generator[JobProgress | None, None, None]:
        """Do the jobs; what is reported of them as it comes, each one's row in the end, None when all is
        quiet.

        A job that fails, or whose process dies, has a row that says so. Closing the iterator ends the jobs
        that run; they can be gone on with.
        """


@dataclass(frozen=True)
class Processes:
    """So many processes, each for one job after the other: one that dies takes no other with it.

    A process keeps what it has loaded for the next job. It is renewed after `MOST_JOBS`, and after a job that
    did not finish.

    Attributes:
        at_a_time: how many.
        timeout_s: seconds that a job may take, or None.
    """

    at_a_time: int
    timeout_s: float | None = None

    def run(self, jobs: Sequence[Job]) -> Generator[JobProgress | None, None, None]:
        """Do the jobs as a `JobPlace` does."""
        reports: SimpleQueue[JobProgress] = SimpleQueue()
        workers = _Workers()
        pool = ThreadPoolExecutor(self.at_a_time)
        try:
            for job in jobs:
                pool.submit(_supervise, job, self.timeout_s, reports, workers)
            remaining = len(jobs)
            while remaining:
                try:
                    report = reports.get(timeout=WAIT_S)
                except Empty:
                    yield None
                    continue
                remaining -= report.row is not None
                yield report
        finally:
            workers.end()
            pool.shutdown(cancel_futures=True)
            workers.close()


def _supervise(
    job: Job, timeout_s: float | None, reports: SimpleQueue[JobProgress], workers: _Workers
) -> None:
    """Do a job in a process; its row is reported, whatever happens: the batch waits for it."""
    if workers.is_over.is_set():
        return
    row = failed_row(job, "its supervision ended")
    try:
        reports.put(JobProgress(job))
        worker = workers.take()
        try:
            row = worker.do(job, timeout_s, reports)
        finally:
            workers.give_back(worker, is_good=row["status"] == FINISHED)
    except (OSError, ValueError) as error:
        row = failed_row(job, _error_text(error))
    except RuntimeError as error:  # no thread can be started
        row = failed_row(job, f"{error}; {MANY_FILES}")
    finally:
        reports.put(JobProgress(job, row=row))


class _Workers:
    """The processes of a batch: those that wait for a job, and those that are at one."""

    def __init__(self) -> None:
        self.is_over = threading.Event()
        self._idle: SimpleQueue[_Worker] = SimpleQueue()
        self._running: set[_Worker] = set()

    def take(self) -> _Worker:
        """One that waits, or a new one."""
        with suppress(Empty):
            while True:
                worker = self._idle.get_nowait()
                if worker.is_alive:
                    return worker
                self._drop(worker)
        worker = _Worker()
        self._running.add(worker)
        if self.is_over.is_set():  # it was not among those that were ended
            worker.terminate()
        return worker

    def give_back(self, worker: _Worker, is_good: bool) -> None:
        """Keep one for the next job, or close it."""
        if is_good and worker.jobs < MOST_JOBS and not self.is_over.is_set():
            self._idle.put(worker)
        else:
            self._drop(worker)

    def end(self) -> None:
        """Ask all of them to end."""
        self.is_over.set()
        for worker in tuple(self._running):
            worker.terminate()

    def close(self) -> None:
        """Wait until those without a job have ended."""
        with suppress(Empty):
            while True:
                self._drop(self._idle.get_nowait())

    def _drop(self, worker: _Worker) -> None:
        self._running.discard(worker)
        worker.close()


class _Worker:
    """A process that does one job after the other.

    Attributes:
        jobs: how many it was given.
    """

    def __init__(self) -> None:
        pipe, self.jobs = subprocess.PIPE, 0
        with ExitStack() as stack:
            descriptor, lifeline = tie()
            stack.callback(cut, lifeline)
            command = python(
                "from bayesnet_track.cli.batch.work import main; sys.exit(main())", descriptor=descriptor
            )
            files = () if descriptor < 0 else (descriptor,)
            try:
                self._complaints = stack.enter_context(
                    tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")
                )
                self._process = subprocess.Popen(
                    command, stdin=pipe, stdout=pipe, stderr=self._complaints, text=True, pass_fds=files
                )
            finally:
                cut(descriptor)
            self._files = stack.pop_all()

    @property
    def is_alive(self) -> bool:
        """True if the process has not ended."""
        return self._process.poll() is None

    def do(self, job: Job, timeout_s: float | None, reports: SimpleQueue[JobProgress]) -> Row:
        """Have a job done; its row, also where the process ends without one."""
        self.jobs += 1
        late = threading.Event()
        alarm = threading.Timer(timeout_s or 0.0, _end, (self._process, late))
        alarm.daemon = True
        if timeout_s is not None:
            alarm.start()
        try:
            row = self._run_job(job, reports)
            code = self._process.wait() if row is None else 0
        finally:
            alarm.cancel()
        if row is not None:
            return row
        if late.is_set() and timeout_s is not None:
            return timed_out_row(job, timeout_s)
        self._complaints.seek(0)
        complaints = self._complaints.read().strip().splitlines()
        return failed_row(
            job, f"its process ended with {code}" + (f": {complaints[-1]}" if complaints else "")
        )

    def _run_job(self, job: Job, reports: SimpleQueue[JobProgress]) -> Row | None:
        """Give the process the job and report what it says; the row, or None where it ends without one."""
        assert self._process.stdin is not None and self._process.stdout is not None
        with suppress(BrokenPipeError):  # it has ended already: its exit code says how
            self._process.stdin.write(job.to_json() + "\n")
            self._process.stdin.flush()
        for line in self._process.stdout:
            message = json.loads(line)
            if "row" in message:
                row: Row = message["row"]
                return row
            if "notice" in message:
                reports.put(JobProgress(job, notice=message["notice"]))
            else:
                reports.put(JobProgress(job, message["done"], message["expected"]))
        return None

    def terminate(self) -> None:
        """Ask it to end now; what it is at can be gone on with."""
        with suppress(OSError):
            self._process.terminate()

    def close(self) -> None:
        """Let it end, and end it where it does not."""
        try:
            with suppress(subprocess.TimeoutExpired, ValueError):
                self._process.communicate(timeout=ENDING_S)  # closes its input
            _end(self._process)
        finally:
            self._files.close()


def _end(process: subprocess.Popen[str], late: threading.Event | None = None) -> None:
    """Ask a process to end, and end it where it does not; `late` says that it was asked."""
    if late is not None:
        late.set()
    with suppress(OSError):
        process.terminate()
        try:
            process.wait(ENDING_S)
        except subprocess.TimeoutExpired:
            process.kill()
