"""The arguments of `report`."""

from __future__ import annotations

import argparse
from typing import Any


def add_report(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    report = commands.add_parser(
        "report",
        help="make a page of a run, to look through in a browser",
        description="Write one HTML file that shows a run: its frames, what was believed, the net, its "
        "uncertainty, and every reconfiguration with its reason. The file needs no network.",
    )
    report.add_argument("run", metavar="RUN", help="run directory")
    report.add_argument("--out", metavar="FILE", help="file to write (default: report.html in RUN)")
    report.add_argument(
        "--frames",
        choices=["thumbnails", "full", "none"],
        default="thumbnails",
        help="thumbnails in the file (default); full: a folder with index.html and every frame; none",
    )
    report.add_argument(
        "--truth", metavar="FILE", help="ground-truth file to compare with (default: the run's own truth.txt)"
    )
    report.add_argument("--open", action="store_true", help="open it in the browser")
