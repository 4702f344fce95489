"""The command that goes on with a run that was broken off: `resume`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.commands.answer import OK, complain, say
from bayesnet_track.cli.commands.tracking import executor_of
from bayesnet_track.cli.commands.viewing import begin_again, open_view
from bayesnet_track.cli.following import Narrator, follow
from bayesnet_track.cli.options.arguments import add_plugins, add_view_options
from bayesnet_track.cli.options.runs import add_checkpoints, add_executor_options, add_output_options

if TYPE_CHECKING:
    from bayesnet_track.runtime.recording.rundir import RunDirectory


def resume(options: argparse.Namespace) -> int:
    """Go on with a run."""
    from bayesnet_track.runtime.checkpoints.resume import resume
    from bayesnet_track.runtime.checkpoints.standing import standing
    from bayesnet_track.runtime.recording.replace import settle_broken
    from bayesnet_track.runtime.recording.rundir import RunDirectory
    from bayesnet_track.runtime.results import Summary

    directory = RunDirectory(Path(options.run))
    settle_broken(directory)
    if standing(directory.path).is_finished:
        for _ in resume(directory.path):  # removes what a kill in the last moment left
            pass
        if not (options.quiet or options.json):
            say(f"{directory.path}: it is finished; there is nothing to do")
        if options.json:
            say(json.dumps({"run": str(directory.path), "complete": True, "reason": "end_of_source"}))
        return OK
    summary, expected = Summary(), _expected(directory)
    with open_view(options) as view:
        if view is not None:
            begin_again(options, view, directory, expected)
        results = resume(
            directory.path,
            summary=summary,
            checkpoint_every=options.checkpoint_every,
            executor=executor_of(options),
            allow_other_machine=options.allow_other_machine,
            sinks=[*([Narrator()] if options.verbose else []), *([] if view is None else [view])],
            inputs=view if view is not None and view.controls.can_switch else None,
            notice=lambda text: complain(f"{directory.path}: {text}"),
        )
        return follow(options, results, summary, expected, directory.path, view)


def _expected(directory: RunDirectory) -> int | None:
    """How many frames the journal says are to be tracked."""
    from bayesnet_track.journal.codec import JournalError
    from bayesnet_track.journal.events.runs import RunStarted
    from bayesnet_track.journal.reader import read_events

    try:
        first = next(read_events(directory.journal), None)
    except (OSError, JournalError):
        return None
    return first.declared_frames if isinstance(first, RunStarted) else None


def add_resume(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    resume = commands.add_parser(
        "resume",
        help="continue a run that was interrupted",
        description="Continue from the last checkpoint of a run that was killed, interrupted or out of disk "
        "space. The run directory ends up as that of an uninterrupted run, byte for byte, except "
        "for the times.",
    )
    resume.add_argument("run", metavar="RUN", help="run directory")
    add_output_options(resume)
    resume.add_argument(
        "--allow-other-machine",
        action="store_true",
        help="continue although the machine, its instruction sets or the libraries differ from those "
        "of the run so far; the result then equals that of no uninterrupted run",
    )
    add_checkpoints(resume)
    add_plugins(resume)
    add_executor_options(resume)
    add_view_options(resume)
