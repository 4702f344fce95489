"""The arguments of `export`."""

from __future__ import annotations

import argparse
from typing import Any

FORMATS = ("mot", "coco", "csv", "jsonl")


def add_export(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    export = commands.add_parser("export", help="write the tracks of a run as MOT, COCO, CSV or JSON Lines")
    export.add_argument("run", metavar="RUN", help="run directory")
    export.add_argument("--format", required=True, choices=FORMATS, help="format of the file")
    export.add_argument("--out", metavar="FILE", help="file to write (default: print)")
    lost = export.add_mutually_exclusive_group()
    lost.add_argument(
        "--lost", action="store_true", help="with the boxes of lost targets (csv, jsonl: as always)"
    )
    lost.add_argument("--no-lost", action="store_true", help="without them (mot, coco: as always)")
    export.add_argument("--overwrite", action="store_true", help="replace the file if it is there")
