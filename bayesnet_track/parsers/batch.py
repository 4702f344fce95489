"""The arguments of `batch`."""

from __future__ import annotations

import argparse
from typing import Any

from bayesnet_track.cli.options.arguments import whole_number
from bayesnet_track.cli.options.plugins import add_plugins


def add_batch(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    batch = commands.add_parser(
        "batch",
        help="track in many videos with a graph, side by side",
        description="Every video with every seed is a run below DIR, in a process of its own. Given "
        "again, the same command skips what is finished and goes on with what was broken off. A video that "
        "fails is reported and stops no other; the exit code is 5 then.",
    )
    batch.add_argument("graph", metavar="GRAPH", help="path of a YAML file, or name of an installed graph")
    batch.add_argument(
        "--source",
        action="append",
        default=[],
        help="video, folder of images, or a pattern of these; may be repeated (quote patterns)",
    )
    batch.add_argument(
        "--list",
        metavar="FILE",
        help="instead, a list of videos: CSV or JSON Lines with source, name, init, init_from, truth",
    )
    start = batch.add_mutually_exclusive_group()
    start.add_argument("--init", metavar="X,Y,W,H", help="start box in the first frame of each")
    start.add_argument(
        "--init-from",
        metavar="PATTERN",
        help="ground-truth file whose first box starts it: {folder}/groundtruth.txt, truth/{name}.txt",
    )
    batch.add_argument("--truth", metavar="PATTERN", help="ground-truth file to score with, in the same way")
    batch.add_argument("--out", metavar="DIR", required=True, help="folder of the runs and of results.csv")
    batch.add_argument(
        "--jobs", type=whole_number(1), metavar="N", help="runs at a time (default: one for each processor)"
    )
    batch.add_argument(
        "--on",
        choices=["here", "ray"],
        default="here",
        help="in processes of this computer, or as tasks of a Ray cluster whose nodes all see the videos "
        "and DIR (default here)",
    )
    batch.add_argument(
        "--ray-address", metavar="ADDRESS", help="of the cluster: auto, HOST:PORT (default: start one here)"
    )
    batch.add_argument(
        "--seeds",
        type=whole_number(1),
        default=1,
        metavar="N",
        help="runs of each video, seeds 0.. (default 1)",
    )
    batch.add_argument("--end", type=whole_number(1), metavar="N", help="frame of each video to stop before")
    batch.add_argument(
        "--on-resize", choices=["stop", "rescale"], default="stop", help="when pictures change size"
    )
    batch.add_argument("--quiet", action="store_true", help="no progress")
    add_plugins(batch)
