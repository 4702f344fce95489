"""Options of `run` about what comes from outside while it goes on."""

from __future__ import annotations

import argparse

from bayesnet_track.cli.options.arguments import milliseconds


def add_outside_options(parser: argparse.ArgumentParser) -> None:
    """`--inputs`, `--budget-ms`, `--realtime`."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--inputs",
        metavar="FILE",
        help="inputs.jsonl of an earlier run: repeat what came from outside (switches by hand, faults)",
    )
    group.add_argument(
        "--budget-ms",
        type=milliseconds,
        metavar="MS",
        help="what a frame may take: where frames take longer, do without what says little for its time",
    )
    group.add_argument(
        "--realtime", action="store_true", help="the same, the source's frame interval being the budget"
    )
