"""The arguments of `compare`."""

from __future__ import annotations

import argparse
from typing import Any


def add_compare(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    compare = commands.add_parser(
        "compare", help="where the decisions of two runs part, why, and what it cost or saved"
    )
    compare.add_argument("first", metavar="RUN", help="run directory, called A")
    compare.add_argument("second", metavar="RUN", help="run directory over the same source, called B")
    add_comparison_options(compare)
    compare.add_argument("--overwrite", action="store_true", help="replace the file of --html if it is there")
    compare.add_argument("--force", action="store_true", help="compare runs of different sources, too")


def add_comparison_options(parser: argparse.ArgumentParser) -> None:
    """How a comparison is told."""
    parser.add_argument("--html", metavar="FILE", help="write it as one offline page, too")
    parser.add_argument(
        "--truth", metavar="FILE", help="ground truth to score both with (default: truth.txt of the first)"
    )
    parser.add_argument("--all", action="store_true", help="tell of every parting, not of the first 20")
    parser.add_argument("--json", action="store_true", help="print it as JSON")
