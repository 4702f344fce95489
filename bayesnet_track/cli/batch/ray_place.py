"""The jobs of a batch as tasks of a Ray cluster, one processor each.

The sources and the folder of the results must be there under the same paths on every node. A job whose node
dies is started again by Ray, and goes on where its files end.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass

from bayesnet_track.cli.batch.jobs import Job, allow
from bayesnet_track.cli.batch.places import WAIT_S, Progress
from bayesnet_track.cli.batch.work import Row, failed_row, timed_out_row
from bayesnet_track.runtime.executors.processes import PlacingError

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

        task = ray.remote(_done).options(num_cpus=1, max_retries=RETRIES)
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


def _done(line: str, timeout_s: float | None = None) -> Row:
    from bayesnet_track.cli.batch.work import do
    from bayesnet_track.cli.commands.answer import words
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
