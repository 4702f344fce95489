"""One job of a batch: begun, gone on with, or found finished; and its row of the table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bayesnet_track.batch.jobs import Job
from bayesnet_track.runtime.run import Start

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

FINISHED, FAILED = "finished", "failed"


def do(job: Job, progress: Callable[[int, int | None], None]) -> Row:
    """Track to the end, going on where an earlier try stopped; the row of it.

    `progress` is told of frames done and to do. What fails passes through.
    """
    from bayesnet_track.runtime.frames import OnResize
    from bayesnet_track.runtime.recipe import RecipeError
    from bayesnet_track.runtime.resume import resume, standing
    from bayesnet_track.runtime.run import Summary
    from bayesnet_track.runtime.session import track
    from bayesnet_track.runtime.sources import open_source

    summary = Summary()
    try:
        now = standing(job.out)
    except RecipeError:
        now = None
    if now is not None and not now.is_finished:
        for _ in resume(job.out, summary=summary):
            progress(summary.frames, None)
    elif now is None:
        on_resize: OnResize = "rescale" if job.on_resize == "rescale" else "stop"
        with open_source(job.video.source, end=job.end, on_resize=on_resize) as source:
            expected = source.expected_frames
            results = track(
                job.graph, source, _starts(job), out=job.out, seed=job.seed, summary=summary, overwrite=True
            )
            for _ in results:
                progress(summary.frames, expected)
    return row_of(job)


def row_of(job: Job) -> Row:
    """The row of a finished run; raises OSError, ValueError when its files do not make one."""
    from bayesnet_track.evaluate.runs import score_run
    from bayesnet_track.graph.net import Switch
    from bayesnet_track.journal.events import RunEnded
    from bayesnet_track.journal.reader import read_events, read_metrics

    folder = Path(job.out)
    events = list(read_events(folder / "journal.jsonl"))
    metrics = list(read_metrics(folder / "frames.jsonl"))
    ended = next((event for event in reversed(events) if isinstance(event, RunEnded)), None)
    scores = [line.score for line in metrics]
    row: Row = dict.fromkeys(ROW)
    row |= {
        "video": job.video.name,
        "seed": job.seed,
        "status": FINISHED if ended is not None and ended.complete else FAILED,
        "frames": 0 if ended is None else ended.frames,
        "fps": _fps(folder / "timings.jsonl"),
        "lost_frames": len({line.frame for line in metrics if line.status == "lost"}),
        "agents_per_frame": _mean([float(len(line.active)) for line in metrics]),
        "reconfigurations": sum(isinstance(event, Switch) for event in events),
        "score_mean": _mean(scores),
        "reason": "" if ended is not None and ended.complete else "no end" if ended is None else ended.reason,
    }
    if job.video.truth is not None and metrics:
        found = score_run(folder, job.video.truth, target=metrics[0].target)
        row |= {name: getattr(found, name) for name in ROW if name in _SCORES}
    return {name: round(value, 6) if isinstance(value, float) else value for name, value in row.items()}


_SCORES = ("auc", "auc_strict", "precision20", "mean_iou", "lost_episodes")


def failed_row(job: Job, reason: str) -> Row:
    """The row of a job that failed."""
    row: Row = dict.fromkeys(ROW)
    return row | {"video": job.video.name, "seed": job.seed, "status": FAILED, "reason": reason}


def _starts(job: Job) -> list[Start] | None:
    from bayesnet_track.evaluate.truth import read_truth

    if job.video.init is not None:
        x, y, w, h = (float(part) for part in job.video.init.split(","))
        return [Start((x, y, w, h))]
    if job.video.init_from is None:
        return None
    x, y, w, h = (float(value) for value in read_truth(job.video.init_from)[0])
    return [Start((x, y, w, h))]


def _fps(path: Path) -> float | None:
    import json

    from bayesnet_track.evaluate.scores import frames_per_second

    taken = [json.loads(line)["seconds"] for line in path.read_text("utf-8").split("\n")[:-1]]
    return frames_per_second(taken) if len(taken) > 1 else None


def _mean(values: list[float]) -> float | None:
    return sum(values) / len(values) if values else None
