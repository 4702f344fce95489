"""Options of the commands that track or read a source: the source, what is printed and kept."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.arguments import (
    UsageError,
    complain,
    milliseconds,
    seconds,
    users_mistake,
    whole_number,
)

if TYPE_CHECKING:
    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.runtime.executors import Executing
    from bayesnet_track.sources.frames import Source
    from bayesnet_track.sources.several import SeveralSources


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """`--seed`, `--overwrite`, what is printed, and how agents are asked."""
    parser.add_argument(
        "--seed", type=whole_number(0), default=0, metavar="N", help="seed of all randomness (default 0)"
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="replace an earlier run in the same directory"
    )
    add_output_options(parser)
    add_checkpoints(parser)
    add_executor_options(parser)
    parser.add_argument(
        "--allow-other-machine",
        action="store_true",
        help="with --hosts ray: also use hosts with another type of processor, or other versions; the last "
        "digits of results then differ",
    )


def add_output_options(parser: argparse.ArgumentParser) -> None:
    """`--quiet`, `--verbose`, `--json`, `--log-json`."""
    group = parser.add_argument_group("what is printed")
    group.add_argument("-q", "--quiet", action="store_true", help="only errors and warnings")
    group.add_argument("-v", "--verbose", action="store_true", help="every decision when it is made")
    group.add_argument(
        "--json", action="store_true", help="at the end, one JSON object that summarises the run"
    )
    group.add_argument("--log-json", action="store_true", help="progress as JSON lines, on stderr")


def add_checkpoints(parser: argparse.ArgumentParser) -> None:
    """`--checkpoint-every`."""
    parser.add_argument(
        "--checkpoint-every",
        type=_seconds,
        default=1.0,
        metavar="S",
        help="seconds between checkpoints, from which `resume` continues (default 1; 0 for none)",
    )


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r}: a number of seconds from 0 on is needed")
    return value


def add_executor_options(parser: argparse.ArgumentParser) -> None:
    """`--executor`, `--workers`, `--place`, `--agent-timeout`, `--agent-memory`."""
    group = parser.add_argument_group("where agents run (changes no result)")
    group.add_argument(
        "--executor",
        choices=["serial", "processes"],
        default="serial",
        help="one after the other, or in supervised worker processes (default serial)",
    )
    group.add_argument(
        "--hosts",
        choices=["engine", "process", "ray"],
        default="engine",
        help="where each camera is decoded and its agents run: in the engine's process (default), in a "
        "process of its own, or on the node of a Ray cluster that has a resource of the camera's name",
    )
    group.add_argument(
        "--workers",
        type=whole_number(1),
        metavar="N",
        help="worker processes (default: as many as there are processors)",
    )
    group.add_argument(
        "--place",
        action="append",
        default=[],
        metavar="AGENT=WHERE",
        help="put an agent into the engine or a process: flow=process, person.flow=engine; takes precedence "
        "over `on` in the graph",
    )
    group.add_argument(
        "--agent-timeout",
        type=seconds,
        metavar="S",
        help="seconds to wait for an agent in a process (default 10, and 30 for its first answers)",
    )
    group.add_argument(
        "--agent-memory",
        type=whole_number(1),
        metavar="MB",
        help="memory that a worker process may use, beyond what it starts with (default: no limit)",
    )


def add_outside_options(parser: argparse.ArgumentParser) -> None:
    """`--inputs`, `--budget-ms`, `--realtime`."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--inputs",
        metavar="FILE",
        help="inputs.jsonl of an earlier run: repeat its external inputs (manual switches, faults)",
    )
    group.add_argument(
        "--budget-ms",
        type=milliseconds,
        metavar="MS",
        help="time that a frame may take; if frames take longer, the agents with the least information"
        " per millisecond are switched off",
    )
    group.add_argument(
        "--realtime",
        action="store_true",
        help="the same, with the frame interval of the source as the budget",
    )


def add_rerun_option(parser: argparse.ArgumentParser) -> None:
    """Add it."""
    parser.add_argument(
        "--rerun",
        nargs="?",
        const="",
        metavar="FILE.rrd",
        help="log frames, boxes, UD, KL and events to a Rerun recording, or without a file to its viewer "
        "(needs the extra `rerun`)",
    )


FORMATS = ("mkv", "mp4")


def add_video_option(parser: argparse.ArgumentParser) -> None:
    """`--video`, alone or with a format."""
    parser.add_argument(
        "--video",
        nargs="?",
        const="mkv",
        default=False,
        type=_format,
        metavar="FORMAT",
        help="also write the annotated video into the run: video.mkv, or video.mp4 with --video mp4",
    )
    parser.add_argument(
        "--video-side",
        type=whole_number(16),
        metavar="PX",
        help="with --video: scale it down to so many px of its longer side (1920)",
    )


def _format(text: str) -> str:
    if text in FORMATS:
        return text
    suffix = text.rpartition(".")[2].lower()
    if suffix in FORMATS:
        raise argparse.ArgumentTypeError(
            f"{text!r}: the video is written into the run, as video.{suffix}: --video {suffix}"
        )
    raise argparse.ArgumentTypeError(f"{text!r}: mkv or mp4 is needed, or nothing: write --video last")


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
        help="scale frames down until their longer side is at most PX; boxes stay in pixels of the source, "
        "but lengths in the graph, or of the detector, are pixels of the smaller frames",
    )


def value_range(text: str) -> tuple[float, float]:
    """Parser of LOW,HIGH."""
    from bayesnet_track.sources.entrances.levels import value_range_of

    try:
        limits = value_range_of(text.split(","))
    except ValueError:
        limits = None
    if limits is None:
        raise argparse.ArgumentTypeError(f"{text!r}: LOW,HIGH is needed, two numbers, the lower one first")
    return limits


def add_range_option(parser: argparse.ArgumentParser) -> None:
    """`--range`."""
    parser.add_argument(
        "--range",
        dest="value_range",
        type=value_range,
        metavar="LOW,HIGH",
        help="for images and videos of more than 8 bits: the values that become black and white in the 8 "
        "bits that are tracked (default: all of 16 bits); write --range=LOW,HIGH if one is negative",
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
        "(default: live if it seems to have no end)",
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


def given_once_or_named(option: str, values: Sequence[str] | str | None, graph: CheckedGraph) -> Any:
    """A text that is given once, or, of a graph with several cameras, camera -> text; None without any.

    Raises:
        UsageError: several texts for one image, a text without one of the cameras, or a camera twice.
    """
    texts = [values] if isinstance(values, str) else list(values or ())
    if not texts:
        return None
    cameras = graph.several_cameras
    if not cameras:
        if len(texts) > 1:
            raise UsageError(
                f"{len(texts)} {option}: allowed: one; the graph {graph.spec.name} has not several cameras"
            )
        return texts[0]
    from bayesnet_track.graph.text.messages import nearest

    named: dict[str, str] = {}
    for text in texts:
        camera, equals, value = text.partition("=")
        if not equals or camera not in cameras:
            suggestion = nearest(camera, cameras) if equals else ""
            raise UsageError(
                f"{option} {text}: CAMERA=... is needed with one of {', '.join(cameras)}, the cameras of the "
                f"graph {graph.spec.name}" + (f"; nearest: {suggestion}" if suggestion else "")
            )
        if camera in named:
            raise UsageError(f"{option} {text}: the second one of camera {camera}, after {named[camera]}")
        named[camera] = value
    return named


def open_cameras_given(
    options: argparse.Namespace, graph: CheckedGraph, executing: Executing
) -> SeveralSources:
    """The sources of several cameras, or their detections alone, merged by time; raises UsageError."""
    from bayesnet_track.runtime.several_cameras import open_cameras

    for option in ("right", "stereo", "depth", "calibration", "view", "max_side", "init_from"):
        if getattr(options, option, None) is not None:
            name = f"--{option.replace('_', '-')}"
            raise UsageError(f"{name} is of one image, and the graph {graph.spec.name} has several cameras")
    how = {name: getattr(options, name) for name in ("allow_network", "on_resize", "stride", "value_range")}
    how |= {"start": options.start or None, "end": options.end}
    return open_cameras(graph, options.source, options.detections, executing, **how)


def say_size(options: argparse.Namespace, source: Source) -> None:
    """Say which pixels are meant where, of smaller frames; raises UsageError where they cannot be."""
    from bayesnet_track.runtime.arguments import resizing_of

    with users_mistake():
        resizing = resizing_of(source, options.max_side)
    if not (resizing.is_none or options.quiet):
        (width, height), (columns, rows) = resizing.source, resizing.tracked
        complain(
            f"frames of {width}x{height} px are tracked at {columns}x{rows} px: boxes are in pixels of the "
            "source, UD and lengths in the graph in pixels of the smaller frames"
        )
