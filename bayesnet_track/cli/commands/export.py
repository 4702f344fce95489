"""The command `export`: a run's tracks in another tool's format."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from bayesnet_track.cli.commands.answer import OK, check_free, complain, writing

WITH_LOST = ("csv", "jsonl")
"""Formats that say of a box that its target is lost."""


def export(options: argparse.Namespace) -> int:
    """Write the file."""
    from bayesnet_track.runtime.recording.exports import FORMATS
    from bayesnet_track.runtime.recording.opened import open_run

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
