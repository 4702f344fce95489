"""The arguments of `what-if`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from bayesnet_track.cli.options.arguments import whole_number
from bayesnet_track.cli.options.plugins import add_plugins
from bayesnet_track.parsers.compare import add_comparison_options


def as_what_if(arguments: Sequence[str]) -> list[str]:
    """`run --what-if RUN ...` as `what-if RUN ...`; other arguments as they are.

    >>> as_what_if(["run", "--what-if", "runs/mine", "--seed", "1"])
    ['what-if', 'runs/mine', '--seed', '1']
    """
    if list(arguments[:1]) != ["run"]:
        return list(arguments)
    for place, argument in enumerate(arguments):
        if argument == "--what-if":
            return ["what-if", *arguments[1:place], *arguments[place + 1 :]]
        if argument.startswith("--what-if="):
            run = argument.partition("=")[2]
            return ["what-if", *arguments[1:place], run, *arguments[place + 1 :]]
    return list(arguments)


def add_what_if(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    what_if = commands.add_parser(
        "what-if",
        help="run an earlier run again with other thresholds or seed, and compare",
        description="Run an earlier run again over the same source and start boxes, with something changed, "
        "and tell where the two part.",
        epilog="bayesnet-track what-if runs/mine --set target.adapt.activate.above.ud_box=0.5",
    )
    what_if.add_argument("run", metavar="RUN", help="run directory")
    what_if.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        help="another value in its graph: keys joined by dots (targets, the plate and nodes may be left out) "
        "and YAML; may be repeated",
    )
    what_if.add_argument("--no-adaptation", action="store_true", help="all agents always on")
    what_if.add_argument(
        "--seed", type=whole_number(0), metavar="N", help="another seed (default: that of the run)"
    )
    what_if.add_argument("--out", metavar="DIR", help="run directory to write (default RUN-what-if)")
    what_if.add_argument(
        "--overwrite", action="store_true", help="replace an earlier run in --out, and the file of --html"
    )
    what_if.add_argument("--force", action="store_true", help="go on although the source has changed since")
    what_if.add_argument("--quiet", action="store_true", help="no progress line")
    what_if.add_argument("--log-json", action="store_true", help="progress as JSON lines")
    add_plugins(what_if)
    add_comparison_options(what_if)
