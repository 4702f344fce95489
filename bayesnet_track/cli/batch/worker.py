"""Jobs in a process of their own, a line of the input each; progress and rows are told as lines of JSON."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable

from bayesnet_track.cli.batch.jobs import Job, allow

EVERY_S = 0.5


def main() -> int:
    """Do jobs until the input ends; the exit code."""
    from bayesnet_track.cli.batch.work import do, failed_row
    from bayesnet_track.cli.commands.answer import words
    from bayesnet_track.observation.settings import by_command_line
    from bayesnet_track.sources.entrances.notices import heard

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the batch decides
    answers = os.dup(1)
    os.dup2(2, 1)  # what cues print must not stand among the answers

    def send(what: object) -> None:
        os.write(answers, json.dumps(what).encode() + b"\n")

    for line in sys.stdin:
        job = Job.from_json(line)
        try:
            with heard(lambda text: send({"notice": text})), by_command_line():
                allow(job)
                row = do(job, _progress(send))
        except (OSError, ValueError) as error:
            row = failed_row(job, " ".join(words(error).split()))
        send({"row": row})
    return 0


def _progress(send: Callable[[object], None]) -> Callable[[int, int | None], None]:
    """Tell how far a job is, now and then."""
    shown = 0.0

    def progress(done: int, expected: int | None) -> None:
        nonlocal shown
        if time.monotonic() >= shown + EVERY_S:
            shown = time.monotonic()
            send({"done": done, "expected": expected})

    return progress
