"""Options that every command that tracks has."""

from __future__ import annotations

import argparse

from bayesnet_track.cli.options.arguments import whole_number
from bayesnet_track.cli.options.checkpoints import add_checkpoints
from bayesnet_track.cli.options.executors import add_executor_options
from bayesnet_track.cli.options.output import add_output_options


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """`--seed`, `--overwrite`, what is printed, and how agents are asked."""
    parser.add_argument(
        "--seed", type=whole_number(0), default=0, metavar="N", help="seed of all randomness (default 0)"
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="replace an earlier run in the same directory"
    )
    add_output_options(parser)
    add_checkpoints(parser)
    add_executor_options(parser)
