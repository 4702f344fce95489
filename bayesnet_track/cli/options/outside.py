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
        help="inputs.jsonl of an earlier run: repeat its external inputs (switches by hand, faults)",
    )
    group.add_argument(
        "--budget-ms",
        type=milliseconds,
        metavar="MS",
        help="time that a frame may take; if frames take longer, the agents with the least information"
        " per millisecond are switched off",
    )
    group.add_argument(
        "--realtime",
        action="store_true",
        help="the same, with the frame interval of the source as the budget",
    )
