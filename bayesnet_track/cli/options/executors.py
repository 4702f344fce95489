"""Options of the commands that track about how and where agents are asked; none changes a result."""

from __future__ import annotations

import argparse

from bayesnet_track.cli.options.arguments import seconds, whole_number


def add_executor_options(parser: argparse.ArgumentParser) -> None:
    """`--executor`, `--workers`, `--place`, `--agent-timeout`, `--agent-memory`."""
    group = parser.add_argument_group("where agents run (changes no result)")
    group.add_argument(
        "--executor",
        type=_executor,
        choices=["serial", "threads", "processes"],
        default="serial",
        help="one after the other, in parallel threads, or in supervised worker processes (default serial)",
    )
    group.add_argument(
        "--workers",
        type=whole_number(1),
        metavar="N",
        help="threads or worker processes (default: as many as there are processors)",
    )
    group.add_argument(
        "--place",
        action="append",
        default=[],
        metavar="AGENT=WHERE",
        help="put an agent into the engine or a process: flow=process, person.flow=engine; or the whole "
        "nets of a plate: person=process; goes before `on` in the graph",
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


def _executor(text: str) -> str:
    if text == "ray":
        raise argparse.ArgumentTypeError(
            "ray is no longer an executor; use --executor processes on one machine, and "
            "`bayesnet-track batch --on ray` for whole videos on a cluster"
        )
    return text
