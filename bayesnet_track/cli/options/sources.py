"""Options of the commands that read a source: which one, which part of it, and its depth."""

from __future__ import annotations

import argparse

from bayesnet_track.cli.options.arguments import whole_number


def add_depth_options(parser: argparse.ArgumentParser) -> None:
    """`--right`, `--stereo`, `--depth`, `--calibration`."""
    second = parser.add_mutually_exclusive_group()
    second.add_argument("--right", metavar="SOURCE", help="the right camera; --source is then the left one")
    second.add_argument(
        "--stereo",
        choices=["side_by_side"],
        help="both images side by side in one frame, the left camera on the left",
    )
    second.add_argument(
        "--depth", metavar="FOLDER", help="depth of another sensor, a file per frame (16-bit images, .npy)"
    )
    parser.add_argument(
        "--calibration",
        metavar="FILE",
        help="calibration of the pair, OpenCV YAML; see `calibrate`",
    )


def add_size_option(parser: argparse.ArgumentParser) -> None:
    """`--max-side`."""
    parser.add_argument(
        "--max-side",
        type=whole_number(16),
        metavar="PX",
        help="track in smaller frames, their longer side at most PX; boxes stay in pixels of the source, "
        "lengths in the graph count those of the smaller frames",
    )


def add_window_options(parser: argparse.ArgumentParser) -> None:
    """`--start`, `--end`, `--stride`, `--on-resize`, `--allow-network`, `--isolate-decoder`."""
    parser.add_argument(
        "--start", type=whole_number(0), default=0, metavar="N", help="first frame (default 0)"
    )
    parser.add_argument("--end", type=whole_number(1), metavar="N", help="frame to stop before")
    parser.add_argument(
        "--stride",
        type=whole_number(1),
        default=1,
        metavar="K",
        help="read every K-th frame only; frame numbers and times stay those of the source (default 1)",
    )
    parser.add_argument(
        "--on-resize", choices=["stop", "rescale"], default="stop", help="what to do when frames change size"
    )
    parser.add_argument("--allow-network", action="store_true", help="let the source be a URL")
    parser.add_argument(
        "--isolate-decoder", action="store_true", help="decode in a separate process with resource limits"
    )
