"""Tasks of a Ray cluster, as a place where the jobs of a batch run.

The sources and the folder of the results must be there under the same paths on every node. A job whose node
dies is started again by Ray, and goes on where its files end.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

from bayesnet_track.cli.batch.jobs import Job, allow_job
from bayesnet_track.cli.batch.places import MOST_JOBS, WAIT_S, JobProgress, Needs
from bayesnet_track.cli.batch.work import EVERY_S, Row, failed_row, timed_out_row
from bayesnet_track.runtime.executors.worker_pool import connect

RETRIES = 2
"""How often a job whose process or node died is started again."""


WAITING, WAITING_MORE = 4, 16
"""Tasks for each processor, and besides, that are given to a cluster at a time: it asks for nodes by them."""


@dataclass(frozen=True)
class RayTasks:
    """A task for each job, as many at a time as the cluster has processors and memory for.

    Attributes:
        address: of the cluster; None starts one here.
        timeout_s: seconds that a job may take, looked at between two of its frames, or None.
        needs: what a task is given.
    """

    address: str | None = None
    timeout_s: float | None = None
    needs: Needs = field(default_factory=Needs)

    def run(self, jobs: Sequence[Job]) -> Generator[JobProgress | None, None, None]:
        """Do the jobs as a `Place` does.

        Raises:
            PlacingError: Ray is not installed, there is no cluster, or one that was started here has no room.
        """
        owns_ray = connect(self.address)
        import ray

        resources = ray.cluster_resources()
        if owns_ray and self.address is None:
            self.needs.check(int(resources.get("CPU", 0)), int(resources.get("memory", 0)))
        amount = {} if self.needs.memory is None else {"memory": self.needs.memory}
        task = ray.remote(max_calls=MOST_JOBS)(_finished_task)
        task = task.options(num_cpus=self.needs.cpus, max_retries=RETRIES, **amount)
        reports = ray.remote(_Reports).options(num_cpus=0).remote()
        waiting: dict[object, int] = {}
        queue = iter(range(len(jobs)))
        try:
            while True:
                processors = int(ray.cluster_resources().get("CPU", 1))
                for number in islice(queue, max(0, WAITING * processors + WAITING_MORE - len(waiting))):
                    line = jobs[number].to_json()
                    waiting[task.remote(line, self.timeout_s, reports, number, EVERY_S)] = number
                if not waiting:
                    return
                over, _ = ray.wait(list(waiting), num_returns=len(waiting), timeout=WAIT_S)
                ended = {waiting.pop(promised): promised for promised in over}
                running = set(waiting.values())
                expected = running | set(ended)
                messages = [pair for pair in _messages(reports) if pair[0] in expected]
                yield from (_progress(jobs[number], message) for number, message in messages)
                for number, promised in ended.items():
                    yield JobProgress(jobs[number], row=_row(jobs[number], promised))
                if not messages and not ended:
                    yield None
        finally:
            for promised in waiting:
                with suppress(ray.exceptions.RayError):
                    ray.cancel(promised, force=True)
            if owns_ray:
                ray.shutdown()


def _row(job: Job, promised: object) -> Row:
    import ray

    try:
        row: Row = ray.get(promised)
    except ray.exceptions.RayError as error:
        row = failed_row(job, f"its task was lost ({type(error).__name__})")
    return row


def _messages(reports: Any) -> list[tuple[int, dict[str, Any]]]:
    """Messages of tasks since the last call; none where their node is gone: rows come another way."""
    import ray

    try:
        messages: list[tuple[int, dict[str, Any]]] = ray.get(reports.take.remote())
    except ray.exceptions.RayError:
        messages = []
    return messages


def _progress(job: Job, message: dict[str, Any]) -> JobProgress:
    if "notice" in message:
        return JobProgress(job, notice=message["notice"])
    return JobProgress(job, message["done"], message["expected"])


class _Reports:
    """An actor that keeps what tasks tell until the batch asks."""

    def __init__(self) -> None:
        self._held: list[tuple[int, dict[str, Any]]] = []

    def tell(self, number: int, message: dict[str, Any]) -> None:
        """Keep a message of the job of that number."""
        self._held.append((number, message))

    def take(self) -> list[tuple[int, dict[str, Any]]]:
        """The messages since the last time."""
        messages, self._held = self._held, []
        return messages


class _Late(Exception):
    """A job takes longer than it may."""


def _finished_task(line: str, timeout_s: float | None, reports: Any, number: int, every_s: float) -> Row:
    from bayesnet_track.cli.arguments import words
    from bayesnet_track.cli.batch.work import do, progress_of
    from bayesnet_track.observation.settings import by_command_line
    from bayesnet_track.sources.entrances.notices import heard

    job, began = Job.from_json(line), time.monotonic()

    def tell(message: dict[str, Any]) -> None:
        reports.tell.remote(number, message)

    report = progress_of(tell, every_s)

    def progress(frames: int, expected: int | None) -> None:
        report(frames, expected)
        if timeout_s is not None and time.monotonic() > began + timeout_s:
            raise _Late

    try:
        tell({"done": 0, "expected": None})
        with heard(lambda text: tell({"notice": text})), by_command_line():
            allow_job(job)
            return do(job, progress)
    except _Late:
        return timed_out_row(job, timeout_s or 0.0)
    except (OSError, ValueError) as error:
        return failed_row(job, " ".join(words(error).split()))
