"""Options of the commands that read a source: which one, which part of it, and its depth."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from bayesnet_track.cli.commands.answer import UsageError
from bayesnet_track.cli.options.arguments import whole_number

if TYPE_CHECKING:
    from bayesnet_track.sources.frames import Source


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


def _max_side(text: str) -> int:
    from bayesnet_track.runtime.resizing import LEAST_MAX_SIDE

    return whole_number(LEAST_MAX_SIDE)(text)


def add_size_option(parser: argparse.ArgumentParser) -> None:
    """`--max-side`."""
    parser.add_argument(
        "--max-side",
        type=_max_side,
        metavar="PX",
        help="use smaller frames, their longer side at most PX; boxes stay in pixels of the source, lengths "
        "in the graph, or of the detector, count those of the smaller frames",
    )


def value_range(text: str) -> tuple[float, float]:
    """Parser of LOW,HIGH."""
    from bayesnet_track.sources.entrances.levels import value_range_of

    try:
        found = value_range_of(text.split(","))
    except ValueError:
        found = None
    if found is None:
        raise argparse.ArgumentTypeError(f"{text!r}: LOW,HIGH is needed, two numbers, the lower one first")
    return found


def add_range_option(parser: argparse.ArgumentParser) -> None:
    """`--range`."""
    parser.add_argument(
        "--range",
        dest="value_range",
        type=value_range,
        metavar="LOW,HIGH",
        help="values that become black and white in the 8 bits in which frames are tracked, of images and "
        "videos with more bits; for negative ones --range=LOW,HIGH (default: all of 16 bits)",
    )


def add_window_options(parser: argparse.ArgumentParser) -> None:
    """The frames, `--range`, `--on-resize`, and how a source may be opened."""
    add_range_option(parser)
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
        "--live",
        action=argparse.BooleanOptionalAction,
        help="read the newest frame of a URL and reconnect, or (--no-live) every frame up to its end "
        "(default: live where it seems to have no end)",
    )


def open_given(options: argparse.Namespace) -> Source:
    """The source, with depth where the options name a second eye or another sensor."""
    from bayesnet_track.sources.sources import open_source

    if options.right is not None or options.stereo is not None or options.depth is not None:
        return open_depth(options, options.end)
    if options.calibration is not None:
        raise UsageError("--calibration is of a pair: give --right, --stereo or --depth, too")
    window = (options.source, options.start, options.end, options.allow_network, options.on_resize)
    return open_source(*window, options.stride, options.live, options.value_range)


def open_depth(options: argparse.Namespace, end: int | None) -> Source:
    """The source up to frame `end`, with depth by the options of `add_depth_options`."""
    from bayesnet_track.sources.stereo_source import open_stereo_source

    return open_stereo_source(
        options.source,
        options.start,
        end,
        options.allow_network,
        options.on_resize,
        right=options.right,
        depth=options.depth,
        side_by_side=options.stereo is not None,
        calibration=options.calibration,
        stride=options.stride,
        live=options.live,
        value_range=options.value_range,
    )
