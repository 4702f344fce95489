"""The command `export`: a run's tracks, or its beliefs, in another tool's format."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.commands.answer import OK, UsageError, check_free, complain, writing
from bayesnet_track.cli.options.arguments import whole_number

if TYPE_CHECKING:
    from bayesnet_track.runtime.recording.run_reader import Run

WITH_LOST = ("csv", "jsonl", "frames")
"""Formats that say of a box that its target is lost."""


def export(options: argparse.Namespace) -> int:
    """Write the file."""
    from bayesnet_track.runtime.recording.exports import FORMATS
    from bayesnet_track.runtime.recording.run_reader import open_run

    if options.format == "arviz":
        return _export_beliefs(options)
    if options.draws is not None:
        raise UsageError(f"--draws beside --format {options.format}; it is for --format arviz")
    run = open_run(options.run, complain)
    if options.afterwards:
        run = _judged(run)
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


def _judged(run: Run) -> Run:
    """The run judged as a whole; says what changed."""
    from bayesnet_track.journal.text.wording import plural
    from bayesnet_track.runtime.recording.afterwards import judge_afterwards

    run, found = judge_afterwards(run)
    if not found:
        raise UsageError(
            f"--afterwards: no target of {run.name} has a guarantee with levels for it; "
            "`bayesnet-track fit --guarantee` writes them"
        )
    for one in found:
        complain(
            f"target {one.target}: tracking in {one.afterwards} of {plural(one.frames, 'frame')} instead of "
            f"{one.live}, where the mean score is above {one.level:.4g}"
        )
    return run


def _export_beliefs(options: argparse.Namespace) -> int:
    """Write draws of the kept beliefs for ArviZ."""
    from bayesnet_track.runtime.recording.arviz_file import ArvizError, write_arviz
    from bayesnet_track.runtime.recording.run_reader import open_run
    from bayesnet_track.runtime.smoothing import KeptBeliefsError

    if options.lost or options.no_lost:
        raise UsageError("--lost and --no-lost are not for --format arviz, which writes every belief")
    if options.afterwards:
        raise UsageError("--afterwards judges statuses; --format arviz writes beliefs")
    if options.out is None:
        raise UsageError("--format arviz writes a binary file; give its name with --out")
    out = Path(options.out)
    check_free(out, options.overwrite)
    run = open_run(options.run, complain)
    try:
        with writing(out):
            write_arviz(run, out, options.draws or DRAWS)
    except (KeptBeliefsError, ArvizError) as error:
        raise UsageError(str(error)) from error
    complain(f"wrote {out}")
    return OK


DRAWS = 500
FORMATS = ("mot", "coco", "csv", "jsonl", "frames", "arviz")


def add_export(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    export = commands.add_parser("export", help="write a run in the format of another tool")
    export.add_argument("run", metavar="RUN", help="run directory")
    export.add_argument("--format", required=True, choices=FORMATS, help="format of the file")
    export.add_argument("-o", "--out", metavar="FILE", help="file to write (default: print)")
    export.add_argument(
        "--draws",
        type=whole_number(1),
        metavar="N",
        help=f"draws of each belief, for --format arviz (default {DRAWS})",
    )
    lost = export.add_mutually_exclusive_group()
    lost.add_argument(
        "--lost",
        action="store_true",
        help="include the boxes of lost targets (default for csv, jsonl, frames)",
    )
    lost.add_argument("--no-lost", action="store_true", help="leave them out (default for mot, coco)")
    export.add_argument(
        "--afterwards",
        action="store_true",
        help="statuses as the graph's guarantee allows now that the run is over",
    )
    export.add_argument("--overwrite", action="store_true", help="replace the file if it exists")
