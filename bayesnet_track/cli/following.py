"""A run that a command follows: live view, progress, how it ended, and the command that is useful next."""

from __future__ import annotations

import argparse
import gc
import json
import sys
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from bayesnet_track.cli.arguments import INCOMPLETE, OK, UsageError, complain, run_silently, say, words
from bayesnet_track.numerics.compile_watch import WATCH

if TYPE_CHECKING:
    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.journal.events.event import Event
    from bayesnet_track.runtime.live_view.view import LiveView
    from bayesnet_track.runtime.pace import Progress
    from bayesnet_track.runtime.recording.rundir import RunDirectory
    from bayesnet_track.runtime.results import FrameSource, Result, Summary
    from bayesnet_track.runtime.run import Start
    from bayesnet_track.runtime.stop import StopRequest


SHOWN_NOTICES = 5

ENDINGS = {
    "source_truncated": "the source is truncated",
    "source_damaged": "the source is damaged",
    "frame_size_changed": "stopped where the frames change size",
    "interrupted": "interrupted",
}


def say_end(options: argparse.Namespace, folder: Path, summary: Summary) -> None:
    """Warnings, failures, then how the run went: a sentence, with --json an object, with --quiet nothing.

    Of `what-if` the object is the comparison.
    """
    from bayesnet_track.journal.text.sentences import explain

    for notice in summary.notices[:SHOWN_NOTICES]:
        complain(explain(notice))
    if len(summary.notices) > SHOWN_NOTICES:
        complain(
            f"... and {len(summary.notices) - SHOWN_NOTICES} more; `bayesnet-track log {folder}` lists them "
            "all"
        )
    for failure in list(summary.failures.values())[:SHOWN_NOTICES]:
        complain(explain(failure))
    if getattr(options, "json", False):
        if options.command in ("run", "resume"):
            say(json.dumps(as_object(folder, summary)))
    elif not options.quiet:
        say(f"{folder}: {as_sentence(summary)}")


def as_object(folder: Path, summary: Summary) -> dict[str, object]:
    """The object that --json prints of a run."""
    return {
        "run": str(folder),
        "frames": summary.frames,
        "seconds": round(summary.seconds, 3),
        "frames_per_second": round(summary.frames_per_second, 1),
        "reconfigurations": summary.reconfigurations,
        "lost_frames": summary.lost_frames,
        "complete": summary.complete,
        "reason": summary.reason,
    }


def as_sentence(summary: Summary) -> str:
    """`12 frames in 2.0 s (30 frames per second after the first), 1 reconfiguration`, and what went wrong."""
    times = []
    if summary.frames_per_second:
        times.append(f"{summary.frames_per_second:.0f} frames per second after the first")
    if summary.compiling_s >= 0.05:
        times.append(f"{summary.compiling_s:.1f} s of compiling")
    parts = [f"{_count(summary.frames, 'frame')} in {summary.seconds:.1f} s"]
    if times:
        parts[0] += f" ({', '.join(times)})"
    parts.append(_count(summary.reconfigurations, "reconfiguration"))
    if summary.lost_frames:
        share = 100 * summary.lost_target_frames / max(summary.target_frames, 1)
        lost_share = (
            f"on average {share:.2g} % of the targets lost (at most {summary.most_targets} at a time)"
        )
        lost = f"lost in {_count(summary.lost_frames, 'frame')}"
        parts.append(lost if summary.most_targets < 2 else lost_share)
    if not summary.complete:
        parts.append(ENDINGS[summary.reason])
    return ", ".join(parts)


def say_next(options: argparse.Namespace, folder: Path, summary: Summary) -> None:
    """The command that is useful next: nothing where a program reads."""
    if options.quiet or options.log_json or getattr(options, "json", False) or not summary.frames:
        return
    if summary.reason == "interrupted":
        resume_hint = f"`bayesnet-track resume {folder}` goes on from here; "
        can_resume = (folder / "checkpoint").exists()
        shows = f"`bayesnet-track report {folder} --open` shows what there is"
        complain(f"next: {resume_hint if can_resume else ''}{shows}")
    else:
        shows = f"`bayesnet-track report {folder} --open` shows the run in a browser"
        next_hint = f"`bayesnet-track log {folder}` prints its decisions"
        if summary.lost_frames:
            next_hint = f"`bayesnet-track diagnose {folder}` names a key to try where it is lost"
        complain(f"next: {shows}; {next_hint}")


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


@contextmanager
def open_view(options: argparse.Namespace) -> Iterator[LiveView | None]:
    """The view that the options ask for, or None; at the end it stays for as long as its page is open."""
    if options.view is None:
        if options.view_now or options.open:
            raise UsageError("--view-now and --open are of a live view: give --view, too")
        yield None
        return
    from bayesnet_track.runtime.live_view.view import LiveView

    stop: StopRequest = options.stop
    try:
        view = LiveView(options.view_host, options.view or None)
    except OSError as error:
        address = f"{options.view_host} port {options.view}" if options.view else options.view_host
        raise UsageError(f"--view: {address}: {words(error)}; choose another, or none") from error
    with view:
        announce(options, view.address)
        yield view
        if stop.signal is None and view.is_open:
            complain("the view stays while its page is open; Ctrl-C closes it")
            stop.is_patient = True
            view.linger(lambda: stop.signal is not None)
            if stop.between_frames():
                # The run is over: what was closed is the view.
                stop.signal = None


def begin_view(
    options: argparse.Namespace,
    view: LiveView,
    graph: CheckedGraph,
    source: FrameSource,
    starts: Sequence[Start],
    folder: Path,
) -> Sequence[Start] | None:
    """The boxes to start with, drawn on the page where none is given; None when stopped before."""
    from bayesnet_track.engine.starts import has_births
    from bayesnet_track.runtime.recording.rundir import RunDirectory

    stop: StopRequest = options.stop
    view.controls.can_switch = getattr(options, "inputs", None) is None
    if not options.overwrite:
        RunDirectory.create(str(folder), overwrite=False)  # what is wrong there is told before anybody waits
    view.shows(graph, source, out=str(folder))

    def give_up() -> bool:
        return stop.signal is not None

    if not starts and not has_births(graph):
        first = getattr(source, "first_frame", None)
        assert first is not None
        selected = view.choose(graph, source, first, give_up)
        for start in selected or ():
            box = ",".join(f"{value:g}" for value in start.box)
            complain(f"start box: --init {f'{start.plate}:' if start.plate else ''}{box}")
        return selected
    if not options.view_now:
        view.wait_for_page(give_up)
    view.controls.to("starting")
    return starts


def begin_again(
    options: argparse.Namespace, view: LiveView, directory: RunDirectory, expected: int | None
) -> None:
    """Show what the run that goes on has behind it, and wait for the page."""
    from bayesnet_track.journal.events.runs import RunEnded, RunStarted
    from bayesnet_track.journal.reader import read_events, read_metrics
    from bayesnet_track.runtime.checkpoints.recipe import Recipe
    from bayesnet_track.runtime.checkpoints.standing import standing
    from bayesnet_track.view.page_data import read_timings

    stop: StopRequest = options.stop
    recipe = Recipe.read(directory)
    view.controls.can_switch = recipe.inputs is None
    view.shows(recipe.load_graph(directory), out=str(directory.path), expected=expected)
    last_frame = standing(directory.path).frame
    if last_frame is not None:  # else it starts again, and sends every event
        events = [event for event in read_events(directory.journal) if not isinstance(event, RunEnded)]
        view.recall(
            [event for event in events if isinstance(event, RunStarted) or event.frame <= last_frame],
            [line for line in read_metrics(directory.frames) if line.frame <= last_frame],
            [line for line in read_timings(directory.timings) if line["frame"] <= last_frame],
        )
    if not options.view_now:
        view.wait_for_page(lambda: stop.signal is not None)
    view.controls.to("starting")


def announce(options: argparse.Namespace, address: str) -> None:
    """Print the address of a page, and open it on request."""
    if options.view_host not in ("127.0.0.1", "localhost", "::1"):
        complain(
            f"--view-host {options.view_host}: whoever gets this address can see and control the run, "
            "and it travels unencrypted"
        )
    complain(f"view: {address}")
    if options.open:
        import threading

        threading.Thread(target=open_page, args=(address,), daemon=True).start()


def open_page(address: str) -> None:
    """Open an address in this machine's browser; says so where there is none."""
    import webbrowser

    try:
        is_open = webbrowser.open(address)
    except (webbrowser.Error, OSError):
        is_open = False
    if not is_open:
        complain(f"--open: no browser can be opened here (no display?); open {address} in one yourself")


STOPPED = 130
"""Exit code of a run that a person stopped."""
MOST_NAMED = 3
"""Of more lost targets than this the progress line gives the number only, of more targets no UD."""


@contextmanager
def users_start() -> Iterator[None]:
    """Raise `UsageError` for what cannot start inside it because of the arguments."""
    from bayesnet_track.engine.starts import StartError
    from bayesnet_track.observation.detector import DetectorError
    from bayesnet_track.runtime.executors import PlacingError

    try:
        yield
    except (StartError, DetectorError, PlacingError) as error:
        raise UsageError(str(error)) from error


def follow_run(
    options: argparse.Namespace,
    results: Generator[Result, None, None],
    summary: Summary,
    expected: int | None,
    folder: Path,
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
    say_end(options, folder, summary)
    if options.command in ("run", "resume"):
        say_next(options, folder, summary)
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
        from bayesnet_track.journal.text.sentences import kinds_of, narrate

        self._kinds |= kinds_of([event])
        complain(narrate(event, self._kinds, True))

    def frame(self, result: Result) -> None:
        """Of a frame only its events are told."""


def _show(progress: Progress, summary: Summary, result: Result) -> None:
    active = dict.fromkeys(agent for metrics in result.targets for agent in metrics.active)
    kinds = result.kinds
    lost = [f"{kinds.get(m.target, 'target')} {m.target}" for m in result.targets if m.is_gone]
    status = ("tracking" if result.targets else "no target") if not lost else "lost"
    if not lost and any(metrics.status == "uncertain" for metrics in result.targets):
        status = "uncertain"
    if lost and len(result.targets) > 1:
        whom = f": {', '.join(lost)}" if len(lost) <= MOST_NAMED else ""
        status = f"{len(lost)} of {len(result.targets)} lost{whom}"
    ud_px2 = max((metrics.ud_px2 for metrics in result.targets), default=0.0)
    unit = next((metrics.ud_unit for metrics in result.targets), "px²")
    if len(result.targets) > MOST_NAMED:
        unit = ""
    # As if no time passed while kernels are compiled: the rate is that of frames.
    time_s = time.monotonic() - WATCH.seconds
    run_silently(partial(progress.update, time_s, summary.frames, tuple(active), ud_px2, status, unit))
