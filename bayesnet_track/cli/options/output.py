"""Options of what the commands that track print."""

from __future__ import annotations

import argparse


def add_output_options(parser: argparse.ArgumentParser) -> None:
    """`--quiet`, `--verbose`, `--json`, `--log-json`."""
    group = parser.add_argument_group("what is printed")
    group.add_argument("-q", "--quiet", action="store_true", help="only errors and warnings")
    group.add_argument("-v", "--verbose", action="store_true", help="every decision when it is made")
    group.add_argument(
        "--json", action="store_true", help="at the end, one JSON object that summarises the run"
    )
    group.add_argument("--log-json", action="store_true", help="progress as JSON lines, on stderr")
