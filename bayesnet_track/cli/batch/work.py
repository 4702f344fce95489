"""One job of a batch: begun, resumed, or complete already, in a process of its own; and its row."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.cli.batch.jobs import BatchError, Job, allow_job
from bayesnet_track.runtime.run import Start

if TYPE_CHECKING:
    from bayesnet_track.runtime.checkpoints.recipe import Recipe


Row = dict[str, str | int | float | None]

ROW = (
    "video",
    "seed",
    "status",
    "frames",
    "fps",
    "lost_frames",
    "agents_per_frame",
    "reconfigurations",
    "score_mean",
    "auc",
    "auc_strict",
    "precision20",
    "mean_iou",
    "lost_episodes",
    "reason",
)
"""Columns of the table of results."""

FINISHED, FAILED, TIMED_OUT = "finished", "failed", "timed out"
"""What a row's status can be."""


Progressing = Callable[[int, int | None], None]
"""Told of frames done, and to do where that is known."""


def do(job: Job, progress: Progressing) -> Row:
    """Track to the end, going on where an earlier try stopped; the row of it.

    `progress` is told of frames done and to do. What fails passes through.

    Raises:
        BatchError: the run that is there already was asked for otherwise.
        ValueError: the ground truth is not that of one target; nothing is tracked then.
    """
    from bayesnet_track.runtime.checkpoints.recipe import Recipe, RecipeError
    from bayesnet_track.runtime.checkpoints.resume import resume
    from bayesnet_track.runtime.checkpoints.standing import standing
    from bayesnet_track.runtime.recording.manifest import settle_broken
    from bayesnet_track.runtime.recording.rundir import RunDirectory
    from bayesnet_track.runtime.results import Summary
    from bayesnet_track.runtime.session import track
    from bayesnet_track.sources.frames import OnResize
    from bayesnet_track.sources.sources import open_source

    _check_truth(job)
    summary = Summary()
    settle_broken(RunDirectory(Path(job.out)))
    try:
        run_state = standing(job.out)
    except RecipeError:
        run_state = None
    if run_state is not None:
        _check_same(job, Recipe.read(job.out))
    if run_state is not None and not run_state.is_finished:
        for _ in resume(job.out, summary=summary):
            progress(summary.frames, None)
    elif run_state is None:
        on_resize: OnResize = "rescale" if job.on_resize == "rescale" else "stop"
        with open_source(
            job.video.source, end=job.end, on_resize=on_resize, value_range=job.value_range
        ) as source:
            expected = source.expected_frames
            results = track(
                job.graph,
                source,
                _starts(job),
                out=job.out,
                seed=job.seed,
                max_side=job.max_side,
                summary=summary,
                overwrite=True,
            )
            for _ in results:
                progress(summary.frames, expected)
    return row_of(job)


def _check_truth(job: Job) -> None:
    """Read the ground truth before anything is tracked; raises OSError, ValueError."""
    from bayesnet_track.evaluate.truth import read_truth
    from bayesnet_track.sources.entrances.notices import heard

    if job.video.truth is None:
        return
    try:
        with heard(lambda _: None):  # it is read again, and said, when it is scored with
            read_truth(job.video.truth, job.truth_format)
    except ValueError as error:
        raise ValueError(
            f"{error}; nothing was tracked. A batch scores with the ground truth of one target: "
            "leave --truth out, and `score RUN --truth FILE` scores the run of several"
        ) from error


def row_of(job: Job) -> Row:
    """The row of a finished run; raises OSError, ValueError when its files do not make one."""
    from bayesnet_track.evaluate.runs import score_run
    from bayesnet_track.evaluate.scores import frames_per_second
    from bayesnet_track.journal.events.runs import RunEnded
    from bayesnet_track.journal.net import Switch
    from bayesnet_track.runtime.recording.run_reader import open_run

    run = open_run(job.out)
    events, metrics = run.events, run.metrics
    ended = next((event for event in reversed(events) if isinstance(event, RunEnded)), None)
    is_complete = ended is not None and ended.complete
    row: Row = dict.fromkeys(ROW)
    row |= {
        "video": job.video.name,
        "seed": job.seed,
        "status": FINISHED if is_complete else FAILED,
        "frames": 0 if ended is None else ended.frames,
        "fps": frames_per_second(list(run.seconds.values())),
        "lost_frames": len({line.frame for line in metrics if line.status == "lost"}),
        "agents_per_frame": _mean([float(len(line.active)) for line in metrics]),
        "reconfigurations": sum(isinstance(event, Switch) for event in events),
        "score_mean": _mean([line.score for line in metrics]),
        "reason": "" if is_complete else "no end" if ended is None else ended.reason,
    }
    if job.video.truth is not None and metrics:
        scores = score_run(job.out, job.video.truth, metrics[0].target, job.truth_format)
        row |= {name: getattr(scores, name) for name in ROW if name in _SCORES}
    return {name: round(value, 6) if isinstance(value, float) else value for name, value in row.items()}


_SCORES = ("auc", "auc_strict", "precision20", "mean_iou", "lost_episodes")


def failed_row(job: Job, reason: str) -> Row:
    """The row of a job that failed."""
    row: Row = dict.fromkeys(ROW)
    return row | {"video": job.video.name, "seed": job.seed, "status": FAILED, "reason": reason}


def timed_out_row(job: Job, timeout_s: float) -> Row:
    """The row of a job that was stopped since it took too long."""
    reason = f"stopped after {timeout_s:g} s (--timeout); the same command goes on with it"
    return failed_row(job, reason) | {"status": TIMED_OUT}


def _check_same(job: Job, recipe: Recipe) -> None:
    """Refuse a run that was asked for otherwise: its results would be taken for this job's."""
    from bayesnet_track.graph.text.load import load_graph
    from bayesnet_track.graph.text.write import graph_sha256

    origin = recipe.origin
    source = origin.absolute.get(origin.text, origin.text)
    is_same_source = (
        job.video.source in (source, origin.text) or str(Path(job.video.source).absolute()) == source
    )
    was_and_is: dict[str, tuple[object, object]] = {
        "graph": (recipe.graph_sha256[:12], graph_sha256(load_graph(job.graph).text)[:12]),
        "source": (source, source if is_same_source else job.video.source),
        "start": (recipe.starts, tuple(_starts(job) or ())),
        "seed": (recipe.seed, job.seed),
        "end": (origin.end, job.end),
        "on_resize": (origin.on_resize, job.on_resize),
        "max_side": (recipe.max_side, job.max_side),
        "range": (_range_text(origin.value_range), _range_text(job.value_range)),
    }
    changes = [
        f"{name} {_word(was)}, now {_word(requested)}"
        for name, (was, requested) in was_and_is.items()
        if was != requested
    ]
    if changes:
        raise BatchError(
            f"{job.out}: the run there was asked for otherwise: {'; '.join(changes)}; "
            "give another --out, or remove it"
        )


def _range_text(value_range: tuple[float, float] | None) -> str | None:
    return None if value_range is None else "{:g},{:g}".format(*value_range)


def _word(value: object) -> str:
    if isinstance(value, tuple):
        return " ".join(",".join(f"{part:g}" for part in start.box) for start in value) or "none"
    return "none" if value is None else str(value)


def _starts(job: Job) -> list[Start] | None:
    from bayesnet_track.cli.arguments import parse_start
    from bayesnet_track.evaluate.truth import start_box

    if job.video.init is not None:
        return [parse_start(job.video.init)]
    if job.video.init_from is None:
        return None
    return [Start(start_box(job.video.init_from, 0, job.truth_format))]


def _mean(values: list[float]) -> float | None:
    return sum(values) / len(values) if values else None


EVERY_S = 0.5


def main() -> int:
    """Do jobs until the input ends; the exit code."""
    from bayesnet_track.cli.arguments import words
    from bayesnet_track.observation.settings import by_command_line
    from bayesnet_track.sources.entrances.notices import heard

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the batch decides
    answers = os.dup(1)
    os.dup2(2, 1)  # what cues print must not stand among the answers

    def send(message: object) -> None:
        os.write(answers, json.dumps(message).encode() + b"\n")

    for line in sys.stdin:
        job = Job.from_json(line)
        try:
            with heard(lambda text: send({"notice": text})), by_command_line():
                allow_job(job)
                row = do(job, progress_of(send))
        except (OSError, ValueError) as error:
            row = failed_row(job, " ".join(words(error).split()))
        send({"row": row})
    return 0


def progress_of(send: Callable[[dict[str, Any]], None], every_s: float = EVERY_S) -> Progressing:
    """A function that sends the progress of a job every `every_s` seconds at most."""
    sent_s = 0.0

    def progress(frames: int, expected: int | None) -> None:
        nonlocal sent_s
        if time.monotonic() >= sent_s + every_s:
            sent_s = time.monotonic()
            send({"done": frames, "expected": expected})

    return progress
