"""The command that tracks in many videos: `batch`."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Generator
from contextlib import closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.arguments import (
    INCOMPLETE,
    OK,
    UsageError,
    add_plugins,
    add_truth_format,
    complain,
    run_silently,
    say,
    seconds,
    users_mistake,
    users_output,
    whole_number,
)
from bayesnet_track.cli.options import add_range_option, add_size_option

if TYPE_CHECKING:
    from bayesnet_track.cli.batch.jobs import BatchVideo, Job, Part
    from bayesnet_track.cli.batch.places import JobPlace, JobProgress
    from bayesnet_track.cli.batch.results import BatchTable
    from bayesnet_track.runtime.stop import StopRequest


def _batch(options: argparse.Namespace) -> int:
    """Track in many videos."""
    from bayesnet_track.cli.batch.jobs import TABLE
    from bayesnet_track.cli.batch.results import BatchProgress, BatchTable, Ledger, Silence
    from bayesnet_track.engine.starts import has_births
    from bayesnet_track.graph.text.load import load_graph
    from bayesnet_track.graph.text.write import graph_sha256

    graph = load_graph(options.graph)
    videos = _videos(options)
    part: Part | None = options.part
    if part is not None:
        count, videos = len(videos), part.select(videos)
        if not videos:
            raise UsageError(
                f"--part {part.number}/{part.count}: of {count} videos this part has none; "
                f"give at most {count} parts"
            )
    if not has_births(graph):
        lone = next((video for video in videos if video.init is None and video.init_from is None), None)
        if lone is not None:
            raise UsageError(
                f"{lone.name}: no start box: give --init-from PATTERN, --init, or init in the list"
            )
    folder = Path(options.out)
    with users_output(folder):
        folder.mkdir(parents=True, exist_ok=True)
    jobs = _jobs(options, videos, folder)
    table = folder / (TABLE if part is None else f"results.{part.label}.csv")
    with users_mistake():
        ledger = Ledger(folder, "whole" if part is None else part.label, graph_sha256(graph.text))
        results = BatchTable(table, jobs, ledger)
    todo = results.todo
    finished = len(jobs) - len(todo)
    if finished and not options.quiet:
        complain(f"{finished} of {len(jobs)} runs were finished before")
    progress = BatchProgress(sys.stderr, todo, sys.stderr.isatty(), finished)
    stop: StopRequest = options.stop
    silence = Silence(time.monotonic())
    place = _place(options, len(todo)) if todo else None
    with users_mistake(), results, closing(place.run(todo) if place else _nothing()) as reports:
        for report in reports:
            results.add(report)
            for sentence in silence.hear(report, time.monotonic()):
                run_silently(partial(progress.note, sentence))
            if report is not None and not options.quiet:
                run_silently(partial(progress.update, report))
            elif report is not None and report.notice is not None:
                complain(f"{report.job.label}: {report.notice}")
            if stop.between_frames():
                break
    failed = _say_end(options, results, table)
    if stop.signal is not None:
        return stop.exit_code
    return INCOMPLETE if failed else OK


def _nothing() -> Generator[JobProgress | None, None, None]:
    yield from ()


def _say_end(options: argparse.Namespace, results: BatchTable, table: Path) -> int:
    """Write the overview, and say what came of the batch; how many runs did not finish."""
    from bayesnet_track.cli.batch.work import FINISHED
    from bayesnet_track.cli.commands.tracking import spread_text, summary_of

    rows = results.rows()
    failed = sum(row["status"] != FINISHED for row in rows)
    mean = results.mean()
    overview = results.write_overview(f"Batch of {options.graph}")
    summary = summary_of([row for row in rows if row["status"] == FINISHED]) if options.seeds > 1 else {}
    if options.json:
        measures = {name: asdict(spread) for name, spread in summary.items()}
        report = {
            "out": str(table.parent),
            "runs": rows,
            "failed": failed,
            "of": results.expected,
            "mean": mean,
        }
        say(json.dumps({**report, "summary": measures} if summary else report))
    elif not options.quiet:
        parts = [f"{len(rows)} of {results.expected} runs done", *([f"{failed} failed"] if failed else [])]
        if mean:
            say("mean: " + ", ".join(f"{name} {value:.4g}" for name, value in mean.items()))
        say(f"{table.parent}: {', '.join(parts)}; see {table} and {overview}")
        if summary:
            say(spread_text(summary))
    return failed


def _part(text: str) -> Part:
    from bayesnet_track.cli.batch.jobs import Part

    try:
        return Part.parse(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _amount(text: str) -> int:
    units = {"M": 1 << 20, "G": 1 << 30, "T": 1 << 40}
    digits, unit = text[:-1], text[-1:].upper()
    if unit not in units or not (digits.isascii() and digits.isdigit() and 0 < int(digits) < 1 << 20):
        raise argparse.ArgumentTypeError(
            f"{text!r}: a whole number of M, G or T (bytes) is needed, such as 2G"
        )
    return int(digits) * units[unit]


def _place(options: argparse.Namespace, jobs: int) -> JobPlace:
    """The place of the runs; raises UsageError where the limit on open files allows none."""
    from bayesnet_track.cli.batch.places import Needs

    needs = Needs(options.cpus, options.memory)
    if options.on == "ray":
        from bayesnet_track.cli.batch.ray_place import RayTasks

        return RayTasks(options.ray_address, options.timeout, needs)
    from bayesnet_track.cli.batch.places import MANY_FILES, Processes, most_runs

    with users_mistake():
        room = needs.fitting_here()
    requested = min(options.jobs or room, jobs)
    limit = most_runs()
    if limit == 0:
        raise UsageError(f"too few files may be open to start a run; {MANY_FILES}")
    if limit is not None and limit < requested:
        complain(f"no more than {limit} runs at a time, not {requested}: {MANY_FILES}")
    return Processes(requested if limit is None else min(requested, limit), options.timeout)


def _videos(options: argparse.Namespace) -> list[BatchVideo]:
    from dataclasses import replace

    from bayesnet_track.cli.arguments import parse_start
    from bayesnet_track.cli.batch.jobs import read_list, videos_of

    if bool(options.source) == (options.list is not None):
        raise UsageError("give the videos by --source or by --list")
    with users_mistake():
        if options.list is not None:
            videos = read_list(Path(options.list))
        else:
            videos = videos_of(options.source, options.init_from, options.truth)
    if options.init is not None:
        videos = [replace(video, init=options.init) for video in videos]
    for video in videos:
        if video.init is not None:
            parse_start(video.init)
    return videos


def _jobs(options: argparse.Namespace, videos: list[BatchVideo], folder: Path) -> list[Job]:
    from bayesnet_track.cli.batch.jobs import Job

    plugins = tuple(name for group in options.allow_plugins for name in group)
    files = tuple(str(Path(file).absolute()) for file in options.cue_file)
    return [
        Job(
            options.graph,
            video,
            seed,
            str(folder / (video.name if options.seeds == 1 else f"{video.name}-seed{seed}")),
            options.end,
            options.on_resize,
            plugins,
            files,
            options.max_side,
            options.value_range,
            options.truth_format,
        )
        for video in videos
        for seed in range(options.seeds)
    ]


def _add_batch(commands: argparse._SubParsersAction[Any]) -> None:
    batch = commands.add_parser(
        "batch",
        help="track targets in many videos in parallel",
        description="Every video with every seed is a run below DIR, in its own process. The same command, "
        "repeated, skips finished runs and resumes interrupted ones. A video that fails is "
        "reported and does not stop the others; the exit code is then 5.",
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
    start.add_argument("--init", metavar="X,Y,W,H", help="start box in the first frame of each video")
    start.add_argument(
        "--init-from",
        metavar="PATTERN",
        help="ground-truth file whose first box is the start box: {folder}/groundtruth.txt, truth/{name}.txt",
    )
    batch.add_argument("--truth", metavar="PATTERN", help="ground-truth file to score with, in the same way")
    add_truth_format(batch)
    batch.add_argument(
        "-o", "--out", metavar="DIR", required=True, help="folder of the runs and of results.csv"
    )
    batch.add_argument(
        "--jobs", type=whole_number(1), metavar="N", help="parallel runs (default: one per processor)"
    )
    batch.add_argument(
        "--part",
        type=_part,
        metavar="K/N",
        help="only every N-th video, from the K-th on: for one of N computers that share the work in DIR",
    )
    batch.add_argument(
        "--cpus",
        type=whole_number(1),
        default=1,
        metavar="N",
        help="processors to reserve for each run (default 1)",
    )
    batch.add_argument(
        "--memory",
        type=_amount,
        metavar="SIZE",
        help="memory to reserve for each run, as 800M or 2G (default: none)",
    )
    batch.add_argument(
        "--timeout",
        type=seconds,
        metavar="S",
        help="seconds that a run may take; one that takes longer is stopped, and counts as failed",
    )
    batch.add_argument(
        "--on",
        choices=["here", "ray"],
        default="here",
        help="in processes of this computer, or as tasks of a Ray cluster whose nodes all see the videos "
        "and DIR (default here)",
    )
    batch.add_argument(
        "--ray-address",
        metavar="ADDRESS",
        help="address of the cluster: auto, HOST:PORT (default: start one here)",
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
        "--on-resize", choices=["stop", "rescale"], default="stop", help="what to do when frames change size"
    )
    add_size_option(batch)
    add_range_option(batch)
    batch.add_argument("-q", "--quiet", action="store_true", help="only errors and warnings")
    batch.add_argument("--json", action="store_true", help="at the end, one JSON object with one row per run")
    add_plugins(batch)


COMMANDS = {"batch": (_add_batch, _batch)}
