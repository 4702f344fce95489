"""Places where the jobs of a batch run: processes of this computer, or tasks of a Ray cluster.

The sources and the folder of the results must be there under the same paths on every node. A job whose node
dies is started again by Ray, and goes on where its files end.
"""

from __future__ import annotations

import errno
import json
import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Protocol

from bayesnet_track.cli.batch.jobs import Job, allow
from bayesnet_track.cli.batch.work import FINISHED, Row, failed_row, timed_out_row
from bayesnet_track.observation.child import cut, python, tie
from bayesnet_track.runtime.executors.processes import PlacingError

FILES_EACH, FILES_MORE = 12, 12
"""Files that this process opens for a run, most of them while it is started, and that it needs besides."""

MANY_FILES = "raise the limit on open files (`ulimit -n`), or give fewer --jobs"


def most_runs() -> int | None:
    """How many runs at a time the limit on open files lets be started; None where none is known."""
    if os.name != "posix":
        return None
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY:
        return None
    here = Path("/dev/fd")
    is_open = len(list(here.iterdir())) if here.is_dir() else 16
    return max(0, (soft - is_open - FILES_MORE) // FILES_EACH)


def explained(error: Exception) -> str:
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
    """So many processes, each for one job after the other: one that dies takes no other with it.

    A process keeps what it has loaded for the next job. It is renewed after `MOST_JOBS`, and after a job that
    did not finish.

    Attributes:
        at_a_time: how many.
        timeout_s: seconds that a job may take, or None.
    """

    at_a_time: int
    timeout_s: float | None = None

    def run(self, jobs: Sequence[Job]) -> Generator[Progress | None, None, None]:
        """As of a `Place`."""
        reports: SimpleQueue[Progress] = SimpleQueue()
        workers = _Workers()
        pool = ThreadPoolExecutor(self.at_a_time)
        try:
            for job in jobs:
                pool.submit(_supervise, job, self.timeout_s, reports, workers)
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
            workers.end()
            pool.shutdown(cancel_futures=True)
            workers.close()


def _supervise(job: Job, timeout_s: float | None, reports: SimpleQueue[Progress], workers: _Workers) -> None:
    """Do a job in a process; its row is reported, whatever happens: the batch waits for it."""
    if workers.is_over.is_set():
        return
    row = failed_row(job, "its supervision ended")
    try:
        reports.put(Progress(job))
        worker = workers.take()
        try:
            row = worker.do(job, timeout_s, reports)
        finally:
            workers.give_back(worker, is_good=row["status"] == FINISHED)
    except (OSError, ValueError) as error:
        row = failed_row(job, explained(error))
    except RuntimeError as error:  # no thread can be started
        row = failed_row(job, f"{error}; {MANY_FILES}")
    finally:
        reports.put(Progress(job, row=row))


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
            held, lifeline = tie()
            stack.callback(cut, lifeline)
            command = python("from bayesnet_track.cli.batch.work import main; sys.exit(main())", held=held)
            files = () if held < 0 else (held,)
            try:
                self._complaints = stack.enter_context(
                    tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")
                )
                self._process = subprocess.Popen(
                    command, stdin=pipe, stdout=pipe, stderr=self._complaints, text=True, pass_fds=files
                )
            finally:
                cut(held)
            self._files = stack.pop_all()

    @property
    def is_alive(self) -> bool:
        """Whether the process has not ended."""
        return self._process.poll() is None

    def do(self, job: Job, timeout_s: float | None, reports: SimpleQueue[Progress]) -> Row:
        """Have a job done; its row, also where the process ends without one."""
        self.jobs += 1
        late = threading.Event()
        alarm = threading.Timer(timeout_s or 0.0, _end, (self._process, late))
        alarm.daemon = True
        if timeout_s is not None:
            alarm.start()
        try:
            row = self._told(job, reports)
            code = self._process.wait() if row is None else 0
        finally:
            alarm.cancel()
        if row is not None:
            return row
        if late.is_set() and timeout_s is not None:
            return timed_out_row(job, timeout_s)
        self._complaints.seek(0)
        said = self._complaints.read().strip().splitlines()
        return failed_row(job, f"its process ended with {code}" + (f": {said[-1]}" if said else ""))

    def _told(self, job: Job, reports: SimpleQueue[Progress]) -> Row | None:
        """Give the process the job and report what it says; the row, or None where it ends without one."""
        assert self._process.stdin is not None and self._process.stdout is not None
        with suppress(BrokenPipeError):  # it has ended already: its exit code says how
            self._process.stdin.write(job.to_json() + "\n")
            self._process.stdin.flush()
        for line in self._process.stdout:
            what = json.loads(line)
            if "row" in what:
                row: Row = what["row"]
                return row
            if "notice" in what:
                reports.put(Progress(job, notice=what["notice"]))
            else:
                reports.put(Progress(job, what["done"], what["expected"]))
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


MISSING = "Ray is not installed: pip install 'bayesnet-track[ray]'"
RETRIES = 2
"""How often a job whose process or node died is started again."""


@dataclass(frozen=True)
class RayTasks:
    """A task for each job, as many at a time as the cluster has processors.

    Attributes:
        address: of the cluster; None starts one here.
        timeout_s: seconds that a job may take, looked at between two of its frames, or None.
    """

    address: str | None = None
    timeout_s: float | None = None

    def run(self, jobs: Sequence[Job]) -> Generator[Progress | None, None, None]:
        """As of a `Place`.

        Raises:
            PlacingError: Ray is not installed, or there is no cluster.
        """
        owns_ray = connect(self.address)
        import ray

        task = ray.remote(_finished_task).options(num_cpus=1, max_retries=RETRIES)
        waiting = {task.remote(job.to_json(), self.timeout_s): job for job in jobs}
        try:
            while waiting:
                over, _ = ray.wait(list(waiting), timeout=WAIT_S)
                if not over:
                    yield None
                for promised in over:
                    job = waiting.pop(promised)
                    try:
                        row: Row = ray.get(promised)
                    except ray.exceptions.RayError as error:
                        row = failed_row(job, f"its task was lost ({type(error).__name__})")
                    yield Progress(job, row=row)
        finally:
            for promised in waiting:
                with suppress(ray.exceptions.RayError):
                    ray.cancel(promised, force=True)
            if owns_ray:
                ray.shutdown()


def connect(address: str | None) -> bool:
    """Connect to the cluster at `address`, or start one here; whether it has to be shut down again.

    Raises:
        PlacingError: Ray is not installed, or there is no cluster.
    """
    try:
        import ray
    except ImportError:
        raise PlacingError(MISSING) from None
    if ray.is_initialized():
        return False
    try:
        if address is None:
            ray.init(log_to_driver=False, logging_level="error", include_dashboard=False)
        else:
            ray.init(address=address, log_to_driver=False, logging_level="error")
    except Exception as error:  # what Ray raises when it is not up in time has no class of its own
        where = "Ray cannot be started here" if address is None else f"no Ray cluster at {address}"
        raise PlacingError(f"{where}: {' '.join(str(error).split())}") from error
    return True


class _Late(Exception):
    """A job takes longer than it may."""


def _finished_task(line: str, timeout_s: float | None = None) -> Row:
    from bayesnet_track.cli.arguments import words
    from bayesnet_track.cli.batch.work import do
    from bayesnet_track.observation.settings import by_command_line

    job, began = Job.from_json(line), time.monotonic()

    def progress(done: int, expected: int | None) -> None:
        if timeout_s is not None and time.monotonic() > began + timeout_s:
            raise _Late

    try:
        with by_command_line():
            allow(job)
            return do(job, progress)
    except _Late:
        return timed_out_row(job, timeout_s or 0.0)
    except (OSError, ValueError) as error:
        return failed_row(job, " ".join(words(error).split()))
