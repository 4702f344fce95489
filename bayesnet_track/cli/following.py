"""Follow a run to its end: show how far it is, say how it ended, with which exit code."""

from __future__ import annotations

import argparse
import gc
import sys
import time
from collections.abc import Generator, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from bayesnet_track.cli.commands.answer import (
    INCOMPLETE,
    OK,
    UsageError,
    complain,
    run_silently,
)
from bayesnet_track.cli.ending import say_end, say_next
from bayesnet_track.numerics.compile_watch import WATCH

if TYPE_CHECKING:
    from bayesnet_track.journal.events.event import Event
    from bayesnet_track.runtime.live_view.view import LiveView
    from bayesnet_track.runtime.pace import Progress
    from bayesnet_track.runtime.results import Result, Summary
    from bayesnet_track.runtime.stop import StopRequest


STOPPED = 130
"""Exit code of a run that a person stopped."""
MOST_NAMED = 3
"""Of more lost targets than this the progress line gives the number only."""


@contextmanager
def users_start() -> Iterator[None]:
    """What cannot start inside it cannot because of the arguments: `UsageError`."""
    from bayesnet_track.engine.starts import StartError
    from bayesnet_track.observation.detector import DetectorError
    from bayesnet_track.runtime.executors import PlacingError

    try:
        yield
    except (StartError, DetectorError, PlacingError) as error:
        raise UsageError(str(error)) from error


def follow(
    options: argparse.Namespace,
    results: Generator[Result, None, None],
    summary: Summary,
    expected: int | None,
    out: Path,
    view: LiveView | None = None,
) -> int:
    """Track to the end or until a signal, showing how far it is of the frames `expected`; the exit code.

    A `view` may hold it between two frames, and stop it.
    """
    from bayesnet_track.runtime.pace import Progress

    shows_progress = not (options.quiet or options.verbose)
    progress = Progress(sys.stderr, expected, sys.stderr.isatty(), options.log_json)
    stop: StopRequest = options.stop
    with ExitStack() as stack:
        if shows_progress:
            stack.callback(run_silently, progress.finish)
        stack.callback(results.close)
        stack.enter_context(users_start())
        for number, result in enumerate(results):
            if number == 0 and getattr(options, "owns_process", False):
                _spare_the_loaded()
            if shows_progress:
                _show(progress, summary, result)
            # Before the first frame is done there is nothing to finish: until then, signals act at once.
            if stop.between_frames():
                break
            if view is not None and (view.hold(lambda: stop.signal is not None) or stop.between_frames()):
                break
    say_end(options, out, summary)
    if options.command in ("run", "resume"):
        say_next(options, out, summary)
    if stop.signal is not None:
        return stop.exit_code
    stop.is_patient = False
    if view is not None and view.controls.has_stopped:
        return STOPPED
    return OK if summary.complete else INCOMPLETE


def _spare_the_loaded() -> None:
    """Let the garbage collector look no more through what is loaded by now: it stays until the process ends.

    Libraries and compiled kernels are most of all objects, and to look through them takes as long as some
    frames.
    """
    gc.collect()
    gc.freeze()


class Narrator:
    """Prints every decision and notice when it comes, as `log` does later."""

    def __init__(self) -> None:
        self._kinds: dict[str, str] = {}

    def event(self, event: Event) -> None:
        """One sentence."""
        from bayesnet_track.journal.text.explain import kinds_of, narrate

        self._kinds |= kinds_of([event])
        complain(narrate(event, self._kinds, True))

    def frame(self, result: Result) -> None:
        """Of a frame only its events are told."""


def _show(progress: Progress, summary: Summary, result: Result) -> None:
    active = dict.fromkeys(agent for metrics in result.targets for agent in metrics.active)
    kinds = result.kinds
    lost = [f"{kinds.get(m.target, 'target')} {m.target}" for m in result.targets if m.status == "lost"]
    status = ("tracking" if result.targets else "no target") if not lost else "lost"
    if not lost and any(metrics.status == "uncertain" for metrics in result.targets):
        status = "uncertain"
    if lost and len(result.targets) > 1:
        whom = ", ".join(lost) if len(lost) <= MOST_NAMED else str(len(lost))
        status = f"lost: {whom} of {len(result.targets)}"
    ud_px2 = max((metrics.ud_px2 for metrics in result.targets), default=0.0)
    # As if no time passed while kernels are compiled: the rate is that of frames.
    now = time.monotonic() - WATCH.seconds
    run_silently(partial(progress.update, now, summary.frames, tuple(active), ud_px2, status))
