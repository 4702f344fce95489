"""`run --seeds N`: the same run with several seeds, one after the other, and one summary."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from bayesnet_track.cli.commands.answer import INCOMPLETE, OK, UsageError, say, users_file, users_mistake
from bayesnet_track.cli.commands.start_boxes import TRUTH_LINES
from bayesnet_track.cli.options.arguments import whole_number

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bayesnet_track.cli.batch.spread import Spread
    from bayesnet_track.cli.batch.work import Row
    from bayesnet_track.evaluate.truth import TruthForm

WITH_TRUTH = ("auc", "auc_strict", "precision20", "mean_iou", "lost_episodes", "mota", "idf1", "hota")
MEASURES = (*WITH_TRUTH, "score_mean", "lost_frames", "reconfigurations", "agents_per_frame", "fps")
"""Of a summary, in this order; what depends on ground truth first."""


def add_seeds_options(parser: argparse.ArgumentParser) -> None:
    """`--seeds`, `--truth`."""
    parser.add_argument(
        "--seeds",
        type=whole_number(1),
        metavar="N",
        help="N runs, with seeds from --seed on, in RUN/seed-0 ...; at the end a summary with intervals",
    )
    parser.add_argument("--truth", metavar="FILE", help="ground-truth file to score with; only with --seeds")


def run_seeds(options: argparse.Namespace, once: Callable[[argparse.Namespace], int]) -> int:
    """Call `once` for each seed, with its own --seed and --out; then summarise."""
    from bayesnet_track.evaluate.truth import is_mot

    for name in ("view", "rerun", "inputs"):
        if getattr(options, name, None) is not None:
            raise UsageError(f"--{name} is for one run; leave out --seeds")
    truth = options.truth or options.init_from
    if options.truth:
        with users_file("--truth", f"{TRUTH_LINES}, or MOT lines"):
            is_mot(options.truth, options.truth_format)  # a file that cannot be read is known at once
    rows, worst = [], OK
    for seed in range(options.seed, options.seed + options.seeds):
        out = str(Path(options.out) / f"seed-{seed}")
        changed = {"seed": seed, "out": out, "seeds": None, "truth": None, "json": False}
        changed["quiet"] = options.quiet or options.json
        code = once(argparse.Namespace(**{**vars(options), **changed}))
        if code not in (OK, INCOMPLETE):
            return code
        worst = max(worst, code)
        with users_mistake():
            rows.append(row_of_run(options.graph, seed, out, truth, options.truth_format))
    say_summary(rows, options, {"run": options.out})
    return worst


def row_of_run(graph: str, seed: int, out: str, truth: str | None, form: TruthForm | None = None) -> Row:
    """What was measured of a run; raises OSError, ValueError where a file cannot be read."""
    from bayesnet_track.cli.batch.jobs import Job, Video
    from bayesnet_track.cli.batch.work import row_of
    from bayesnet_track.evaluate.mot import score_mot
    from bayesnet_track.evaluate.mot_pairs import read_pair
    from bayesnet_track.evaluate.runs import frames_of_run
    from bayesnet_track.evaluate.truth import is_mot
    from bayesnet_track.runtime.recording.rundir import RunDirectory

    several = truth is not None and is_mot(truth, form)
    video = Video(out, "", truth=None if several else truth)
    row = row_of(Job(graph, video, seed, out, truth_format=form))
    if several and truth is not None:
        found = score_mot(*read_pair(RunDirectory(Path(out)).mot, truth, *frames_of_run(Path(out)), form))
        row |= {"mota": found.mota, "idf1": found.idf1, "hota": found.hota}
    return row


def summary_of(rows: Sequence[Row]) -> dict[str, Spread]:
    """The measures of runs over their seeds."""
    from bayesnet_track.cli.batch.spread import spread_over_seeds

    return spread_over_seeds(rows, MEASURES)


def say_summary(rows: Sequence[Row], options: argparse.Namespace, head: dict[str, object]) -> None:
    """The summary as text, or with --json as one object."""
    from bayesnet_track.cli.batch.spread import spread_text

    summary = summary_of(rows)
    if options.json:
        measures = {name: asdict(one) for name, one in summary.items()}
        say(json.dumps({**head, "seeds": [row["seed"] for row in rows], "summary": measures}))
    elif not options.quiet:
        seeds = sorted({row["seed"] for row in rows}, key=str)
        say(f"{head['run']}: {len(seeds)} seeds, {seeds[0]} to {seeds[-1]}\n{spread_text(summary)}")
