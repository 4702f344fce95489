"""The arguments of `detect`."""

from __future__ import annotations

import argparse
from typing import Any

from bayesnet_track.cli.options.plugins import add_plugins
from bayesnet_track.cli.options.sources import add_depth_options, add_window_options


def add_detect(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    detect = commands.add_parser("detect", help="find targets in every frame with a detector")
    detect.add_argument("name", metavar="DETECTOR", help="see `list`")
    detect.add_argument(
        "--source", required=True, help="video file, folder of images, glob, camera index, or URL"
    )
    add_depth_options(detect)
    detect.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="a parameter of the detector, as YAML"
    )
    detect.add_argument(
        "--learn",
        metavar="X,Y,W,H",
        help="box of the target in the first frame, for one that can be shown it",
    )
    detect.add_argument(
        "--out",
        metavar="FILE",
        help="file to write: JSON Lines if it ends in .jsonl, else MOT (default: print)",
    )
    detect.add_argument("--video", metavar="FILE", help="write the video with the boxes too (.mkv or .mp4)")
    add_window_options(detect)
    detect.add_argument("--overwrite", action="store_true", help="replace files that are there")
    add_plugins(detect)
