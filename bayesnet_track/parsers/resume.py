"""The arguments of `resume`, and the option of those commands that keep how far a run is."""

from __future__ import annotations

import argparse
from typing import Any

from bayesnet_track.cli.options.checkpoints import add_checkpoints
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
