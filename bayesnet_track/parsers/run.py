"""The arguments of `demo` and `run`."""

from __future__ import annotations

import argparse
from typing import Any

from bayesnet_track.cli.options.arguments import whole_number
from bayesnet_track.cli.options.outside import add_outside_options
from bayesnet_track.cli.options.plugins import add_plugins
from bayesnet_track.cli.options.rerun import add_rerun_option
from bayesnet_track.cli.options.runs import add_run_options
from bayesnet_track.cli.options.sources import add_depth_options, add_window_options
from bayesnet_track.cli.options.view import add_view_options


def add_demo(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    demo = commands.add_parser("demo", help="track in a built-in synthetic scene; nothing to download")
    demo.add_argument(
        "scene", nargs="?", default="two_squares", metavar="SCENE", help="default two_squares; see `list`"
    )
    demo.add_argument("--graph", help="graph to use instead of the scene's own")
    demo.add_argument(
        "--out", metavar="RUN", help="run directory (default runs/SCENE, replaced if it exists)"
    )
    demo.add_argument("--end", type=whole_number(1), metavar="N", help="frame to stop before")
    add_run_options(demo)
    add_view_options(demo)
    add_plugins(demo)


def add_run(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    run = commands.add_parser(
        "run",
        help="track in a video with a graph",
        epilog="`run --what-if RUN ...` is `what-if RUN ...`: an earlier run again with something changed.",
    )
    run.add_argument("graph", metavar="GRAPH", help="path of a YAML file, or name of an installed graph")
    run.add_argument(
        "--source", required=True, help="video file, folder of images, glob, camera index, or URL"
    )
    run.add_argument("--out", metavar="RUN", required=True, help="run directory to write")
    add_depth_options(run)
    start = run.add_mutually_exclusive_group()
    start.add_argument(
        "--init",
        action="append",
        metavar="X,Y,W,H",
        help="start box in the first frame, top-left corner, px; PLATE:X,Y,W,H names the plate; "
        "give it again for a further target; needed unless the graph has `birth`",
    )
    start.add_argument(
        "--init-from", metavar="FILE", help="ground-truth file; its box of the first frame is the start box"
    )
    run.add_argument(
        "--detections", metavar="FILE", help="detections (MOT, JSON Lines) for a graph with births by them"
    )
    run.add_argument("--video", action="store_true", help="write the annotated video too (video.mkv)")
    add_outside_options(run)
    add_rerun_option(run)
    add_window_options(run)
    add_run_options(run)
    add_view_options(run)
    add_plugins(run)
