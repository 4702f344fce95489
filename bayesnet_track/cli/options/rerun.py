"""The option `--rerun`."""

from __future__ import annotations

import argparse


def add_rerun_option(parser: argparse.ArgumentParser) -> None:
    """Add it."""
    parser.add_argument(
        "--rerun",
        nargs="?",
        const="",
        metavar="FILE.rrd",
        help="log frames, boxes, UD, KL and events to a Rerun recording, or without a file to its viewer "
        "(needs the extra `rerun`)",
    )
