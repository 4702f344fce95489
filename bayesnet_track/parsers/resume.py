"""The arguments of `resume`, and the option of those commands that keep how far a run is."""

from __future__ import annotations

import argparse
from typing import Any

from bayesnet_track.cli.options.executors import add_executor_options
from bayesnet_track.cli.options.plugins import add_plugins
from bayesnet_track.cli.options.view import add_view_options


def add_resume(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    resume = commands.add_parser(
        "resume",
        help="go on with a run that was broken off",
        description="Go on after the last checkpoint of a run that was killed, interrupted or out of disk "
        "space. In the end the run directory is that of an unbroken run, byte for byte (but for the times).",
    )
    resume.add_argument("run", metavar="RUN", help="run directory")
    resume.add_argument("--quiet", action="store_true", help="no progress line")
    resume.add_argument("--log-json", action="store_true", help="progress as JSON lines")
    resume.add_argument(
        "--allow-other-machine",
        action="store_true",
        help="go on although the machine, its instruction sets or the libraries are not those that the run "
        "was computed with; the result then equals no unbroken run's",
    )
    add_checkpoints(resume)
    add_plugins(resume)
    add_executor_options(resume)
    add_view_options(resume)


def add_checkpoints(parser: argparse.ArgumentParser) -> None:
    """`--checkpoint-every`."""
    parser.add_argument(
        "--checkpoint-every",
        type=_seconds,
        default=1.0,
        metavar="S",
        help="seconds between checkpoints, from which `resume` goes on (default 1; 0 for none)",
    )


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r}: a number of seconds from 0 on is needed")
    return value
