"""Options of checkpoints, which `run`, `demo`, `resume` and `batch` share."""

from __future__ import annotations

import argparse


def add_checkpoints(parser: argparse.ArgumentParser) -> None:
    """`--checkpoint-every`."""
    parser.add_argument(
        "--checkpoint-every",
        type=_seconds,
        default=1.0,
        metavar="S",
        help="seconds between checkpoints, from which `resume` continues (default 1; 0 for none)",
    )


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r}: a number of seconds from 0 on is needed")
    return value
