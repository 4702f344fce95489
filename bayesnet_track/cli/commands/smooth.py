"""The command `smooth`: a finished run given the whole sequence, as a run of its own."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from bayesnet_track.cli.commands.answer import BAD_SOURCE, OK, UsageError, complain, say
from bayesnet_track.cli.options.arguments import whole_number


def smooth(options: argparse.Namespace) -> int:
    """Smooth a run and write the result."""
    from bayesnet_track.runtime.recording.run_reader import open_run
    from bayesnet_track.runtime.recording.rundir import RunDirectoryError
    from bayesnet_track.runtime.recording.smoothed import write_smoothed
    from bayesnet_track.runtime.smoothing import KeptBeliefsError
    from bayesnet_track.runtime.smoothing import smooth as smooth_run

    try:
        run = open_run(options.run, complain)
    except RunDirectoryError as error:
        complain(f"bayesnet-track smooth: {error}")
        return BAD_SOURCE
    try:
        smoothed = smooth_run(run, options.draws, options.seed, options.map)
    except KeptBeliefsError as error:
        raise UsageError(str(error)) from error
    write_smoothed(run, smoothed, Path(options.out), options.overwrite)
    frames = len({line.frame for line in smoothed.metrics})
    say(f"{options.out}: {frames} frames smoothed; `bayesnet-track report {options.out}` makes a page")
    return OK


def add_smooth(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    smooth = commands.add_parser(
        "smooth",
        help="estimate every frame of a finished run from the whole sequence",
        description="Run backward over the beliefs that `run --keep-beliefs` kept, without the video. The "
        "result is another run: boxes, uncertainties and regions are those given all frames; "
        "decisions, status and score are unchanged. Exit code 2: the run kept no beliefs.",
    )
    smooth.add_argument("run", metavar="RUN", help="run directory, written with --keep-beliefs")
    smooth.add_argument("--out", metavar="SMOOTHED", required=True, help="run directory to write")
    smooth.add_argument(
        "--draws",
        type=whole_number(1),
        default=50,
        metavar="N",
        help="trajectories drawn backward for each target (default 50; a Gaussian belief needs none)",
    )
    smooth.add_argument(
        "--seed", type=whole_number(0), default=0, metavar="N", help="seed of these draws (default 0)"
    )
    smooth.add_argument(
        "--map",
        action="store_true",
        help="let the boxes be those of the most probable trajectory, instead of the mean of each frame",
    )
    smooth.add_argument("--overwrite", action="store_true", help="replace an earlier run in --out")
