"""The command that tracks in many videos: `batch`."""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from bayesnet_track.cli.commands.answer import (
    INCOMPLETE,
    OK,
    UsageError,
    say,
    unheard,
    users_mistake,
    writing,
)

if TYPE_CHECKING:
    from bayesnet_track.cli.batch.jobs import Job, Video
    from bayesnet_track.cli.batch.work import Row
    from bayesnet_track.runtime.stop import StopRequest

TABLE = "results.csv"


def batch(options: argparse.Namespace) -> int:
    """Track in many videos."""
    from bayesnet_track.cli.batch.places import Place, Processes
    from bayesnet_track.cli.batch.table import BatchProgress, csv_text
    from bayesnet_track.cli.batch.work import FAILED
    from bayesnet_track.engine.starts import has_births
    from bayesnet_track.graph.text.load import load_graph
    from bayesnet_track.journal.atomic import write_atomically

    graph = load_graph(options.graph)
    videos = _videos(options)
    if not has_births(graph):
        lone = next((one for one in videos if one.init is None and one.init_from is None), None)
        if lone is not None:
            raise UsageError(
                f"{lone.name}: no start box: give --init-from PATTERN, --init, or init in the list"
            )
    out = Path(options.out)
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
    jobs = _jobs(options, videos, out)
    progress = BatchProgress(sys.stderr, jobs, sys.stderr.isatty())
    place: Place = Processes(options.jobs or os.cpu_count() or 1)
    if options.on == "ray":
        from bayesnet_track.cli.batch.ray_place import RayTasks

        place = RayTasks(options.ray_address)
    stop: StopRequest = options.stop
    rows: dict[Job, Row] = {}
    with users_mistake(), closing(place.run(jobs)) as heard:
        for told in heard:
            if told is not None and told.row is not None:
                rows[told.job] = told.row
            if told is not None and not options.quiet:
                unheard(partial(progress.update, told))
            if stop.between_frames():
                break
    done = [rows[job] for job in jobs if job in rows]
    write_atomically(out / TABLE, csv_text(done).encode("utf-8"))
    failed = sum(row["status"] == FAILED for row in done)
    parts = [f"{len(done)} of {len(jobs)} runs done", *([f"{failed} failed"] if failed else [])]
    say(f"{out}: {', '.join(parts)}; see {out / TABLE}")
    if stop.signal is not None:
        return stop.exit_code
    return INCOMPLETE if failed else OK


def _videos(options: argparse.Namespace) -> list[Video]:
    from dataclasses import replace

    from bayesnet_track.cli.batch.jobs import read_list, videos_of
    from bayesnet_track.cli.commands.start_boxes import parse_start

    if bool(options.source) == (options.list is not None):
        raise UsageError("give the videos by --source or by --list")
    with users_mistake():
        if options.list is not None:
            videos = read_list(Path(options.list))
        else:
            videos = videos_of(options.source, options.init_from, options.truth)
    if options.init is not None:
        videos = [replace(one, init=options.init) for one in videos]
    for one in videos:
        if one.init is not None:
            parse_start(one.init)
    return videos


def _jobs(options: argparse.Namespace, videos: list[Video], out: Path) -> list[Job]:
    from bayesnet_track.cli.batch.jobs import Job

    plugins = tuple(name for given in options.allow_plugins for name in given)
    return [
        Job(
            options.graph,
            video,
            seed,
            str(out / (video.name if options.seeds == 1 else f"{video.name}-seed{seed}")),
            options.end,
            options.on_resize,
            plugins,
        )
        for video in videos
        for seed in range(options.seeds)
    ]
