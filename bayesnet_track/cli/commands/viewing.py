"""The live view of the commands that track: opened before the run, closed by the person."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from bayesnet_track.cli.commands.answer import UsageError, complain, words

if TYPE_CHECKING:
    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.runtime.live_view.view import LiveView
    from bayesnet_track.runtime.recording.rundir import RunDirectory
    from bayesnet_track.runtime.results import FrameSource
    from bayesnet_track.runtime.run import Start
    from bayesnet_track.runtime.stop import StopRequest


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
        where = f"{options.view_host} port {options.view}" if options.view else options.view_host
        raise UsageError(f"--view: {where}: {words(error)}; choose another, or none") from error
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


def begin(
    options: argparse.Namespace,
    view: LiveView,
    graph: CheckedGraph,
    source: FrameSource,
    starts: Sequence[Start],
    out: Path,
) -> Sequence[Start] | None:
    """The boxes to start with, drawn on the page where none is given; None when stopped before."""
    from bayesnet_track.engine.starts import has_births
    from bayesnet_track.runtime.recording.rundir import RunDirectory

    stop: StopRequest = options.stop
    view.controls.can_switch = getattr(options, "inputs", None) is None
    if not options.overwrite:
        RunDirectory.create(str(out), overwrite=False)  # what is wrong there is told before anybody waits
    view.shows(graph, source, out=str(out))

    def give_up() -> bool:
        return stop.signal is not None

    if not starts and not has_births(graph):
        first = getattr(source, "first_frame", None)
        assert first is not None
        chosen = view.choose(graph, source, first, give_up)
        for one in chosen or ():
            box = ",".join(f"{value:g}" for value in one.box)
            complain(f"start box: --init {f'{one.plate}:' if one.plate else ''}{box}")
        return chosen
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
    last = standing(directory.path).frame
    if last is not None:  # else it starts again, and sends every event
        events = [one for one in read_events(directory.journal) if not isinstance(one, RunEnded)]
        view.recall(
            [one for one in events if isinstance(one, RunStarted) or one.frame <= last],
            [line for line in read_metrics(directory.frames) if line.frame <= last],
            [line for line in read_timings(directory.timings) if line["frame"] <= last],
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
