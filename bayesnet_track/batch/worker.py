"""A job in a process of its own: read from the input; how far it is, and its row, told as lines of JSON."""

from __future__ import annotations

import json
import sys
import time

from bayesnet_track.batch.jobs import Job

EVERY_S = 0.5


def main() -> int:
    """Do one job; the exit code."""
    from bayesnet_track.batch.work import do, failed_row
    from bayesnet_track.commands.answer import words

    job = Job.from_json(sys.stdin.readline())
    if job.plugins:
        from bayesnet_track import plugins

        plugins.allow(list(job.plugins))
    shown = 0.0

    def progress(done: int, expected: int | None) -> None:
        nonlocal shown
        if time.monotonic() >= shown + EVERY_S:
            shown = time.monotonic()
            _tell({"done": done, "expected": expected})

    try:
        _tell({"row": do(job, progress)})
    except KeyboardInterrupt:
        return 130
    except (OSError, ValueError) as error:
        _tell({"row": failed_row(job, " ".join(words(error).split()))})
    return 0


def _tell(what: object) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
