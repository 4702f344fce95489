"""The command `export`: a run's tracks in another tool's format."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from bayesnet_track.cli.commands.answer import OK, check_free, complain, writing

WITH_LOST = ("csv", "jsonl")
"""Formats that say of a box that its target is lost."""


def export(options: argparse.Namespace) -> int:
    """Write the file."""
    from bayesnet_track.runtime.recording.exports import FORMATS
    from bayesnet_track.runtime.recording.run_reader import open_run

    run = open_run(options.run, complain)
    lost = options.lost or (options.format in WITH_LOST and not options.no_lost)
    text = FORMATS[options.format](run, lost)
    if options.out is None:
        sys.stdout.write(text)
        return OK
    out = Path(options.out)
    check_free(out, options.overwrite)
    with writing(out):
        out.write_text(text, encoding="utf-8", newline="\n")
    complain(f"wrote {out}")
    return OK


FORMATS = ("mot", "coco", "csv", "jsonl")


def add_export(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    export = commands.add_parser("export", help="write the tracks of a run as MOT, COCO, CSV or JSON Lines")
    export.add_argument("run", metavar="RUN", help="run directory")
    export.add_argument("--format", required=True, choices=FORMATS, help="format of the file")
    export.add_argument("-o", "--out", metavar="FILE", help="file to write (default: print)")
    lost = export.add_mutually_exclusive_group()
    lost.add_argument(
        "--lost", action="store_true", help="include the boxes of lost targets (default for csv, jsonl)"
    )
    lost.add_argument("--no-lost", action="store_true", help="leave them out (default for mot, coco)")
    export.add_argument("--overwrite", action="store_true", help="replace the file if it exists")
