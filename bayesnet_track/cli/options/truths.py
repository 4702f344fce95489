"""The option that says what the lines of a file of ground truth hold."""

from __future__ import annotations

import argparse

FORMS = ("mot", "boxes", "corners", "polygons")
"""Those of `evaluate.truth`, which is not imported before it is needed."""


def add_truth_format(parser: argparse.ArgumentParser) -> None:
    """`--truth-format`."""
    parser.add_argument(
        "--truth-format",
        choices=FORMS,
        help="what a line of the ground truth holds: MOT, x,y,w,h, left,top,right,bottom, or four corners "
        "(default: what the lines look like)",
    )
