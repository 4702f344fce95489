"""The arguments of `calibrate`, `learn-shape` and `learn-stereo`."""

from __future__ import annotations

import argparse
from typing import Any

from bayesnet_track.cli.options.arguments import cells, gradient, metres, share, whole_number
from bayesnet_track.cli.options.sources import add_depth_options, add_window_options
from bayesnet_track.cli.slips import add_former_name


def add_calibrate(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    calibrate = commands.add_parser("calibrate", help="calibrate a stereo pair from images of a chessboard")
    calibrate.add_argument("left", metavar="LEFT", help="images of the left camera: folder, glob or video")
    calibrate.add_argument("right", metavar="RIGHT", help="those of the right camera, in the same order")
    calibrate.add_argument("--board", required=True, metavar="CxR", help="inner corners across and down: 9x6")
    calibrate.add_argument(
        "--square", dest="square_m", required=True, type=metres, metavar="M", help="side of a square, m"
    )
    calibrate.add_argument("-o", "--out", required=True, metavar="FILE", help="calibration file to write")
    calibrate.add_argument("--overwrite", action="store_true", help="replace the file if it exists")


def add_learn_shape(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    shape = commands.add_parser("learn-shape", help="learn a shape model from masks, or boxes on a video")
    shape.add_argument("out", metavar="MODEL", help="model file to write (.npz)")
    examples = shape.add_mutually_exclusive_group(required=True)
    examples.add_argument("--masks", metavar="DIR", help="folder of mask images: the target is not black")
    examples.add_argument("--source", help="video file, folder of images, or glob")
    shape.add_argument("--truth", metavar="FILE", help="ground-truth file of the boxes in --source")
    add_former_name(shape, "--boxes", "--truth")
    shape.add_argument("--every", type=whole_number(1), default=1, metavar="N", help="every Nth frame only")
    shape.add_argument("--grid", type=cells, default=16, metavar="G", help="cells per side (default 16)")
    shape.add_argument(
        "--keep",
        type=share,
        default=0.95,
        metavar="SHARE",
        help="variance that the modes keep (default .95)",
    )
    shape.add_argument(
        "--min-support",
        type=share,
        default=0.5,
        metavar="SHARE",
        help="leave out silhouettes with a smaller share on edges (default .5)",
    )
    shape.add_argument(
        "--edge-gray",
        type=gradient,
        default=8.0,
        metavar="G",
        help="gradient where an edge starts, gray levels per pixel (default 8)",
    )


def add_learn_stereo(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    stereo = commands.add_parser("learn-stereo", help="learn how much a target's depth features vary")
    stereo.add_argument("--source", required=True, help="video file, folder of images, or glob")
    add_depth_options(stereo)
    stereo.add_argument(
        "--truth", required=True, metavar="FILE", help="ground-truth file of the boxes in the left image"
    )
    stereo.add_argument("--every", type=whole_number(1), default=1, metavar="N", help="every Nth frame only")
    stereo.add_argument(
        "--within",
        type=whole_number(2),
        metavar="N",
        help="measure the variation within N frames, about as many as the reference takes to follow "
        "(default: the whole video)",
    )
    stereo.add_argument(
        "--prior",
        type=whole_number(0),
        default=10,
        metavar="N",
        help="examples that the default counts for (default 10)",
    )
    stereo.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="a parameter of the cue, as YAML"
    )
    add_window_options(stereo)
