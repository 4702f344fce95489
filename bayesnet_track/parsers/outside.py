"""Options of `run` about what comes from outside while it goes on."""

from __future__ import annotations

import argparse


def add_outside_options(parser: argparse.ArgumentParser) -> None:
    """`--inputs`."""
    parser.add_argument(
        "--inputs",
        metavar="FILE",
        help="inputs.jsonl of an earlier run: repeat what came from outside (switches by hand, faults)",
    )
