"""The arguments of `verify`."""

from __future__ import annotations

import argparse
from typing import Any


def add_verify(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    verify = commands.add_parser(
        "verify",
        help="check that the files of a finished run are what it wrote",
        description="Compare every file of a run with the size and SHA-256 in its manifest.json. Exit code "
        "0: all are as they were written; 4: a file was changed, truncated, removed or added, or this is no "
        "run; 5: the run is unfinished (`resume` finishes it), still being written, or has no manifest.",
    )
    verify.add_argument("run", metavar="RUN", help="run directory")
    verify.add_argument("--json", action="store_true", help="print what was found as JSON")
