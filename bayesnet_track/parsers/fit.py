"""The arguments of `fit`."""

from __future__ import annotations

import argparse
from typing import Any

from bayesnet_track.cli.options.arguments import whole_number
from bayesnet_track.cli.options.plugins import add_plugins


def add_fit(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    fit = commands.add_parser("fit", help="calibrate a graph's score and regions on videos with truth")
    fit.add_argument("graph", metavar="GRAPH", help="path of a YAML file, or name of an installed graph")
    fit.add_argument(
        "--source", action="append", default=[], help="video, folder of images, or glob; may be repeated"
    )
    fit.add_argument(
        "--truth", action="append", default=[], metavar="FILE", help="ground-truth file of each --source"
    )
    fit.add_argument(
        "--folder", metavar="DATA", help="folder of NAME/img with NAME/groundtruth.txt: all of them"
    )
    fit.add_argument("--end", type=whole_number(2), metavar="N", help="frame of each video to stop before")
    fit.add_argument(
        "--seeds", type=whole_number(1), default=2, metavar="N", help="runs over each video (default 2)"
    )
    fit.add_argument(
        "--what",
        default="score,slack,lost",
        metavar="LIST",
        help="of score, slack, lost, ud, temperature, sds, policy (default score,slack,lost)",
    )
    fit.add_argument(
        "--features",
        default="log_ud_box,evidence",
        metavar="LIST",
        help="what the score goes by (default log_ud_box,evidence)",
    )
    fit.add_argument("--out", metavar="FILE", help="graph file to write (default: print it)")
    fit.add_argument("--overwrite", action="store_true", help="replace the file if it is there")
    fit.add_argument(
        "--leave-one-out",
        action="store_true",
        help="print how calibrated each video is by what is fitted to the others, and write nothing",
    )
    add_plugins(fit)
