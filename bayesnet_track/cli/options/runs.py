"""Options of the commands that track: what they print and keep, and how and where agents are asked."""

from __future__ import annotations

import argparse

from bayesnet_track.cli.options.arguments import milliseconds, seconds, whole_number


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
        help="put an agent into the engine or a process: flow=process, person.flow=engine; goes before `on` "
        "in the graph",
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
        help="inputs.jsonl of an earlier run: repeat its external inputs (switches by hand, faults)",
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
